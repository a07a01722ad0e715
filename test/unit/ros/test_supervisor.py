"""Starting, watching and ending processes; domains of one's own; what the options mean."""

import os
import subprocess
import sys
import tempfile
import time

import psutil
import pytest

from ema_cli.commands.bit import effect_parameters, exit_status
from ema_monitor.chain import summarise
from ema_record.errors import UsageError
from ema_ros import domain
from ema_ros.domain import private_domain
from ema_ros.supervisor import NodeDiedError, Supervisor


@pytest.fixture
def modules(tmp_path, monkeypatch):
    """Write modules that stand for nodes that misbehave."""
    folder = tmp_path / "modules"
    folder.mkdir()
    (folder / "stubborn.py").write_text(
        "import signal, time, sys\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
        "print('up', file=sys.stderr, flush=True)\n"
        "time.sleep(60)\n"
    )
    (folder / "wrong.py").write_text(
        "import sys\nprint('error: no such thing: try another', file=sys.stderr)\nsys.exit(2)\n"
    )
    (folder / "broken.py").write_text("raise RuntimeError('boom')\n")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(
        filter(None, [str(folder), os.environ.get("PYTHONPATH")])))
    return folder


def wait_for(condition, timeout=20.0):
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def failure(supervisor):
    """Return the error of the first check that fails."""
    with pytest.raises(Exception) as caught:
        wait_for(supervisor.check)
    return caught.value


def test_a_process_that_ignores_the_request_is_killed(modules, tmp_path, monkeypatch):
    monkeypatch.setattr("ema_ros.supervisor.GENTLE_STOP", 0.3)
    others = set(psutil.Process().children())
    with Supervisor(tmp_path / "log") as supervisor:
        supervisor.start("stubborn", {})
        wait_for(lambda: "up" in (tmp_path / "log").read_text())
        (child,) = set(psutil.Process().children()) - others
    assert not child.is_running()


def test_nodes_are_asked_to_end_and_one_kind_is_waited_for(modules, tmp_path, monkeypatch):
    monkeypatch.setattr("ema_ros.supervisor.GENTLE_STOP", 1.0)
    (modules / "gentle.py").write_text(
        "import signal, time, sys\n"
        "signal.signal(signal.SIGTERM, signal.default_int_handler)\n"
        "print('up', file=sys.stderr, flush=True)\n"
        "try:\n    time.sleep(60)\n"
        "except KeyboardInterrupt:\n    print('ended', file=sys.stderr)\n"
    )
    with Supervisor(tmp_path / "log") as supervisor:
        supervisor.start("gentle", {})
        supervisor.start("stubborn", {})
        wait_for(lambda: (tmp_path / "log").read_text().count("up") == 2)
        gentle, stubborn = map(psutil.Process, map(supervisor.pid, ("gentle", "stubborn")))
        supervisor.ask_to_end()
        supervisor.wait_for("gentle")
        assert "ended" in (tmp_path / "log").read_text()
        assert not gentle.is_running()
        assert stubborn.is_running()
    assert not stubborn.is_running()


def test_a_node_that_still_loads_ends_without_a_word(modules, tmp_path):
    """Before it listens to signals."""
    (modules / "loading.py").write_text(
        "import time, sys\nprint('up', file=sys.stderr, flush=True)\ntime.sleep(60)\n")
    with Supervisor(tmp_path / "log") as supervisor:
        supervisor.start("loading", {})
        wait_for(lambda: "up" in (tmp_path / "log").read_text())
        begin = time.monotonic()
    assert time.monotonic() - begin < 2.0
    assert (tmp_path / "log").read_text() == "up\n"


def test_wrong_use_of_a_node_is_wrong_use(modules, tmp_path):
    with Supervisor(tmp_path / "log") as supervisor:
        supervisor.start("wrong", {})
        error = failure(supervisor)
    assert isinstance(error, UsageError)
    assert str(error) == "no such thing: try another"


def test_a_node_that_dies_is_named_with_its_last_line(modules, tmp_path):
    with Supervisor(tmp_path / "log") as supervisor:
        supervisor.start("broken", {})
        error = failure(supervisor)
    assert isinstance(error, NodeDiedError)
    assert "broken ended with status 1: RuntimeError: boom" in str(error)


def test_domains_differ_and_a_choice_is_taken():
    with private_domain(None) as first, private_domain(None) as second:
        assert first != second
        assert 1 <= first <= 101
    with private_domain(7) as chosen:
        assert chosen == 7


HOLDS_A_DOMAIN = """
from ema_ros import domain
domain.DOMAINS = range(230, 232)
with domain.private_domain(None) as found:
    print(found, flush=True)
    input()
"""


def test_a_domain_is_held_across_processes_and_leaves_no_file(tmp_path, monkeypatch):
    """All domains but one held: another process gets that one, and a third one none."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(domain, "DOMAINS", range(230, 232))
    with private_domain(None) as first, subprocess.Popen(
        [sys.executable, "-c", HOLDS_A_DOMAIN], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        text=True,
    ) as other:
        second = int(other.stdout.readline())
        assert {first, second} == {230, 231}
        with pytest.raises(UsageError, match="no free ROS domain in 230 to 231"), \
                private_domain(None):
            pass
        other.kill()
        other.wait()
        with private_domain(None) as third:
            assert third == second, "a process that was killed still holds its domain"
    assert list(tmp_path.iterdir()) == []


def test_effects_become_parameters():
    assert effect_parameters(["turn_short.fraction=0.5", "turn_short.phase = b"]) == {
        "turn_short.fraction": 0.5, "turn_short.phase": "b"}
    for wrong, what in (
        ("turn_short", r"NAME\.PARAMETER=VALUE"), ("turn_short.fraction=", r"NAME\.PARAMETER="),
        ("turn_short=1", "name a parameter too"), ("a b.c=1", "unknown effect 'a b'"),
        (".x=1", "unknown effect ''"), ("turn_short.phase=1", "choose one of a, b, c"),
        ("turn_short.fraction=nan", "nan is out of bounds"),
    ):
        with pytest.raises(UsageError, match=what):
            effect_parameters([wrong])


@pytest.mark.parametrize(("verdict", "passed", "status"), [
    ("healthy", True, 0), ("healthy", False, 3), ("fault", True, 1), ("fault", False, 1),
    ("unknown", True, 3), ("incomplete", True, 3), ("invalid", True, 2),
])
def test_exit_status(verdict, passed, status):
    assert exit_status({"verdict": {"verdict": verdict}, "passed": passed}) == status


def test_the_answer_of_a_refused_test():
    result = summarise({
        "serial_number": "EMA-1", "passed": False,
        "checks": [{"name": "test", "level": 2, "message": "refused: no wheels", "values": {}}],
    })
    assert result["status"] == "refused"
    assert result["record"] == ""
    assert result["message"] == "refused: no wheels"
    assert result["checks"] == []
