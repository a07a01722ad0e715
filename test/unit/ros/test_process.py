"""The end of a node's process is bounded, whatever the middleware does."""

import signal
import subprocess
import sys

import pytest

NODE = """
import ctypes, os, signal, types
from ema_ros import process

def torn():
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        signal.pause()
    except KeyboardInterrupt:
        raise RuntimeError("Unable to convert call argument")

process.MIDDLEWARE_END = 1

class Node:
    exit_status = {exit_status}
    def shut_down(self): print("records closed", flush=True)
    def destroy_node(self): {destroy}

ros = types.SimpleNamespace(
    init=lambda **_: {init}, try_shutdown=lambda: None,
    signals=types.SimpleNamespace(SignalHandlerOptions=types.SimpleNamespace(NO=0)),
    executors=types.SimpleNamespace(
        ExternalShutdownException=OSError, SingleThreadedExecutor=lambda: executor),
)
executor = types.SimpleNamespace(
    add_node=lambda node: None, remove_node=lambda node: None,
    spin_once=lambda timeout_sec: {spin}, shutdown=lambda timeout_sec: {shutdown},
)
status = process.run_node(ros, lambda stop: {make})
{after}
raise SystemExit(status)
"""
HOLDS_THE_INTERPRETER = "ctypes.PyDLL(None).pause()"


def run(destroy, *, shutdown="None", after="", exit_status=0, spin="None", init="None",
        make="Node()"):
    node = NODE.format(destroy=destroy, shutdown=shutdown, after=after,
                       exit_status=exit_status, spin=spin, init=init, make=make)
    return subprocess.run([sys.executable, "-c", node],
                          check=False, capture_output=True, text=True, timeout=20.0)


def test_a_middleware_that_never_ends_is_left_behind():
    done = run(HOLDS_THE_INTERPRETER)
    assert done.returncode == 1
    assert done.stdout == "records closed\n"
    assert "destroy_node" in done.stderr  # where it stood
    assert "Traceback" not in done.stderr


def test_an_executor_that_never_ends_is_left_behind_too():
    done = run("pass", shutdown=HOLDS_THE_INTERPRETER)
    assert (done.returncode, done.stdout) == (1, "records closed\n")


def test_the_middleware_may_not_hang_after_the_interpreter_either():
    done = run("pass", after="import faulthandler; faulthandler.cancel_dump_traceback_later();"
                             + HOLDS_THE_INTERPRETER)
    assert done.returncode == -signal.SIGALRM
    assert done.stdout == "records closed\n"


def test_one_that_ends_leaves_no_word():
    done = run("pass")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_context_that_another_shut_down_is_no_error():
    done = run("pass", exit_status=None, spin="(_ for _ in ()).throw(OSError)")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("where", ["init", "make"])
def test_an_interruption_that_the_library_makes_another_error_of_is_no_error(where):
    done = run("pass", **{where: "torn()"})
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert run("pass", make="[][0]").returncode == 1, "others are"


def test_an_interruption_in_code_made_of_text_is_no_end_by_a_signal(tmp_path):
    """Python's ``-m`` ended by SIGINT where it met the making of a dataclass."""
    code = "exec('os.kill(os.getpid(), signal.SIGTERM); signal.pause()')"
    (tmp_path / "node.py").write_text(NODE.format(
        destroy="pass", shutdown="None", after="", exit_status=0, spin="None", init="None",
        make=code))
    done = subprocess.run([sys.executable, "-m", "node"], check=False, capture_output=True,
                          text=True, timeout=20.0, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("domain", ["233", "-1", "one", "1.0"])
def test_a_domain_that_there_is_none_of_is_one_line(domain, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    done = run("pass")
    assert done.returncode == 2
    assert done.stderr == (
        f"error: ROS_DOMAIN_ID is {domain!r}: a ROS domain is a number from 0 to 232\n")
