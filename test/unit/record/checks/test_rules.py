"""Each kind of defect is found with time, size and remedy; good bags are clean."""

import json
from random import Random

import numpy as np
import pytest

from ema_cli.main import run
from ema_record.bag.read import write_bag
from ema_record.bag.writer import BagWriter
from ema_record.checks.guard import RULES
from ema_record.checks.run import lint_bag
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate
from support.defects import DEFECTS
from support.recording import Recording


@pytest.fixture(scope="module")
def record():
    return simulate(load_profile("step"), seed=11, start_time=1_790_000_000 * 10**9)


@pytest.fixture
def recording(record, tmp_path):
    return Recording.of(record, tmp_path / "source")


@pytest.mark.parametrize("name", sorted(DEFECTS))
def test_defects_are_found(recording, tmp_path, name):
    DEFECTS[name].make(recording, Random(7))
    report = lint_bag(recording.write(tmp_path / "bag"))
    assert report.exit_status == 1
    found = [f for f in report.findings if f.rule in DEFECTS[name].rules]
    assert found, [f.message for f in report.findings]
    assert all(f.remedy and f.message and "\n" not in f.message for f in report.findings)


def test_time_and_size_of_a_gap(recording, record, tmp_path):
    del recording.blocks[5]
    (finding,) = lint_bag(recording.write(tmp_path / "bag")).findings
    assert finding.rule == "gap"
    assert finding.time == pytest.approx(record.time[2499])
    assert (finding.size, finding.unit) == (pytest.approx(500 / record.rate), "s")


def test_times_that_do_not_count_from_the_command_are_no_missing_samples(recording, tmp_path):
    for _, block in recording.blocks:
        block[:, 0] += 5.0
    gap = next(f for f in lint_bag(recording.write(tmp_path / "bag")).findings if f.rule == "gap")
    assert gap.message == ("the times of a whole test begin at 5.0000 s: count them from its "
                           "command")


def test_size_of_a_clock_jump(recording, record, tmp_path):
    for _, block in recording.blocks[9:]:
        block[:, 0] += 0.03
    found = lint_bag(recording.write(tmp_path / "bag")).findings
    (jump,) = [f for f in found if f.rule == "clock_jump"]
    assert jump.size == pytest.approx(0.03) and jump.time == pytest.approx(record.time[4499])
    assert not [f for f in found if f.rule == "gap"]


@pytest.mark.parametrize(
    "effects",
    [[], ["turn_short.fraction=0.3", "turn_short.phase=b"], ["rotor_eccentricity.zeta=0.3"],
     ["motor_friction.increase=1.0"], ["backlash.increase=0.005"],
     ["current_sensor_gain.phase_a=0.01", "current_sensor_offset.phase_b=-0.05"],
     ["winding_temperature.temperature=90"]],
)
def test_good_bags_and_faults_of_the_actuator_are_clean(tmp_path, effects):
    record = simulate(load_profile("step"), effects=parse_effects(effects), seed=4)
    report = lint_bag(write_bag(record, tmp_path / "bag"))
    assert report.findings == () and report.exit_status == 0


def test_extended_profile_without_noise_is_clean(tmp_path):
    record = simulate(load_profile("extended"), seed=4, noise=0.0)
    assert lint_bag(write_bag(record, tmp_path / "bag")).findings == ()


def test_flat_and_empty_data_do_not_stop_a_rule(recording, tmp_path):
    for rows in (1, 2, 3, 150):
        for value in (0.0, 1e300, -1e-300):
            samples = np.full((rows, 10), value)
            samples[:, 0] = (np.arange(rows) + 0.5) / 20_000
            recording.blocks = [(10**9, samples)]
            with np.errstate(all="ignore"):
                report = lint_bag(recording.write(tmp_path / f"{rows}_{value}"))
            assert report.exit_status == 1


def test_command_in_json(recording, tmp_path, capsys):
    good = recording.write(tmp_path / "good")
    del recording.blocks[3:5]
    bad = recording.write(tmp_path / "bad")
    nothing = tmp_path / "nothing"
    assert run(["lint", str(good)]) == 0
    assert "clean" in capsys.readouterr().out
    assert run(["lint", str(good), str(bad), "--json"]) == 1
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["clean"] for line in lines] == [True, False]
    assert set(lines[1]["findings"][0]) == {
        "rule", "level", "message", "time", "size", "unit", "channel", "remedy"
    }
    assert run(["lint", str(good), str(nothing), "--json"]) == 2
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert "no such file" in lines[1]["unreadable"]
    assert run(["lint", str(bad)]) == 1
    assert "gap" in capsys.readouterr().out


def test_rules_have_remedies():
    assert len({rule.name for rule in RULES}) >= 18
    assert all(rule.remedy and rule.level in ("error", "warning") for rule in RULES)


@pytest.mark.parametrize(
    ("noted", "said"), [("12.500", "12.500 ms"), ("\x1b[2J[red]", "unknown ms")])
def test_what_a_bag_notes_of_its_recovery_is_no_text_for_a_terminal(record, tmp_path, noted, said):
    with BagWriter(tmp_path / "bag", profile=record.profile, provenance=record.provenance,
                   flush_interval=None) as writer:
        writer.close("interrupted", recovery={"missing_ms": noted})
    (message,) = [f.message for f in lint_bag(tmp_path / "bag").findings
                  if "recovered" in f.message]
    assert said in message and message.isprintable() and "[red]" not in message
