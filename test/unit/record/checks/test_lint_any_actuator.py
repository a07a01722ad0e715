"""A second actuator (gear 300, four pole pairs, 28 V, 10 kHz): the default is not assumed."""

from dataclasses import replace

import numpy as np
import pytest

from ema_cli.main import run
from ema_prognostics.features.extract import extract
from ema_prognostics.features.profile_kind import profile_kind
from ema_record.bag.read import read_bag, write_bag
from ema_record.checks.guard import guard_findings, outcome_of
from ema_record.checks.live import Level, check_record, group_of, worst
from ema_record.checks.run import lint_bag
from support.recording import Recording
from support.simulations import DESCRIPTION, SECOND_STEP, column, record_of, second_actuator

SECOND = second_actuator()
ROW = 5000


def second(*effects):
    return record_of(SECOND_STEP, *effects, seed=3, actuator=SECOND)


def rules(record):
    return {finding.rule for finding in guard_findings(record, SECOND)}


@pytest.mark.parametrize("effects", [
    [], ["turn_short.fraction=0.3", "turn_short.phase=b"], ["motor_friction.increase=1.0"],
    ["rotor_eccentricity.zeta=0.3", "rotor_eccentricity.mode=shifted"],
    ["surface_friction.increase=1.5"], ["backlash.increase=0.01"],
])
def test_a_good_record_passes_all_checks(effects, tmp_path):
    record = second(*effects)
    assert guard_findings(record, SECOND) == ()
    assert worst(check_record(record, SECOND)) < Level.ERROR
    report = lint_bag(write_bag(record, tmp_path / "bag"), SECOND)
    assert report.findings == () and report.unreadable is None


def test_taken_for_the_default_one_it_does_not_pass(tmp_path):
    """What makes the test above mean something: the default description refuses the record."""
    record = second()
    bag = write_bag(record, tmp_path / "bag")
    found = {finding.rule for finding in lint_bag(bag).findings}
    assert {"sensor_scale", "sample_rate", "wrong_profile"} <= found
    assert guard_findings(record) != ()


def test_the_command_takes_its_description(tmp_path, capsys):
    bag = write_bag(second(), tmp_path / "bag")
    assert run(["lint", "--model", str(DESCRIPTION), str(bag)]) == 0
    assert "clean" in capsys.readouterr().out


FLAWS = [
    ("wrong_unit", column(9, np.degrees)),
    ("wrong_unit", column(1, lambda x: x * 30.0 / np.pi)),
    ("wrong_unit", column(3, lambda x: 1e3 * x)),
    ("sign_flip", column(1, np.negative)),
    ("sign_flip", column(8, lambda x: 2.0 * np.pi - x)),
    ("sensor_scale", column(1, lambda x: 1.05 * x)),
    ("sensor_scale", column(9, lambda x: 1.1 * x)),
    ("sensor_offset", column(2, lambda x: x + 2.0)),
    ("sensor_noise", column(9, lambda x: x + np.random.default_rng(1).normal(0, 2e-3, len(x)))),
    ("stuck_channel", column(9, lambda x: np.where(np.arange(len(x)) < ROW, x, x[ROW]))),
    ("stuck_channel", column(8, lambda x: np.where(np.arange(len(x)) < ROW, x, x[ROW]))),
    ("swapped_phases", lambda r: replace(r, samples=r.samples[:, [0, 1, 3, 2, *range(4, 10)]])),
    ("gap", lambda r: replace(r, samples=np.delete(r.samples, slice(ROW, ROW + 90), axis=0))),
    ("clock_jump", column(0, lambda x: x + 0.0503 * (np.arange(len(x)) >= ROW))),
    ("not_finite", column(4, lambda x: np.where(np.arange(len(x)) == ROW, np.nan, x))),
]


@pytest.mark.parametrize(("rule", "flaw"), FLAWS)
def test_each_flaw_is_found_and_told_by_its_check(rule, flaw):
    record = flaw(second())
    found = [f for f in guard_findings(record, SECOND) if f.rule == rule]
    assert found
    level = {result.name: result.level for result in check_record(record, SECOND)}
    assert level[group_of(found[0])] >= (
        Level.WARN if outcome_of(found) == "unknown" else Level.ERROR)


@pytest.mark.parametrize(("index", "value"), [(1, 510.0), (9, 0.9), (2, 41.0), (5, 31.0)])
def test_ranges_are_those_of_its_transducers(index, value):
    """Each value is beyond the second actuator's range, or within it by one part in ten."""
    for factor, outside in ((1.0, True), (0.9, False)):
        record = second()
        record.samples[3, index] = factor * value
        found = {result.name: result.message for result in check_record(record, SECOND)}
        assert ("outside" in found["range"]) == outside


def test_a_wide_profile_goes_through_a_bag(tmp_path):
    record = second()
    again = read_bag(write_bag(record, tmp_path / "bag"))
    assert again.profile == SECOND_STEP
    bag = Recording.of(record, tmp_path / "other").write(tmp_path / "again")
    assert read_bag(bag).profile.points == SECOND_STEP.points


def test_features_relate_motor_and_surface():
    assert profile_kind(SECOND_STEP, SECOND) == "step"
    found = extract(second(), "step", SECOND)
    assert abs(found["speed_over_angle_full"]) < 1.0
    assert abs(found["position_over_angle_full"]) < 1.0
    assert abs(found["inertia"]) < 0.1
