"""The control law as measured on records: its gains, and what they say about the controller."""

from dataclasses import replace

import pytest

from ema_identification.actuator.measure.control_law import control_law, measured_gains
from ema_record.channels import MOTOR_SPEED, REFERENCE_CURRENTS
from ema_record.profile import load_profile
from ema_sim.effects import Effects
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate

MODEL = load_model_file(None)
PROFILE = load_profile("extended")


def effect(name, **settings):
    return Effects()._replace(**{name: getattr(Effects(), name)._replace(**settings)})


def record(effects=None, *, seed=1, **control):
    actuator = MODEL.actuator
    actuator = actuator._replace(control=actuator.control._replace(**control))
    return simulate(PROFILE, actuator=actuator, effects=effects, seed=seed)


@pytest.mark.parametrize("effects", [
    None, effect("motor_friction", increase=1.0), effect("backlash", increase=3e-3),
    effect("hall_misalignment", angle=0.15), effect("quantisation", speed_bits_lost=3.0),
])
def test_whatever_the_drive_does_the_controller_measures_as_it_is(effects):
    found = measured_gains(record(effects), MODEL.actuator)
    assert found.proportional == pytest.approx(0.30, rel=0.1)
    assert found.integral == pytest.approx(60.0, rel=0.15)


@pytest.mark.parametrize(("gain", "integral"), [(0.12, 60.0), (0.30, 18.0), (0.45, 90.0)])
def test_other_gains_are_measured(gain, integral):
    changed = record(proportional_gain=gain, integral_gain=integral)
    found = measured_gains(changed, MODEL.actuator)
    assert found.proportional == pytest.approx(gain, rel=0.1)
    assert found.integral == pytest.approx(integral, rel=0.15)


@pytest.mark.parametrize(("command", "reference"), [(0.4, 0.0), (2.0, 0.0), (1.3, 1.7)])
def test_latencies_change_no_gain(command, reference):
    acquisition = MODEL.actuator.acquisition._replace(
        command_latency=command, reference_latency=reference)
    late = simulate(PROFILE, actuator=MODEL.actuator._replace(acquisition=acquisition), seed=3)
    found = measured_gains(late, MODEL.actuator)
    assert found.proportional == pytest.approx(0.30, rel=0.1)
    assert found.integral == pytest.approx(60.0, rel=0.15)


def test_a_record_of_another_rate_too_short_or_without_references_tells_nothing():
    actuator = MODEL.actuator
    faster = simulate(PROFILE, actuator=actuator, seed=1, rate=40e3)
    assert measured_gains(faster, actuator) is None
    whole = record()
    assert measured_gains(replace(whole, samples=whole.samples[:50]), actuator) is None
    silent = whole.samples.copy()
    silent[:, REFERENCE_CURRENTS] = 0.0
    assert measured_gains(replace(whole, samples=silent), actuator) is None


def law_of(measured):
    return control_law(measured, record(seed=2), MODEL.actuator)


def test_the_law_holds_whatever_the_drive_does():
    assert law_of(record(effect("motor_friction", increase=1.0))).holds


@pytest.mark.parametrize("control", [
    {"integral_gain": 18.0}, {"proportional_gain": 0.12}, {"speed_limit": 650.0}])
def test_another_controller_is_another_law(control):
    law = law_of(record(**control))
    assert not law.holds
    assert "the model's are 0.30 and 60" in law.text


def test_a_command_that_acts_a_period_later_is_no_other_law_beside_a_run_that_does():
    acquisition = MODEL.actuator.acquisition._replace(command_latency=1.0)
    late = [simulate(PROFILE, actuator=MODEL.actuator._replace(acquisition=acquisition), seed=s)
            for s in (1, 2)]
    assert control_law(*late, MODEL.actuator).holds


def test_a_delay_changes_the_law():
    assert not law_of(record(effect("control_delay", delay=3e-4))).holds


def test_a_speed_that_the_record_holds_otherwise_than_the_loop_read_it_breaks_the_law():
    read = record()
    samples = read.samples.copy()
    samples[:, MOTOR_SPEED] *= 1.04
    assert not law_of(replace(read, samples=samples)).holds
