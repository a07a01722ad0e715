"""The end of a node's process is bounded, whatever the middleware does."""

import signal
import subprocess
import sys

import pytest

NODE = """
import ctypes, types
from ema_ros import process

process.MIDDLEWARE_END = 1

class Node:
    exit_status = {exit_status}
    def shut_down(self): print("records closed", flush=True)
    def destroy_node(self): {destroy}

ros = types.SimpleNamespace(
    init=lambda **_: None, try_shutdown=lambda: None,
    signals=types.SimpleNamespace(SignalHandlerOptions=types.SimpleNamespace(NO=0)),
    executors=types.SimpleNamespace(
        ExternalShutdownException=OSError, SingleThreadedExecutor=lambda: executor),
)
executor = types.SimpleNamespace(
    add_node=lambda node: None, remove_node=lambda node: None,
    spin_once=lambda timeout_sec: {spin}, shutdown=lambda timeout_sec: {shutdown},
)
status = process.run_node(ros, lambda stop: Node())
{after}
raise SystemExit(status)
"""
HOLDS_THE_INTERPRETER = "ctypes.PyDLL(None).pause()"


def run(destroy, *, shutdown="None", after="", exit_status=0, spin="None"):
    node = NODE.format(destroy=destroy, shutdown=shutdown, after=after,
                       exit_status=exit_status, spin=spin)
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


@pytest.mark.parametrize("domain", ["233", "-1", "one", "1.0"])
def test_a_domain_that_there_is_none_of_is_one_line(domain, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    done = run("pass")
    assert done.returncode == 2
    assert done.stderr == (
        f"error: ROS_DOMAIN_ID is {domain!r}: a ROS domain is a number from 0 to 232\n")
