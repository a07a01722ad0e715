"""What all tests share: shipped data, an isolated ROS domain, nothing written outside tmp_path."""

import fcntl
import os
import sys
import tempfile
from pathlib import Path

import pytest

from ema_record.resources import share_path

ROOT = Path(__file__).resolve().parents[1]
DOMAINS = range(1, 102)
"""Domains whose ports lie below the ephemeral ports of Linux (0 is everybody's)."""

os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
os.environ.setdefault("MPLBACKEND", "Agg")


@pytest.fixture(scope="session")
def repository():
    """Return the root of the checkout."""
    return ROOT


@pytest.fixture(scope="session")
def shared_data():
    """Return the folder of measured data that lies beside the checkout."""
    path = ROOT.parent / "shared" / "data"
    if not path.is_dir():
        pytest.fail(f"{path} is absent: this test needs the measured data beside the checkout")
    return path


@pytest.fixture(scope="session", autouse=True)
def _ros_logs(tmp_path_factory):
    """Keep the log files of ROS processes out of the home directory."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_LOG_DIR", str(tmp_path_factory.mktemp("ros_log")))
        yield


@pytest.fixture
def ros_domain(monkeypatch):
    """Return a ROS domain that no other test run on this machine has, set in the environment.

    A locked file stands for a domain, so that the lock ends with the process that holds it.
    Processes that the test starts inherit the environment.
    """
    for domain in DOMAINS:
        with Path(tempfile.gettempdir(), f"ema_phm_test_domain_{domain}.lock").open("a") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
            monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            monkeypatch.setenv(
                "FASTRTPS_DEFAULT_PROFILES_FILE", str(share_path("config/fastdds.xml"))
            )
            yield domain
        return
    pytest.fail(f"all ROS domains {DOMAINS[0]} to {DOMAINS[-1]} are taken by other test runs")
