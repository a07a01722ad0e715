"""`ema bit` and `ema replay` as a user calls them: the whole chain, and every way out."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from mcap.reader import make_reader
from ros_processes import PROGNOSTICS, SIMULATOR, ema, wait_until_it_listens

from ema_record.bag.read import read_bag
from ema_record.wire.topics import VERDICT

HIDDEN = ("--effect", "turn_short.fraction=0.1", "--effect", "turn_short.phase=b")
EXAMPLE = "bags/sim_0000_step"
NODES = ("simulator_node", "monitor_node", "prognostics_node")


def without_bag(verdict):
    """Return what is judged: topics alone tell neither unit nor begin of a test."""
    return {key: value for key, value in verdict.items()
            if key not in ("bag", "time", "serial_number")}


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """Return the result of the extended test of an actuator with a hidden turn short."""
    out = tmp_path_factory.mktemp("bit") / "records"
    run = ema("bit", *HIDDEN, "--out", out, "--serial-number", "EMA-9", "--json")
    assert run.returncode == 1, run.stderr
    assert "Traceback" not in run.stderr
    return json.loads(run.stdout)


def test_the_chain_finds_the_hidden_fault(short):
    verdict = short["verdict"]
    assert verdict["verdict"] == "fault"
    assert verdict["fault_class"] == "turn_short"
    assert verdict["phase"] == "b"
    assert verdict["severity"] == pytest.approx(0.1, abs=0.02)
    assert short["passed"]
    assert short["serial_number"] == "EMA-9"
    counters = next(check for check in short["checks"] if check["name"] == "counters")
    assert counters["values"] == {"samples_published": "62600", "samples_recorded": "62600"}
    assert read_bag(short["record"]).provenance.serial_number == "EMA-9"
    assert short["times"]["after_record_closed"] > 0.0
    assert Path(short["log"]).parent == Path(short["record"]).parent


def test_nothing_in_the_record_tells_what_was_hidden(short):
    """But the verdict: it is the last message, an attachment, and the code in the metadata."""
    (file,) = Path(short["record"]).glob("*.mcap")
    with file.open("rb") as stream:
        reader = make_reader(stream)
        said = [message.data for _, channel, message in reader.iter_messages()
                if channel.topic != VERDICT]
        said += [str(record.metadata).encode() for record in reader.iter_metadata()]
        (attached,) = reader.iter_attachments()
    assert len(said) > 1000
    said.append((file.parent / "metadata.yaml").read_bytes())
    assert not any(b"turn_short" in text for text in said)
    assert json.loads(attached.data) == short["verdict"]
    assert "turn_short.fraction" not in Path(short["log"]).read_text()


def test_check_gives_the_same_verdict_without_ros(short):
    run = ema("check", short["record"], "--json")
    assert run.returncode == 1, run.stderr
    found = json.loads(run.stdout)
    assert len(found["record_sha256"]) == 64
    assert found | {"record_sha256": None} == short["verdict"]


@pytest.mark.slow
def test_replay_gives_the_same_verdict(short, nodes, watcher):
    nodes.start(PROGNOSTICS)
    watcher.wait_for_prognostics()  # the watcher reads samples too, and replay takes any reader
    run = ema("replay", short["record"], "--wait", 60, "--json")
    assert run.returncode == 0, run.stderr
    counts = json.loads(run.stdout)["messages"]
    assert counts["/ema/samples"] == 157
    assert counts["/ema/command"] == 1
    watcher.wait(lambda: watcher.node.verdict is not None, 30.0, "verdict")
    assert without_bag(watcher.node.verdict) == without_bag(short["verdict"])


@pytest.mark.slow
def test_replay_refuses_a_domain_with_an_actuator(repository, nodes, watcher):
    nodes.start(SIMULATOR)
    watcher.wait_for_simulator()
    run = ema("replay", repository / EXAMPLE)
    assert run.returncode == 3
    assert run.stderr.count("\n") == 1
    assert "another node publishes /ema/samples" in run.stderr


@pytest.mark.usefixtures("ros_domain")
def test_replay_without_a_listener_says_so(repository):
    run = ema("replay", repository / EXAMPLE, "--wait", 0.5)
    assert run.returncode == 3
    assert "nobody listens" in run.stderr


@pytest.mark.slow
def test_a_healthy_actuator_is_called_healthy(tmp_path):
    run = ema("bit", "--profile", "step", "--out", tmp_path / "records", "--verbose")
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.startswith("HEALTHY  SIM-0000")
    assert "complete, 9 of 9 checks" in run.stdout
    assert "all 9000 published samples are recorded" in run.stdout
    (page,) = (tmp_path / "records").glob("*.html")
    assert str(page) in run.stdout and page.with_suffix(".xml").is_file()


@pytest.mark.parametrize(("arguments", "hint"), [
    (("--effect", "turn_shrt.fraction=0.1"), "did you mean 'turn_short'"),
    (("--effect", "turn_short.fraction=5"), "0 to 0.9"),
    (("--effect", "turn_short"), "NAME.PARAMETER=VALUE"),
    (("--profile", "exteded"), "did you mean 'extended'"),
    (("--model", "/nonexistent.yaml"), "/nonexistent.yaml"),
    (("--out", "/proc/nowhere"), "cannot be written"),
])
def test_wrong_use_is_one_line_and_status_2(tmp_path, arguments, hint):
    out = () if "--out" in arguments else ("--out", tmp_path / "records")
    run = ema("bit", *arguments, *out)
    assert run.returncode == 2, run.stderr
    assert run.stderr.count("\n") == 1
    assert hint in run.stderr
    assert not any(path.is_dir() for path in (tmp_path / "records").glob("*"))


def malformed_model(tmp_path):
    path = tmp_path / "model.yaml"
    path.write_text("motor: [unclosed\n")
    return path


def test_a_malformed_model_is_one_line_and_status_2(tmp_path):
    run = ema("bit", "--model", malformed_model(tmp_path), "--out", tmp_path / "records")
    assert run.returncode == 2
    assert run.stderr.count("\n") == 1
    assert "line" in run.stderr


def wait_for(condition, timeout, what):
    end = time.monotonic() + timeout
    while not (found := condition()):
        assert time.monotonic() < end, f"{what}: not within {timeout} s"
        time.sleep(0.02)
    return found


def start_and_wait_for_samples(out):
    """Start `ema bit`; return it and its children once samples are on the disk."""
    process = subprocess.Popen(
        [sys.executable, "-m", "ema_cli", "bit", "--out", str(out)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )

    def under_way():
        assert process.poll() is None, process.communicate()
        return any(f.stat().st_size > 20_000 for f in out.glob("*/*.mcap"))

    wait_for(under_way, 200.0, "a record under way")
    children = psutil.Process(process.pid).children(recursive=True)
    assert {name for name in NODES for c in children if name in " ".join(c.cmdline())} == set(
        NODES)
    return process, children


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_test_leaves_a_marked_record_and_no_process(tmp_path, number):
    out = tmp_path / "records"
    process, children = start_and_wait_for_samples(out)
    process.send_signal(number)
    _, errors = process.communicate(timeout=15.0)
    assert process.returncode == 128 + number
    assert "Traceback" not in errors
    (path,) = [p for p in out.iterdir() if p.is_dir()]
    record = read_bag(path)
    assert record.provenance.status == "interrupted"
    assert len(record) > 0
    assert str(path) in errors
    assert [c for c in children if c.is_running() and c.status() != psutil.STATUS_ZOMBIE] == []


@pytest.mark.slow
@pytest.mark.parametrize(("number", "line"), [
    (signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")])
def test_a_test_that_is_interrupted_as_it_starts_says_so_and_nothing_else(
    tmp_path, number, line
):
    """While it loads, while it starts the nodes, while these load."""
    for wait in (0.0, 0.1, 0.2, 0.4, 0.7, 1.0, 1.3, 1.6, 2.0):
        out = tmp_path / str(wait)
        process = subprocess.Popen(
            [sys.executable, "-m", "ema_cli", "bit", "--out", str(out)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
        wait_until_it_listens(process)
        time.sleep(wait)
        children = psutil.Process(process.pid).children(recursive=True)
        os.killpg(process.pid, number)
        _, errors = process.communicate(timeout=60.0)
        said = [told for told in errors.splitlines() if "record kept" not in told]
        assert (process.returncode, said) == (128 + number, [f"ema: {line}"]), wait
        assert "Traceback" not in "".join(path.read_text() for path in out.glob("*.log")), wait
        assert [c for c in children if c.is_running()] == []


def child_named(children, name):
    (found,) = [c for c in children if name in " ".join(c.cmdline())]
    return found


@pytest.mark.slow
def test_killed_prognostics_are_started_again_and_find_the_record(tmp_path):
    process, children = start_and_wait_for_samples(tmp_path / "records")
    child_named(children, "prognostics_node").kill()
    out, errors = process.communicate(timeout=60.0)
    assert process.returncode == 0, errors
    assert "started again" in errors
    assert "HEALTHY" in out


@pytest.mark.slow
def test_a_killed_simulator_ends_the_test_without_a_verdict(tmp_path):
    out = tmp_path / "records"
    process, children = start_and_wait_for_samples(out)
    child_named(children, "simulator_node").kill()
    _, errors = process.communicate(timeout=60.0)
    assert process.returncode == 4
    assert "simulator_node ended with status -9" in errors
    (path,) = [p for p in out.iterdir() if p.is_dir()]
    assert read_bag(path).provenance.status in ("interrupted", "aborted")
    assert [c for c in children if c.is_running() and c.status() != psutil.STATUS_ZOMBIE] == []


@pytest.mark.slow
def test_no_node_survives_a_killed_supervisor(tmp_path):
    out = tmp_path / "records"
    process, children = start_and_wait_for_samples(out)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate(timeout=5.0)
    wait_for(lambda: not [c for c in children if c.is_running()], 10.0, "the end of the nodes")
    (path,) = [p for p in out.iterdir() if p.is_dir()]
    assert read_bag(path).provenance.status == "interrupted"
