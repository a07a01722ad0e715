"""Calibration, discrepancy, acceptance records: closed forms and refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ema_prognostics.cascade.model_body import DiscrepancyPart
from ema_prognostics.commission.acceptance import (
    measured_recorder,
    noise_level,
    read_acceptance,
)
from ema_prognostics.commission.calibrate import (
    LATENCIES,
    Calibration,
    _deviations,
    changed,
    parameters_of,
    wider,
)
from ema_prognostics.commission.commission import commission
from ema_prognostics.commission.discrepancy import (
    fit_discrepancy,
    with_discrepancy,
)
from ema_prognostics.commission.draft import make_draft, own_draft
from ema_prognostics.commission.estimate import estimate
from ema_prognostics.commission.quality import check_described, check_good
from ema_prognostics.training.fleet import FleetFeatures
from ema_record.actuator import load_actuator
from ema_record.bag.read import write_bag
from ema_record.channels import MOTOR_SPEED
from ema_record.errors import OutputError, UsageError
from ema_record.kit import ACTUATOR as ACTUATOR_FILE
from ema_record.kit import kit_path
from ema_record.profile import load_profile, step_profile
from ema_record.record import Record
from ema_record.spread import load_spread, moderated
from support.simulations import record_of

ACTUATOR = load_actuator()


SLOPES = np.array([[1.0, 0.3, 0.0], [0.0, 1.0, 0.0], [0.2, 0.0, 0.0]])
PRIOR = np.array([0.4, 0.7, 1.0])


def drawn(rng: np.random.Generator, noisy: int) -> tuple[np.ndarray, np.ndarray]:
    """Return parameters of tests, shape (200, 3), and features of which `noisy` say nothing."""
    parameters = rng.standard_normal((200, 3)) * PRIOR
    shown = parameters @ SLOPES.T + 0.01 * rng.standard_normal((200, 3))
    return parameters, np.hstack([shown, rng.standard_normal((200, noisy))])


def test_parameters_of_a_linear_machine_come_out_among_features_that_say_nothing() -> None:
    rng = np.random.default_rng(1)
    parameters, features = drawn(rng, 100)
    truth = np.array([0.3, -0.5, 0.8])
    measured = np.concatenate([SLOPES @ truth, rng.standard_normal(100)])
    error = np.array([0.03] * 3 + [1.0] * 100)
    found, covariance = estimate(parameters, features, measured, PRIOR, error, 10_000)
    left = np.sqrt(np.diag(covariance))
    assert found[:2] == pytest.approx(truth[:2], abs=0.06)
    assert max(left[:2]) < 0.08
    # Nothing shows the third: the estimate stays at the prior, and says so.
    assert abs(found[2]) < 0.5
    assert left[2] == pytest.approx(1.0, abs=0.2)


def test_the_estimate_is_that_of_bayes_and_its_error_is_said() -> None:
    rng = np.random.default_rng(2)
    parameters, features = drawn(rng, 0)
    error = np.array([0.2, 0.3, 0.4])
    truth, wanted = PRIOR * rng.standard_normal((400, 3)), []
    for one in truth:
        measured = SLOPES @ one + 0.01 * rng.standard_normal(3) + (
            error * rng.standard_normal(3))
        found, covariance = estimate(parameters, features, measured, PRIOR, error, 10_000)
        wanted.append((found - one) / np.sqrt(np.diag(covariance)))
    spread = np.std(wanted, axis=0)
    assert spread == pytest.approx([1.0, 1.0, 1.0], abs=0.12)


def test_a_feature_that_no_parameter_explains_moves_none() -> None:
    rng = np.random.default_rng(3)
    parameters, features = drawn(rng, 0)
    truth = np.array([0.3, -0.5, 0.0])
    measured = SLOPES @ truth + [0.0, 0.0, 20.0]  # 400 of its errors, of the weak third feature
    found, _ = estimate(parameters, features, measured, PRIOR, np.full(3, 0.05), 10_000)
    assert found[:2] == pytest.approx(truth[:2], abs=0.1)


def test_what_is_known_of_two_parameters_together_is_known_in_each_draw() -> None:
    # The records tell the sum of two logarithms, and of neither alone more than the prior.
    covariance = np.array([[0.04, -0.0396], [-0.0396, 0.04]])
    names = ("motor.dynamic_friction", "motor.viscous_friction", "control.integral_gain")
    covariance = np.pad(covariance, (0, 1))
    covariance[2] = covariance[:, 2] = [0.004, -0.004, 0.04]  # of the last all of its prior
    calibration = Calibration(actuator=ACTUATOR, changes=dict.fromkeys(names, 1.0),
                              covariance=covariance, names=(), before=np.empty(0),
                              after=np.empty(0))
    assert calibration.open == pytest.approx(dict.fromkeys(names, 0.2))
    rng = np.random.default_rng(5)
    types = [calibration.draw(rng) for _ in range(400)]
    drawn = [one.motor for one in types]
    assert {one.control.integral_gain for one in types} == {ACTUATOR.control.integral_gain}
    steps = np.log([[m.dynamic_friction, m.viscous_friction] for m in drawn]) - np.log(
        [ACTUATOR.motor.dynamic_friction, ACTUATOR.motor.viscous_friction])
    # Normal numbers clipped to two deviations have 0.96 of theirs; beside the gain, which stays,
    # both are known a little better.
    among = covariance[:2, :2] - np.outer(covariance[:2, 2], covariance[:2, 2]) / 0.04
    assert steps.std(axis=0) == pytest.approx(0.96 * np.sqrt(np.diag(among)), rel=0.1)
    assert steps.sum(axis=1).std() == pytest.approx(0.96 * np.sqrt(among.sum()), rel=0.1)


def test_what_is_not_known_of_the_type_is_part_of_its_tolerances() -> None:
    old = load_spread().tolerances
    left = {"motor.phase_resistance": 0.03, "motor.viscous_friction": 0.2,
            "shaft.damping": 0.4, "shaft.stiffness": 0.2,
            "control.position_gain": 0.03, "control.integral_gain": 0.04}
    new = wider(old, ACTUATOR, left)
    assert new.resistance**2 / 3 == pytest.approx(old.resistance**2 / 3 + 0.03**2, rel=1e-2)
    assert np.log(new.viscous_factor)**2 / 3 == pytest.approx(
        np.log(old.viscous_factor)**2 / 3 + 0.2**2, rel=1e-2)
    assert new.control_gain**2 / 3 == pytest.approx(old.control_gain**2 / 3 + 0.03**2, rel=1e-2)
    assert new.stiffness**2 / 3 == pytest.approx(old.stiffness**2 / 3 + 0.2**2, rel=1e-2)
    assert new.damping == old.damping  # four fifths of the prior are left
    assert new.inertia == old.inertia
    assert wider(old._replace(stiffness=0.79), ACTUATOR, left).stiffness == 0.8  # the most


def test_static_friction_moves_with_the_dynamic_one_and_no_latency_falls_below_zero() -> None:
    more = changed(ACTUATOR, "motor.dynamic_friction", 0.5)
    ratio = ACTUATOR.motor.static_friction / ACTUATOR.motor.dynamic_friction
    assert more.motor.static_friction / more.motor.dynamic_friction == pytest.approx(ratio)
    for name in LATENCIES:
        assert changed(ACTUATOR, name, -1.0).acquisition == ACTUATOR.acquisition
        moved = changed(ACTUATOR, name, 1.5).acquisition
        assert getattr(moved, name.split(".")[1]) == 1.5


def test_a_flat_top_of_none_is_no_parameter_and_ends_nothing() -> None:
    pointed = ACTUATOR._replace(motor=ACTUATOR.motor._replace(flat_top=0.0))
    assert "motor.flat_top" not in parameters_of(pointed)
    assert _deviations(load_spread().tolerances, pointed)["motor.flat_top"] == 0.0


def test_only_a_relay_shows_its_band() -> None:
    foc = ACTUATOR._replace(drive=ACTUATOR.drive._replace(kind=2))
    assert "inverter.hysteresis" in parameters_of(ACTUATOR)
    assert not {"inverter.hysteresis", "motor.phase_inductance"} & set(parameters_of(foc))


def rows_of(offset: float, units: int) -> tuple[np.ndarray, np.ndarray]:
    """Return features of two records a unit, alternating about `offset`, and their units."""
    own = np.resize([-0.5, 0.5], units)
    return np.repeat(offset + own, 2)[:, None], np.repeat(np.arange(units), 2)


def test_what_is_no_larger_than_its_error_is_no_discrepancy() -> None:
    zero, one = np.zeros(1), np.ones(1)
    rows, units = rows_of(0.2, 4)
    assert fit_discrepancy(["torque_full"], rows, units, zero, one).mean == [0.0]
    rows, units = rows_of(5.0, 4)
    found = fit_discrepancy(["torque_full"], rows, units, zero, one)
    share = 1.0 - 0.25 / 25.0  # error: the spread over the root of four units
    assert found.mean == pytest.approx([5.0 * share])
    assert found.spread == pytest.approx([np.sqrt(share * 0.25)])
    condition = fit_discrepancy(["load_quarter"], rows, units, zero, one)
    assert (condition.mean, condition.spread) == ([0.0], [0.0])


def test_variances_of_few_units_are_drawn_together_as_far_as_chance_goes() -> None:
    rng = np.random.default_rng(8)
    alike = rng.chisquare(3, 400) / 3  # all true ratios are 1: what differs is chance
    assert moderated(alike, 3) == pytest.approx(np.ones(400), abs=0.25)
    truth = 6.0 / rng.chisquare(6, 2000)  # of the prior: 6 degrees of freedom
    measured = truth * rng.chisquare(3, 2000) / 3
    found = moderated(measured, 3)
    assert np.mean(np.log(found / truth)**2) < 0.5 * np.mean(np.log(measured / truth)**2)
    assert found == pytest.approx((6.0 + 3.0 * measured) / 9.0, rel=0.2)


def test_the_discrepancy_of_a_unit_is_that_of_all_its_records() -> None:
    n = 6
    fleet = FleetFeatures(
        names=("a", "b"), baseline=np.zeros((n, 2)), record=np.ones((n, 2)),
        severity=np.zeros((n, 8)), unit=np.repeat([0, 1, 2], 2), friction=np.zeros((n, 2)))
    found = with_discrepancy(
        fleet, DiscrepancyPart(names=["b"], mean=[3.0], spread=[2.0]), seed=1)
    assert found.record[:, 0].tolist() == [1.0] * n
    added = found.record[:, 1] - 1.0
    assert added == pytest.approx(found.baseline[:, 1])
    assert added[0::2] == pytest.approx(added[1::2])
    assert len(set(added)) == 3


def saved(folder: Path, name: str, record: Record, serial: str, actuator: str = "") -> Path:
    """Write a record of a unit as a bag."""
    provenance = replace(record.provenance, serial_number=serial, actuator=actuator)
    return write_bag(replace(record, provenance=provenance), folder / name)


def test_acceptance_records_that_cannot_serve_are_named(tmp_path: Path) -> None:
    step = record_of("step", seed=3)
    one, *more = (saved(tmp_path, f"one{k}", record_of("step", seed=3 + k), "A")
                  for k in range(4))
    with pytest.raises(UsageError, match=r"^1 acceptance records, 4 to 1000"):
        read_acceptance([one], ACTUATOR)
    with pytest.raises(UsageError, match="all records are of unit A, at least 2"):
        read_acceptance([one, *more], ACTUATOR)
    with pytest.raises(UsageError, match=r"one0: the record of .*one0 once more"):
        read_acceptance([one, *more, one], ACTUATOR)
    unnamed = [saved(tmp_path, f"u{k}", step, "unknown") for k in range(2)]
    with pytest.raises(UsageError, match="once more"):  # they would count as two units
        read_acceptance([*unnamed, *more], ACTUATOR)
    other = saved(tmp_path, "other", step, "B", actuator="f" * 16)
    own = saved(tmp_path, "own", step, "A", actuator="e" * 16)
    with pytest.raises(UsageError, match="other"):
        read_acceptance([own, *more, other], ACTUATOR)
    with pytest.raises(UsageError, match=r"gone: "):
        read_acceptance([*more, tmp_path / "gone"], ACTUATOR)
    short = replace(step, profile=step_profile(0.1))
    with pytest.raises(UsageError, match="short"):
        read_acceptance([*more, saved(tmp_path, "short", short, "B")], ACTUATOR)


def test_the_recorder_is_measured_and_not_assumed() -> None:
    assert load_profile("step").inverter_off == pytest.approx(0.02)
    always = load_spread().conditions._replace(noise_least=1.0, noise_most=1.0)
    found = measured_recorder(ACTUATOR, [record_of("step", seed=3)], always)
    assert found.noise.current == pytest.approx(ACTUATOR.noise.current, rel=0.15)
    assert found.noise.speed == pytest.approx(ACTUATOR.noise.speed, rel=0.15)
    assert found.acquisition.converters == 1
    fine = record_of("step", seed=3)
    rng = np.random.default_rng(0)
    fine = replace(fine, samples=fine.samples + 1e-6 * rng.standard_normal(fine.samples.shape))
    assert measured_recorder(ACTUATOR, [fine], always).acquisition.converters == 0
    varying = always._replace(noise_least=0.25)  # its middle is half of the most
    assert measured_recorder(ACTUATOR, [fine], varying).noise == ACTUATOR.noise
    quiet = ACTUATOR._replace(noise=ACTUATOR.noise._replace(current=0.1 * ACTUATOR.noise.current))
    assert measured_recorder(quiet, [fine], varying).noise.current == pytest.approx(
        2.0 * ACTUATOR.noise.current, rel=0.15)


def test_a_shaft_that_unwinds_at_rest_is_no_noise() -> None:
    always = load_spread().conditions._replace(noise_least=1.0, noise_most=1.0)
    record = record_of("step", seed=3)
    moving = record.samples.copy()
    moving[:, MOTOR_SPEED] += 15.0 * ACTUATOR.noise.speed * np.exp(-record.time / 0.006)
    assert moving[record.at_rest, MOTOR_SPEED].std() > 2.0 * ACTUATOR.noise.speed
    found = measured_recorder(ACTUATOR, [replace(record, samples=moving)], always)
    assert found.noise.speed == pytest.approx(ACTUATOR.noise.speed, rel=0.15)


def test_a_described_noise_stays_where_all_records_may_have_it() -> None:
    """Tests of 0.25 to 2 times the noise: a few of them tell its middle only roughly."""
    conditions = load_spread().conditions._replace(noise_least=0.25, noise_most=2.0)
    rng = np.random.default_rng(4)
    tests = 0.3 * np.exp(rng.uniform(np.log(0.25), np.log(2.0), (1000, 8)))
    assert {noise_level(0.3, row, conditions) for row in tests} == {0.3}
    for wrong in (0.0, 0.03, 3.0):  # by a factor of ten: what is measured counts
        found = np.log([noise_level(wrong, row, conditions) / 0.3 for row in tests])
        assert abs(found.mean()) < 0.02
        assert found.std() == pytest.approx(np.log(8.0) / np.sqrt(2.0 * 9.0 * 10.0), rel=0.1)
    quiet = conditions._replace(noise_least=0.0, noise_most=0.0)
    assert np.isfinite(noise_level(0.0, np.array([0.1, 0.2]), quiet))


def test_a_model_that_does_not_give_the_records_is_refused() -> None:
    names = ["torque_full", "torque_quarter", "inertia", "shaft_slope", "rise_time"]
    rows, spread = np.full((4, 5), 20.0), np.ones(5)
    with pytest.raises(UsageError, match="the description does not give these records"):
        check_described(names, rows, np.zeros(5), spread)
    check_described(names, rows, np.full(5, 19.0), spread)


def test_a_faulty_unit_among_the_healthy_is_named() -> None:
    good = {"bag": "a", "serial_number": "1", "left_out": "healthy"}
    bad = {"bag": "b", "serial_number": "2", "left_out": "turn_short"}
    rates = {"extended": {"fleet": {"false alarms": {"count": 0, "total": 100}}}}
    none = {"hits": 0, "total": 2}
    check_good({"records": [good, good], "healthy_left_out_unknown": none, "held_out": rates})
    with pytest.raises(UsageError, match=r"b \(unit 2\) is judged as turn short"):
        check_good({"records": [good, bad], "healthy_left_out_unknown": none, "held_out": rates})
    with pytest.raises(UsageError, match="1 of 2 acceptance records left out are unknown"):
        check_good({"records": [good, {**good, "left_out": "unknown"}],
                    "healthy_left_out_unknown": {"hits": 1, "total": 2}, "held_out": rates})
    rates["extended"]["fleet"]["false alarms"]["count"] = 2
    with pytest.raises(UsageError, match="2 of 100 healthy tests"):
        check_good({"records": [good], "healthy_left_out_unknown": none, "held_out": rates})


def test_a_refusal_before_any_work_leaves_nothing(tmp_path: Path) -> None:
    one = saved(tmp_path, "one", record_of("step", seed=3), "A")
    with pytest.raises(UsageError, match="1 acceptance records"):
        commission([one], kit_path(ACTUATOR_FILE), tmp_path / "kit")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one"]


def test_a_folder_of_somebody_else_is_not_taken_for_a_draft(tmp_path: Path) -> None:
    mine = tmp_path / "kit.unfinished"
    mine.mkdir()
    (mine / "notes.txt").write_text("precious")
    with pytest.raises(OutputError, match="exists and is no kit that was begun here"):
        commission([tmp_path / "gone"], kit_path(ACTUATOR_FILE), tmp_path / "kit")
    assert (mine / "notes.txt").read_text() == "precious"


def test_a_draft_has_the_tests_of_the_description_as_it_is_and_one_maker(tmp_path: Path) -> None:
    mine, draft = tmp_path / "actuator.yaml", tmp_path / "kit.unfinished"
    text = kit_path(ACTUATOR_FILE).read_text(encoding="utf-8")
    mine.write_text(text)
    with own_draft(draft):
        make_draft(mine, draft)
        before = (draft / "profiles" / "extended.yaml").read_text()
        stop = str(ACTUATOR.surface.end_stop)
        assert text.count(f"end_stop: {stop}") == 1
        mine.write_text(text.replace(f"end_stop: {stop}", "end_stop: 0.3"))
        make_draft(mine, draft)
        assert (draft / "profiles" / "extended.yaml").read_text() != before
        with pytest.raises(OutputError, match="another process"), own_draft(draft):
            raise AssertionError("two at once")


@pytest.mark.parametrize("text", ["\0", "motor: {}\nmotor: {}\n", "motr: {}\n", "drive: {}\n"])
def test_a_description_that_is_none_is_named_and_leaves_nothing_behind(tmp_path, text):
    mine = tmp_path / "mine.yaml"
    mine.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError) as caught:
        commission([tmp_path / "record"], mine, tmp_path / "kit")
    assert str(mine) in str(caught.value) and "unfinished" not in str(caught.value)
    assert list(tmp_path.iterdir()) == [mine]
