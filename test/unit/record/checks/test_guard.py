"""What forbids a verdict: broken sensors and broken recordings, never a broken actuator."""

from dataclasses import replace

import numpy as np
import pytest

from ema_prognostics.verdict.diagnose import diagnose
from ema_prognostics.verdict.judge import forbidden
from ema_record.checks.guard import OUTCOMES, SENSOR_RULES, guard_findings, outcome_of, reason_of
from ema_record.errors import UsageError
from ema_record.profile import load_profile, step_profile
from ema_record.record import Provenance
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate
from support.simulations import column

SPEED, POSITION, ANGLE = 1, 9, 8
ROW = 2000
WORST = (
    "surface_load.constant={load}", "winding_temperature.temperature={temperature}",
    "current_sensor_gain.phase_a=0.01", "current_sensor_gain.phase_b=-0.01",
    "current_sensor_offset.phase_a=0.05", "current_sensor_offset.phase_c=-0.05",
)


@pytest.fixture(scope="module")
def extended():
    return simulate(load_profile("extended"), seed=3)


@pytest.fixture(scope="module")
def step():
    return simulate(load_profile("step"), seed=3)


def rules(record):
    return [finding.rule for finding in guard_findings(record)]


def one_missing(x):
    return np.where(np.arange(len(x)) == 3000, np.nan, x)


def noise(deviation):
    return lambda x: np.random.default_rng(5).normal(0.0, deviation, len(x))


SENSOR_FAULTS = {
    "stuck": ("stuck_channel", (SPEED, 2, 3, 4, POSITION, ANGLE),
              lambda x: np.concatenate([x[:ROW], np.full(len(x) - ROW, x[ROW])])),
    "scaled": ("sensor_scale", (SPEED, 2, 3, 4, POSITION), lambda x: 1.1 * x),
    "shrunk": ("sensor_scale", (SPEED, 2, 3, 4, POSITION), lambda x: 0.9 * x),
    "offset": ("sensor_offset", (2, 3, 4), lambda x: x + (np.arange(len(x)) > ROW)),
    "at rest": ("sensor_offset", (2, 3, 4), lambda x: x - 1.0),
    "jumping speed": ("sensor_offset", (SPEED,), lambda x: x + 30.0 * (np.arange(len(x)) > ROW)),
    "noisy current": ("sensor_noise", (2, 3, 4), lambda x: x + noise(1.0)(x)),
    "noisy speed": ("sensor_noise", (SPEED,), lambda x: x + noise(20.0)(x)),
    "noisy position": ("sensor_noise", (POSITION,), lambda x: x + noise(1e-3)(x)),
    "held": ("held_samples", (2, 3, 4),
             lambda x: x[np.arange(len(x)) // 2 * 2]),
    "out for 5 ms": ("stuck_channel", (2, 3, 4),
                     lambda x: np.where(np.arange(len(x)) // 100 == ROW // 100, 0.0, x)),
    "held for 5 ms": ("stuck_channel", (SPEED,),
                      lambda x: np.where(np.arange(len(x)) // 100 == ROW // 100, x[ROW], x)),
    "cut off": ("saturation", (2, 3, 4), lambda x: np.clip(x, -2.0, 2.0)),
}


@pytest.mark.parametrize(("name", "index"), [
    (name, index) for name, (_, columns, _) in SENSOR_FAULTS.items() for index in columns
])
def test_sensor_faults_are_named(step, name, index):
    rule, _, law = SENSOR_FAULTS[name]
    found = guard_findings(column(index, law)(step))
    assert rule in [f.rule for f in found]
    assert outcome_of(found) == "unknown"
    assert reason_of(found[0]).startswith("sensor fault, ")


def test_all_currents_scaled_alike_are_told_by_their_references(extended):
    (finding,) = guard_findings(column(slice(2, 5), lambda x: 1.1 * x)(extended))
    assert finding.rule == "sensor_scale" and finding.size == pytest.approx(1.1, abs=0.02)


def test_the_broken_sensor_is_named_with_its_size(step, extended):
    (finding,) = guard_findings(column(3, lambda x: 1.1 * x)(extended))
    assert finding.channel == "phase_current_b" and finding.size == pytest.approx(0.1, abs=0.01)
    (finding,) = guard_findings(column(4, lambda x: x + (np.arange(len(x)) >= ROW))(step))
    assert finding.size == pytest.approx(1.0, abs=0.1)
    assert finding.time == pytest.approx(step.time[ROW], abs=0.03)


@pytest.mark.parametrize(("law", "rule", "outcome"), [
    (lambda r: replace(r, samples=np.delete(r.samples, slice(3000, 3400), axis=0)), "gap",
     "incomplete"),
    (lambda r: replace(r, samples=r.samples[:-200]), "record_length", "incomplete"),
    (lambda r: replace(r, provenance=Provenance(status="aborted")), "test_not_complete",
     "incomplete"),
    (column([2, 3], lambda x: x[:, ::-1]), "swapped_phases", "invalid"),
    (column(SPEED, np.negative), "sign_flip", "invalid"),
    (column(2, lambda x: 1e3 * x), "wrong_unit", "invalid"),
    (column(0, lambda x: x + 0.05 * (np.arange(len(x)) >= 3000)), "clock_jump", "invalid"),
    (column(4, one_missing), "not_finite", "invalid"),
    (column(0, lambda x: 1.024 * x), "sensor_scale", "unknown"),
    (lambda r: replace(r, profile=step_profile(0.5)), "wrong_profile", "invalid"),
])
def test_broken_records_forbid_a_verdict(step, law, rule, outcome):
    record = law(step)
    found = guard_findings(record)
    assert rule in [f.rule for f in found]
    assert outcome_of(found) == outcome
    verdict = forbidden(record)
    assert verdict.outcome == outcome
    assert rule.replace("_", " ") in verdict.reasons[0]


def test_a_value_that_is_no_number_is_no_gap(step):
    for index in (0, 4):
        assert rules(column(index, one_missing)(step)) == ["not_finite"]


@pytest.mark.parametrize("fault", [
    [], ["turn_short.fraction=0.6", "turn_short.phase=c"], ["turn_short.fraction=0.02"],
    ["rotor_eccentricity.zeta=0.4", "rotor_eccentricity.mode=shifted"],
    ["rotor_eccentricity.zeta=-0.3", "rotor_eccentricity.mode=common"],
    ["motor_friction.increase=1.5"], ["surface_friction.increase=3"],
    ["backlash.increase=0.01"], ["backlash.increase=0.04"],
    ["turn_short.fraction=0.2", "surface_friction.increase=1"],
])
@pytest.mark.parametrize("case", [("step", 0.5, -19, -40), ("extended", 2.0, 19, 70)])
def test_faults_of_the_actuator_forbid_nothing(fault, case):
    name, level, load, temperature = case
    conditions = [text.format(load=load, temperature=temperature) for text in WORST]
    record = simulate(load_profile(name), effects=parse_effects([*conditions, *fault]), seed=8,
                      noise=level)
    assert guard_findings(record) == ()
    assert forbidden(record) is None


@pytest.mark.parametrize("rate", [16_000.0, 50_000.0, 100_000.0])
def test_a_rate_that_is_little_off_is_no_obstacle(rate):
    assert rules(simulate(load_profile("step"), seed=6, noise=2.0, rate=rate)) == []


@pytest.mark.parametrize("rate", [5_000.0, 10_000.0, 200_000.0])
def test_at_another_rate_features_are_others(rate):
    """Of healthy units at 4 kHz a third were called faulty, at 10 kHz one in eleven."""
    record = simulate(load_profile("step"), seed=6, rate=rate)
    assert rules(record) == ["sample_rate"]
    assert forbidden(record).outcome == "unknown"


@pytest.mark.parametrize(("amplitude", "found"), [
    (0.0, []), (0.005, []), (0.02, ["sensor_scale"])])
@pytest.mark.parametrize("profile", ["step", "extended"])
def test_a_speed_that_is_off_once_a_turn(profile, amplitude, found):
    """What makes torque pulses as an eccentric rotor does, but not in the rotor angle."""
    effects = parse_effects([f"speed_sensor_runout.amplitude={amplitude}",
                             "speed_sensor_runout.angle=1.0"])
    assert rules(simulate(load_profile(profile), seed=4, effects=effects)) == found


@pytest.mark.parametrize("column", range(1, 10))
@pytest.mark.parametrize("value", [np.finfo(float).max, -1e300, np.inf])
def test_a_mark_of_no_value_stops_nothing(step, column, value):
    samples = step.samples.copy()
    samples[ROW, column] = value
    assert guard_findings(replace(step, samples=samples)) != ()


def test_readings_that_were_not_measured_are_none(step):
    """So says NaN in a BatteryState; a record without the topic is judged too."""
    bus, winding = step.dc_bus.copy(), step.winding_temperature.copy()
    bus[:, 2], winding[3:, 1] = np.nan, np.nan
    record = replace(step, dc_bus=bus, winding_temperature=winding)
    assert rules(record) == []
    assert diagnose(record).outcome == "healthy"
    bus[::2, 1] = np.nan
    assert diagnose(replace(record, dc_bus=bus)).outcome == "healthy"


def test_a_longer_record_is_no_obstacle(step):
    more = np.concatenate([step.samples, step.samples[-400:]])
    more[:, 0] = (np.arange(len(more)) + 0.5) / 20_000
    assert "record_length" not in rules(replace(step, samples=more))


def test_every_rule_that_forbids_exists_and_sensors_are_among_them():
    from ema_record.checks.guard import RULES

    assert set(OUTCOMES) <= {rule.name for rule in RULES}
    assert set(OUTCOMES) >= SENSOR_RULES


@pytest.mark.parametrize("make", [
    list, np.asfortranarray, lambda x: x.astype(np.longdouble), lambda x: x.astype(object),
    lambda x: np.ma.masked_array(x, mask=False),
])
def test_arrays_of_any_kind_are_the_same_record(step, make):
    record = replace(step, samples=make(step.samples), dc_bus=make(step.dc_bus))
    assert type(record.samples) is np.ndarray
    np.testing.assert_array_equal(record.samples, step.samples)


def test_what_is_masked_was_not_measured(step):
    samples = np.ma.masked_array(step.samples, mask=False)
    samples[2000:6000, 3] = np.ma.masked
    assert rules(replace(step, samples=samples))[0] == "not_finite"


@pytest.mark.parametrize(("change", "problem"), [
    ({"samples": np.ones((9000, 10), dtype=complex)}, "samples: complex numbers"),
    ({"samples": [["a"] * 10]}, "samples: no array of numbers"),
    ({"dc_bus": np.ones(3)}, "dc_bus has shape"), ({"dc_bus": None}, "dc_bus"),
    ({"winding_temperature": np.ones((4, 3))}, "winding_temperature has shape"),
])
def test_no_array_of_numbers_is_one_line(step, change, problem):
    with pytest.raises(UsageError, match=problem):
        replace(step, **change)
