"""`ema check` behind the record checks: defects decide, and one bag has one verdict."""

import json
import os
import subprocess
import sys
from random import Random

import pytest

from ema_cli.main import run
from ema_record.profile import load_profile
from ema_sim.simulate import simulate
from support.defects import DEFECTS
from support.recording import Recording

OUTCOMES = {
    "gap": "incomplete", "aborted": "incomplete", "short": "incomplete",
    "clock_forward": "invalid", "old_buffer": "invalid", "mixed": "invalid",
    "swapped_phases": "invalid", "milliamperes": "invalid", "rpm": "invalid",
    "sign_flip": "invalid", "wrong_profile": "invalid", "not_finite": "invalid",
    "duplicate": "invalid", "stuck": "unknown", "sensor_gain": "unknown",
    "sensor_offset": "unknown", "sensor_noise": "unknown", "saturation": "unknown",
}


@pytest.fixture(scope="module")
def record():
    return simulate(load_profile("step"), seed=21, start_time=1_790_000_000 * 10**9)


@pytest.mark.parametrize("name", sorted(OUTCOMES))
def test_a_defect_is_the_verdict_and_its_reason(record, tmp_path, capsys, name):
    recording = Recording.of(record, tmp_path / "source")
    DEFECTS[name].make(recording, Random(5))
    bag = recording.write(tmp_path / "bag")
    status = run(["check", str(bag), "--json"])
    verdict = json.loads(capsys.readouterr().out)
    assert verdict["verdict"] == OUTCOMES[name], verdict["reasons"]
    assert status == (2 if OUTCOMES[name] == "invalid" else 3)
    assert verdict["faults"] == [] and verdict["fault_class"] is None
    assert len(verdict["reasons"][0]) > 20 and "\n" not in verdict["reasons"][0]


def check(*bags, threads="1"):
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
    done = subprocess.run(
        [sys.executable, "-m", "ema_cli", "check", *map(str, bags), "--json"],
        capture_output=True, text=True, check=False, timeout=120.0, env=environment,
    )
    return {json.loads(line)["bag"]: line for line in done.stdout.splitlines()}


def test_one_bag_one_verdict(repository):
    """Alone and in company, in any order, with one thread and with two: the same bytes."""
    bags = [repository / "bags" / name for name in (
        "sim_0001_extended", "sim_0000_step", "sim_0003_step")]
    found = [check(bags[0]), check(*bags), check(*reversed(bags), bags[0], threads="2")]
    assert len({answers[str(bags[0])] for answers in found}) == 1
    assert found[1] == found[2]
