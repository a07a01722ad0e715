"""Inject an effect, get its name back: shipped model, real simulation, unseen seeds."""

import dataclasses

import numpy as np
import pytest

from ema_prognostics.cascade.model_file import load_model
from ema_prognostics.verdict.diagnose import diagnose
from ema_record.actuator import load_actuator
from ema_record.channels import TIME
from ema_record.errors import UsageError
from ema_record.profile import load_profile, load_profile_dict, step_profile
from ema_record.record import Provenance, Record
from support import simulations

PROFILES = ("step", "extended")


@pytest.fixture(scope="module")
def model():
    return load_model()


def record_of(profile, *effects, seed=77_001, **options):
    return simulations.record_of(profile, *effects, seed=seed, **options)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("seed", range(77_001, 77_011))
def test_healthy(model, profile, seed):
    verdict = diagnose(record_of(profile, seed=seed), model)
    assert verdict.outcome == "healthy", verdict.reasons
    assert verdict.exit_status == 0
    assert verdict.probabilities["healthy"] > 0.5


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("mode", ["paper", "physical"])
@pytest.mark.parametrize("phase", ["a", "b", "c"])
@pytest.mark.parametrize("fraction", [0.03, 0.10, 0.25])
def test_turn_short_with_its_phase_and_size(model, profile, mode, phase, fraction):
    verdict = diagnose(record_of(
        profile, f"turn_short.fraction={fraction}", f"turn_short.phase={phase}",
        f"turn_short.mode={mode}",
    ), model)
    found = verdict.to_dict()
    assert found["fault_class"] == "turn_short", verdict.reasons
    assert found["phase"] == phase
    # Without a baseline the fleet's ±0.5 % of k a phase leaves ±0.7 % of the turns (90 %).
    assert found["severity"] == pytest.approx(fraction, rel=0.15, abs=0.008)
    low, high = found["severity_interval"]
    assert low <= found["severity"] <= high
    assert low <= fraction <= high
    assert found["level"] == {0.03: "small", 0.10: "medium", 0.25: "large"}[fraction]
    assert "rotor_eccentricity" in found["alternatives"]
    assert verdict.exit_status == 1


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(("mode", "bound"), [("paper", 1.3), ("common", 1.15), ("shifted", 1.7)])
@pytest.mark.parametrize("zeta", [0.03, -0.03, 0.08])
def test_rotor_eccentricity(model, profile, mode, bound, zeta):
    """The size is right within a factor that depends on how the eccentricity shows.

    Over nine records a case the size was 0.93 to 1.09 of the truth in mode common, 0.81 to 1.09
    in mode paper and, on the extended test, 0.63 to 0.82 in mode shifted, whose size is said too
    small: there the interval misses the truth in five of nine.
    """
    verdict = diagnose(record_of(
        profile, f"rotor_eccentricity.zeta={zeta}", f"rotor_eccentricity.mode={mode}"
    ), model)
    assert [f.fault_class for f in verdict.faults] == ["rotor_eccentricity"], verdict.reasons
    low, high = verdict.faults[0].severity_interval
    assert 1.0 / bound < verdict.faults[0].severity / abs(zeta) < bound
    if profile == "step" or mode == "common":
        assert low <= abs(zeta) <= high


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(
    "effect",
    ["motor_friction.increase=0.5", "motor_friction.increase=1.5",
     "surface_friction.increase=0.5", "surface_friction.increase=1.5", "backlash.increase=0.001",
     "backlash.increase=0.003"],
)
@pytest.mark.parametrize("seed", [77_021, 77_022, 77_023])
def test_large_wear_is_never_called_healthy(model, profile, effect, seed, request):
    if profile == "step" and effect == "surface_friction.increase=0.5":
        request.applymarker(pytest.mark.xfail(
            reason="0.06 N m at the one speed of the step: grease twice as stiff gives the same"))
    verdict = diagnose(record_of(profile, effect, seed=seed), model)
    assert verdict.outcome != "healthy"
    assert verdict.exit_status in (1, 3)
    assert verdict.reasons
    name = "backlash" if "backlash" in effect else "friction"
    assert {f.fault_class for f in verdict.faults} <= {name}
    if profile == "extended":
        assert verdict.outcome == "fault"
        low, high = verdict.faults[0].severity_interval
        assert low <= float(effect.partition("=")[2]) <= high


@pytest.mark.parametrize(("mode", "angle"), [("static", 0.9), ("static", -2.0)])
def test_static_eccentricity_is_named_or_the_pair(model, mode, angle):
    verdict = diagnose(record_of(
        "extended", "rotor_eccentricity.zeta=0.08", f"rotor_eccentricity.mode={mode}",
        f"rotor_eccentricity.angle={angle}"), model)
    named = {f.fault_class for f in verdict.faults} | set(verdict.alternatives)
    assert "rotor_eccentricity" in named


@pytest.mark.parametrize(
    "effects",
    [("turn_short.fraction=0.08", "turn_short.phase=b", "motor_friction.increase=0.7"),
     ("rotor_eccentricity.zeta=0.05", "rotor_eccentricity.mode=common",
      "backlash.increase=0.001"),
     ("surface_friction.increase=0.9", "backlash.increase=0.001")],
)
def test_two_faults_are_both_named(model, effects):
    verdict = diagnose(record_of("extended", *effects), model)
    truth = {{"motor_friction": "friction", "surface_friction": "friction"}.get(n, n)
             for n in (e.partition(".")[0] for e in effects)}
    assert {f.fault_class for f in verdict.faults} == truth, verdict.reasons


def test_baseline_finds_what_the_fleet_model_does_not(model):
    unit = {"actuator": load_actuator()}
    base = record_of("extended", seed=77_040, **unit)
    worn = record_of("extended", "motor_friction.increase=0.08", seed=77_041, **unit)
    assert diagnose(worn, model).outcome == "healthy"
    assert diagnose(worn, model, baseline=worn) == diagnose(worn, model)  # compares nothing
    verdict = diagnose(worn, model, baseline=base)
    assert [f.fault_class for f in verdict.faults] == ["friction"]
    again = record_of("extended", seed=77_042, **unit)
    assert diagnose(again, model, baseline=base).outcome == "healthy"
    little = record_of("extended", "motor_friction.increase=0.025", seed=77_043, **unit)
    verdict = diagnose(little, model, baseline=base)
    assert verdict.outcome == "unknown"
    assert verdict.alternatives == ("friction",)
    assert "too small" in verdict.reasons[0]


@pytest.mark.parametrize("seed", [77_051, 77_052])
def test_resistance_of_one_phase_is_no_short(model, seed):
    """A short takes inductance with the resistance."""
    record = record_of("extended", "phase_resistance_imbalance.increase=0.5", seed=seed)
    assert diagnose(record, model).outcome == "unknown"


def test_a_healthy_step_says_what_it_cannot_rule_out(model):
    assert diagnose(record_of("step"), model).alternatives == ("backlash", "friction")
    assert diagnose(record_of("extended"), model).alternatives == ()


@pytest.mark.parametrize("rate", [10_000.0, 50_000.0])
def test_another_sample_rate(model, rate):
    healthy = diagnose(record_of("step", rate=rate), model)
    assert healthy.outcome == "healthy", healthy.reasons
    short = diagnose(record_of("step", "turn_short.fraction=0.1", rate=rate), model)
    assert short.faults[0].severity == pytest.approx(0.1, rel=0.15)


@pytest.mark.parametrize(("size", "start"), [(0.7, -0.35), (-0.8, 0.4)])
def test_steps_of_other_sizes_and_signs(model, size, start):
    profile = step_profile(size, start=start)
    assert diagnose(record_of(profile), model).outcome == "healthy"
    verdict = diagnose(record_of(profile, "turn_short.fraction=0.1", "turn_short.phase=c"), model)
    assert (verdict.faults[0].fault_class, verdict.faults[0].phase) == ("turn_short", "c")


def test_a_test_that_nobody_trained_on(model):
    verdict = diagnose(record_of(step_profile(0.2)), model)
    assert verdict.outcome == "unknown"
    assert "not one that the networks know" in verdict.reasons[0]


@pytest.mark.parametrize("status", ["aborted", "interrupted"])
def test_aborted_records(model, status):
    record = dataclasses.replace(record_of("step"), provenance=Provenance(status=status))
    verdict = diagnose(record, model)
    assert (verdict.outcome, verdict.exit_status) == ("incomplete", 3)


def test_cut_and_gapped_records(model):
    record = record_of("step")
    cut = dataclasses.replace(record, samples=record.samples[:5000])
    assert diagnose(cut, model).outcome == "incomplete"
    gapped = dataclasses.replace(record, samples=np.delete(record.samples, [4000, 4001], axis=0))
    verdict = diagnose(gapped, model)
    assert verdict.outcome == "incomplete"
    assert "2 samples are missing" in verdict.reasons[0]
    empty = dataclasses.replace(record, samples=record.samples[:0])
    assert diagnose(empty, model).outcome == "incomplete"


@pytest.mark.parametrize("column", range(10))
def test_values_that_are_not_finite(model, column):
    record = record_of("step")
    record.samples[3000, column] = np.nan
    verdict = diagnose(record, model)
    assert (verdict.outcome, verdict.exit_status) == ("invalid", 2)


def test_time_that_runs_back(model):
    record = record_of("step")
    record.samples[3000, TIME] -= 0.01
    assert diagnose(record, model).outcome == "invalid"


def test_an_actuator_that_did_not_move_is_unknown(model):
    record = record_of("step", "motor_friction.increase=5.0")
    verdict = diagnose(record, model)
    assert verdict.outcome == "unknown"


@pytest.mark.parametrize("column", [1, 2, 3, 4, 8, 9])
def test_a_dead_sensor_is_never_healthy(model, column):
    record = record_of("step")
    record.samples[:, column] = record.samples[0, column]
    assert diagnose(record, model).outcome not in ("healthy", "fault")


def test_noise_alone_is_no_verdict(model):
    rng = np.random.default_rng(3)
    record = record_of("step")
    samples = rng.normal(size=record.samples.shape)
    samples[:, TIME] = record.samples[:, TIME]
    assert diagnose(Record(samples=samples, profile=record.profile), model).outcome == "unknown"


def test_same_record_same_verdict(model):
    record = record_of("extended", "turn_short.fraction=0.05")
    assert diagnose(record, model).to_dict() == diagnose(record, model).to_dict()


def test_paper_mode_knows_no_healthy_actuator(model):
    verdict = diagnose(record_of("step"), model, mode="paper")
    assert verdict.outcome == "fault"
    assert set(verdict.probabilities) == {"turn_short", "rotor_eccentricity"}
    short = diagnose(
        record_of("step", "turn_short.fraction=0.2", "turn_short.mode=paper"), model, mode="paper"
    )
    assert (short.faults[0].fault_class, short.faults[0].level) == ("turn_short", "large")
    with pytest.raises(UsageError, match="mode"):
        diagnose(record_of("step"), model, mode="luck")


def test_the_name_of_the_profile_does_not_matter(model):
    record = record_of("extended", "turn_short.fraction=0.1")
    data = {**load_profile("extended").model_dump(), "name": "commanded"}
    renamed = dataclasses.replace(record, profile=load_profile_dict(data, "x"))
    assert diagnose(renamed, model).faults == diagnose(record, model).faults
