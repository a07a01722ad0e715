"""Drivers of others, as processes: the contract of docs/driver.md, and the built-in test."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
from ros_processes import ema, wait_until_it_listens

from ema_record.bag.container import read_content
from ema_record.bag.read import read_bag
from ema_record.checks.run import lint_bag
from ema_record.wire.topics import (
    COMMAND,
    DC_BUS,
    SAMPLES,
    WINDING_TEMPERATURE,
    split_name,
)

pytestmark = pytest.mark.slow

NAME = "left_aileron"


@contextmanager
def process(repository, path, **parameters):
    """Run a Python file as a node in the namespace of its actuator; yield it."""
    settings = [item for name, value in parameters.items()
                for item in ("-p", f"{name}:={json.dumps(value)}")]
    python = os.pathsep.join(str(repository / name) for name in ("", "test", "examples"))
    started = subprocess.Popen(
        [sys.executable, repository / path, "--ros-args", "-r", f"__ns:=/{NAME}", *settings],
        stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": python},
    )
    yield started
    started.send_signal(signal.SIGINT)
    _, errors = started.communicate(timeout=60.0)
    assert "Traceback" not in errors, errors
    assert "refused: " not in errors, errors


@pytest.fixture
def capture(ros_domain, repository, tmp_path):
    """Return what starts the driver that reads out after the move, and its controller."""
    with ExitStack() as stack:
        def start(pace, effects=""):
            buffer = str(tmp_path / "drive.npz")
            stack.enter_context(process(
                repository, "test/ros/joint_trajectory_controller.py", buffer=buffer,
                effects=effects))
            stack.enter_context(process(
                repository, "examples/capture_driver.py", buffer=buffer, pace=pace))
        yield start


def conformance():
    """Hold the driver to its contract and return the report by line."""
    run = ema("conformance", "--namespace", NAME, "--wait", 60, "--json")
    lines = [json.loads(line) for line in run.stdout.splitlines()]
    wrong = [line for line in lines if line["outcome"] == "WRONG"]
    assert (run.returncode, wrong) == (0, []), run.stderr
    return {line["item"]: line for line in lines}


def built_in_test(tmp_path, *arguments, status=0):
    """Test the actuator behind the driver and return the result."""
    run = ema("bit", "--no-simulator", "--actuators", NAME, "--json", "--out",
              tmp_path / "records", *arguments)
    assert run.returncode == status, run.stderr + run.stdout
    return json.loads(run.stdout)


def test_the_example_driver_passes_its_contract_and_a_built_in_test(
    ros_domain, repository, tmp_path
):
    assert len((repository / "examples" / "driver.py").read_text().splitlines()) < 100
    with process(repository, "examples/driver.py"):
        assert len(conformance()) > 20
        result = built_in_test(tmp_path)
    assert result["serial_number"] == "EXAMPLE-1"
    assert result["checks"][0]["values"] == {
        "samples_published": "62600", "samples_recorded": "62600"}
    assert result["verdict"]["verdict"] == "healthy"
    assert split_name("/left_aileron/ema/verdict").namespace == f"/{NAME}"


def test_a_drive_read_out_after_the_move_passes_its_contract_and_its_faults_are_found(
    capture, tmp_path
):
    """At once, from i_d, i_q and angle; the moves by a joint trajectory controller."""
    capture(0.0, "turn_short.fraction=0.1 turn_short.phase=b")
    found = conformance()
    assert "acquisition=capture" in found["status"]["text"]
    assert found["stops off the wheels"]["outcome"] == "ok"
    result = built_in_test(tmp_path, status=1)
    assert result["checks"][0]["values"] == {
        "samples_published": "62600", "samples_recorded": "62600"}
    verdict = result["verdict"]
    assert (verdict["fault_class"], verdict["phase"]) == ("turn_short", "b")


@pytest.mark.parametrize("pace", [3.0, 0.25])
def test_an_upload_faster_or_slower_than_the_move_is_whole(capture, tmp_path, pace):
    capture(pace)
    result = built_in_test(tmp_path, "--profile", "step")
    assert result["verdict"]["verdict"] == "healthy"
    bag = result["record"]
    record = read_bag(bag)
    assert len(record) == 9000
    assert np.abs(record.samples[:, 2:5].sum(axis=1)).max() < 1e-9, "made of i_d and i_q"
    messages = read_content(Path(bag), frozenset({SAMPLES, COMMAND})).messages
    times = {topic: [message.log_time for message in messages[topic]]
             for topic in (SAMPLES, COMMAND)}
    after = (times[SAMPLES][0] - times[COMMAND][0]) / 1e9
    assert after > 0.45, "they come after the move"
    took = (times[SAMPLES][-1] - times[SAMPLES][0]) / 1e9
    assert took < 0.43 if pace > 1.0 else took > 0.8 * 0.43 / pace
    found = {(finding.rule, finding.channel) for finding in lint_bag(bag).findings}
    assert found == {("missing_topic", DC_BUS), ("missing_topic", WINDING_TEMPERATURE)}


@pytest.mark.parametrize("path", ["examples/driver.py", "examples/capture_driver.py"])
def test_a_driver_ends_without_a_word_whenever_it_is_asked_to(
    ros_domain, repository, tmp_path, path
):
    """While it is made, while it publishes."""
    for wait in (0.0, 0.1, 0.3, 0.8):
        for number in (signal.SIGINT, signal.SIGTERM):
            started = subprocess.Popen(
                [sys.executable, repository / path], stderr=subprocess.PIPE, text=True,
                cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(repository)})
            wait_until_it_listens(started)
            time.sleep(wait)
            started.send_signal(number)
            _, errors = started.communicate(timeout=60.0)
            assert (started.returncode, errors) == (0, ""), (wait, number)


def test_conformance_without_a_driver_says_so(ros_domain):
    run = ema("conformance", "--wait", 0.5)
    assert (run.returncode, run.stdout) == (3, "")
    assert "no node publishes /ema/samples after 0.5 s" in run.stderr
