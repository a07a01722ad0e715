"""The built-in test of another type of actuator: simulator, monitor and record follow its kit."""

import json

import numpy as np
import pytest
from ros_processes import MONITOR, PROGNOSTICS, SIMULATOR, ema

from ema_monitor.moves import step_to
from ema_record.actuator_type import actuator_hash
from ema_record.bag.read import read_bag
from ema_record.kit import using_kit
from support.simulations import SECOND_STEP, second_kit


@pytest.fixture(scope="module")
def kit(tmp_path_factory):
    """Gear 300, four pole pairs, 28 V, 10 kHz, a test of its own; networks of the default one."""
    return second_kit(tmp_path_factory.mktemp("kit") / "second")


@pytest.mark.slow
def test_the_whole_chain_works_with_the_kit(kit, tmp_path):
    run = ema("bit", "--kit", kit, "--profile", "step", "--out", tmp_path / "records", "--json")
    assert "Traceback" not in run.stderr
    result = json.loads(run.stdout)
    assert result["passed"] and result["status"] == "complete"  # whatever the networks say of it
    record = read_bag(result["record"])
    with using_kit(kit):
        assert record.provenance.actuator == actuator_hash()
    assert record.rate == pytest.approx(10_000.0) and len(record) == 15_000
    assert record.profile.points == SECOND_STEP.points and record.profile.name == "step"
    assert not [r for r in result["verdict"]["reasons"] if "other actuator" in r]
    checked = ema("check", result["record"], "--json")
    assert checked.returncode == 2
    assert "other actuator" in json.loads(checked.stdout)["reasons"][0]


@pytest.mark.slow
@pytest.mark.parametrize("module", [SIMULATOR, MONITOR, PROGNOSTICS])
def test_a_node_refuses_what_is_no_kit(nodes, module, tmp_path):
    process = nodes.start(module, kit=tmp_path)
    assert process.wait(60.0) == 2
    (line,) = [text for text in nodes.log(process).splitlines() if "kit" in text]
    assert f"error: kit {tmp_path}: it holds no actuator.yaml" in line


@pytest.mark.slow
def test_a_node_takes_the_kit_as_a_parameter(kit, nodes, watcher):
    """A step to 0.7 rad at 10 kHz: beyond the stops of the default actuator, at half its rate."""
    nodes.start(SIMULATOR, kit=kit, real_time_factor=4.0)
    watcher.wait_for_simulator()
    stamp = watcher.command(step_to(0.7))
    watcher.wait(lambda: watcher.actuator["command_stamp"] == stamp
                 and watcher.actuator["state"] == "idle", what="end of the command")
    samples = np.concatenate(watcher.blocks)
    assert samples[-1, 9] == pytest.approx(0.7, abs=5e-3)
    assert np.diff(samples[:, 0]).mean() == pytest.approx(1e-4)
    assert len(watcher.blocks[0]) == 200, "20 ms a message, at any rate"
