"""Fixtures of the tests with real nodes."""

import pytest
from ros_processes import Nodes, Watcher

from ema_monitor.aircraft_node import aircrafts


def pytest_collection_modifyitems(config, items):
    for item in items:
        if "ros" in item.path.relative_to(config.rootpath).parts:
            item.add_marker("ros")


@pytest.fixture
def nodes(ros_domain, tmp_path):
    """Start nodes in a domain of their own; all must end without a traceback."""
    folder = tmp_path / "logs"
    folder.mkdir()
    found = Nodes(folder)
    try:
        yield found
    finally:
        found.stop()
    for log in folder.glob("*.log"):
        text = log.read_text()
        assert "Traceback" not in text, text
        assert "never retrieved" not in text, text


@pytest.fixture
def watcher(nodes):
    """Return the aircraft of this test, on the ground."""
    with aircrafts([""]) as (node,):
        yield Watcher(node, nodes)
