"""What a recorder is like shows on the bad side only; dry and viscous friction come apart."""

from __future__ import annotations

import numpy as np
import pytest

from ema_prognostics.features.consistency import consistency, detrended, floors, resolution
from ema_prognostics.features.control_loop import control_loop
from ema_prognostics.features.dry_friction import dry_and_viscous
from ema_prognostics.features.signals import prepare
from ema_record.actuator import load_actuator
from ema_record.profile import load_profile
from ema_sim.simulate import simulate

ACTUATOR = load_actuator()
SLEWS = {"full": (0.10, 0.36, 20)}
RECORDER = ("noise_speed", "noise_current", "noise_current_least", "sum_rms", "reference_sum",
            "position_step", "speed_step")


@pytest.mark.parametrize("step", [0.5, 0.122, 1e-4])
def test_the_step_of_a_converter_whatever_the_noise(step: float) -> None:
    x = np.random.default_rng(1).normal(size=3000)
    assert resolution(np.rint(x / step) * step) == pytest.approx(step, rel=1e-9)


def test_readings_that_are_not_rounded_have_next_to_no_step() -> None:
    assert resolution(np.random.default_rng(1).normal(size=3000)) < 1e-4
    assert resolution(np.full(100, 3.0)) == 0.0


def test_a_running_mean_leaves_no_drift() -> None:
    t = np.arange(200.0)
    assert np.abs(detrended(1e6 + 3.0 * t)).max() < 1e-6
    fast = np.where(t % 2, 1.0, -1.0)
    assert detrended(3.0 * t + fast).std() == pytest.approx(1.0 - 1.0 / 41, rel=0.01)


def quieter(noise: float, bits: int) -> dict[str, float]:
    """Return the features of the recorder of a step, as noisy and as coarse as that."""
    c = ACTUATOR.converters
    fine = ACTUATOR._replace(converters=c._replace(
        position_bits=bits, speed_bits=bits, current_bits=bits, angle_bits=bits))
    record = simulate(load_profile("step"), actuator=fine, noise=noise, seed=4)
    found = consistency(prepare(record), SLEWS)
    return {n: found[n] for n in RECORDER}


def test_quieter_finer_and_exactly_zero_are_all_alike() -> None:
    quarter = quieter(0.25, 32)
    for noise in (0.0, 0.01, 0.2):
        found = quieter(noise, 32)
        for name in RECORDER:  # within the scatter of a standard deviation of 400 samples
            assert found[name] == pytest.approx(quarter[name], abs=0.12), name
    assert all(np.isfinite(v) for v in quieter(0.0, 32).values())


def test_noisier_and_coarser_show() -> None:
    usual, noisy, coarse = quieter(1.0, 16), quieter(3.0, 16), quieter(1.0, 10)
    for name in ("noise_speed", "noise_current", "sum_rms"):
        assert noisy[name] > usual[name] + 0.9
    for name in ("position_step", "speed_step"):
        assert coarse[name] > usual[name] + 0.9


def test_floors_follow_the_declaration() -> None:
    c, n = ACTUATOR.converters, ACTUATOR.noise
    loud = ACTUATOR._replace(noise=n._replace(speed=4.0 * n.speed, current=4.0 * n.current))
    one, four = floors(ACTUATOR, 20e3), floors(loud, 20e3)
    assert four["speed"] == pytest.approx(4.0 * one["speed"])
    assert floors(loud, 5e3)["current"] == pytest.approx(0.5 * four["current"])
    step = c.speed_range / 2.0**c.speed_bits
    assert one["speed_step"] == pytest.approx(max(step, one["speed"]))


def test_a_controller_that_is_not_heard_counts_as_declared() -> None:
    record = simulate(load_profile("step"), noise=0.0, seed=2, actuator=ACTUATOR._replace(
        converters=ACTUATOR.converters._replace(speed_bits=32, position_bits=32)))
    found = control_loop(prepare(record), 0.10, 0.36)
    assert found["control_gain"] == pytest.approx(0.0, abs=0.1)
    heard = control_loop(prepare(simulate(load_profile("step"), seed=2, actuator=ACTUATOR._replace(
        control=ACTUATOR.control._replace(
            proportional_gain=0.8 * ACTUATOR.control.proportional_gain)))), 0.10, 0.36)
    assert heard["control_gain"] == pytest.approx(np.log(0.8), abs=0.06)


@pytest.mark.parametrize(("dry", "viscous"), [(0.42, 1e-4), (0.1, 0.0), (0.3, 5e-4)])
def test_three_speeds_tell_dry_from_viscous_friction(dry: float, viscous: float) -> None:
    speed = np.array([790.0, 197.5, 25.0])
    found = dry_and_viscous(list(speed), list(dry + viscous * speed))
    assert found == pytest.approx((dry, viscous), abs=1e-12)
    # A torque constant that is off scales both: it is not taken for friction that grows.
    scaled = dry_and_viscous(list(speed), list(1.03 * (dry + viscous * speed)))
    assert scaled == pytest.approx((1.03 * dry, 1.03 * viscous), abs=1e-12)


def test_speeds_that_do_not_differ_give_the_mean_torque() -> None:
    assert dry_and_viscous([100.0, 100.0], [0.4, 0.6]) == pytest.approx((0.5, 0.0))
