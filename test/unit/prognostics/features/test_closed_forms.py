"""Feature files on signals with a known answer: no simulation, no noise that is not put in."""

from __future__ import annotations

import numpy as np
import pytest

from ema_prognostics.features.acceleration import inertia
from ema_prognostics.features.consistency import consistency
from ema_prognostics.features.reversal import reversal_gap
from ema_prognostics.features.signals import THIRD, CurrentSensors, Signals
from ema_prognostics.features.start import TRAVELS, start_features, start_stiffness
from ema_prognostics.features.winding import FIRST_EDGE, SECTOR, rise
from ema_record.actuator import load_actuator
from ema_record.profile import load_profile
from ema_record.profiles.plan import test_plan as plan_of
from ema_record.record import Record

ACTUATOR = load_actuator()
MOTOR, RATIO = ACTUATOR.motor, ACTUATOR.gear.ratio
STEP, EXTENDED = (plan_of(load_profile(n), ACTUATOR) for n in ("step", "extended"))
STIFFNESS = ACTUATOR.shaft.stiffness / RATIO**2
"""Of the shaft, seen from the motor (N m/rad)."""


def times(profile: str = "step", rate: float = 20_000.0) -> np.ndarray:
    """Return the times of a whole record from its first command on, shape (n,) (s)."""
    known = load_profile(profile)
    n = round(known.duration * rate)
    return (np.arange(n) + 0.5) / rate - known.command_time


def signals_of(
    since: np.ndarray, theta: np.ndarray, speed: np.ndarray, *, profile: str = "step",
    torque: np.ndarray | float = 0.0, position: np.ndarray | None = None,
    currents: np.ndarray | float = 0.0, reference: np.ndarray | float = 0.0,
) -> Signals:
    """Return signals without sensor errors; `since` counts from the first command (s)."""
    known, n = load_profile(profile), len(since)
    position = theta / RATIO if position is None else position
    currents = np.zeros((n, 3)) + currents
    samples = np.column_stack([
        since + known.command_time, speed, currents, np.zeros((n, 3)) + reference,
        np.mod(theta, 2.0 * np.pi), position,
    ])
    constant = 2.0 * MOTOR.back_emf_constant
    return Signals(
        record=Record(samples=samples, profile=known), actuator=ACTUATOR,
        has_references=True, has_position=True,
        rate=1.0 / (since[1] - since[0]), time=samples[:, 0], speed=speed, theta=theta,
        position=position, currents=currents,
        torque_current=(np.zeros(n) + torque) / constant,
        sensors=CurrentSensors(offset=np.zeros(3), gain=np.ones(3)),
        torque_constant=constant, temperature=20.0, bus_voltage=96.0,
    )


# --- commutation

SLEW = 0.06, 0.36
TEN_TURNS = 10 * 2.0 * np.pi / 0.3
"""Speed that makes ten turns in the slew (rad/s)."""


def taken_over(after: tuple[float, float, float], speed: float) -> tuple[float, float]:
    """Return mean and spread of phases that rise linearly to 10 A within `after` (s) each."""
    since = times(rate=200_000.0)
    theta = speed * since
    angle = theta[:, None] - THIRD * np.arange(3)
    sense = np.sign(speed)
    turned = np.mod(sense * angle - FIRST_EDGE, np.pi)  # since phase k began to conduct
    reference = np.where(turned < 2.0 * SECTOR, 10.0 * np.where(
        np.mod(sense * angle - FIRST_EDGE, 2.0 * np.pi) < np.pi, 1.0, -1.0), 0.0)
    risen = np.minimum(turned / abs(speed) / np.array(after), 1.0)
    found = signals_of(since, theta, np.full(len(since), speed), reference=reference,
                       currents=reference * risen)
    return rise(found, *SLEW)


@pytest.mark.parametrize("speed", [TEN_TURNS, -2.0 * TEN_TURNS])
def test_take_over_is_the_lacking_charge_over_the_wanted(speed: float) -> None:
    # A triangle of 10 A and `after` lacks 10 A after / 2; the sector wants (10 A)² SECTOR / ω.
    mean, spread = taken_over((2e-4, 2e-4, 2e-4), speed)
    assert mean == pytest.approx(np.log(0.5 * 2e-4 * abs(speed) / SECTOR / 10.0), abs=0.03)
    assert spread < np.log(0.03)


def test_spread_is_what_one_phase_takes_longer() -> None:
    # Of lacks 1, 1 and 2 the sum over 120° apart is 1, the mean 4/3.
    _, spread = taken_over((2e-4, 4e-4, 2e-4), TEN_TURNS)
    assert spread == pytest.approx(np.log(0.75), abs=0.03)
    _, other = taken_over((2e-4, 2e-4, 4e-4), TEN_TURNS)
    assert other == pytest.approx(spread, abs=0.02)


# --- start


def started(stiff_from: float, lag: float, *, at_rest: float = 0.0) -> Signals:
    """Return a start at constant acceleration.

    A shaft of twice the nominal stiffness takes hold after `stiff_from` (rad) of motor travel;
    the surface lags by `lag` (rad) for each radian of motor travel up to 4 rad.
    """
    since, acceleration = times(), 2e4
    moving = np.maximum(since, 0.0)
    theta = np.where(moving < 0.04, 0.5 * acceleration * moving**2, 800.0 * (moving - 0.02))
    speed = np.where(moving < 0.04, acceleration * moving, 800.0)
    wound = np.maximum(theta - stiff_from, 0.0)
    torque = np.where(since > 0.0, MOTOR.inertia * acceleration + 0.3 + 2 * STIFFNESS * wound, 0)
    behind = np.where(since > 0.0, lag * np.minimum(theta, 4.0), at_rest)
    return signals_of(since, theta, speed, torque=torque, position=theta / RATIO - behind)


def test_stiffness_is_the_bend_of_the_energy() -> None:
    assert start_stiffness(started(0.0, 0.0), 0.012) == pytest.approx([2.0, 2.0], rel=0.02)
    assert start_stiffness(started(0.25, 0.0), 0.012) == pytest.approx([0.0, 2.0], abs=0.04)
    assert start_stiffness(started(9.0, 0.0), 0.012) == pytest.approx([0.0, 0.0], abs=0.02)


def test_lags_of_the_start_are_counted_from_the_settled_one() -> None:
    found = start_features(started(0.25, 2e-4, at_rest=3e-4), 0.10, 0.36)
    settled = 4.0 * 0.2
    for k, travel in enumerate(TRAVELS):
        assert found[f"lag_start_{k + 1}"] == pytest.approx(
            0.2 * travel * ACTUATOR.wind_up - settled, abs=0.01)
    assert found["lag_at_rest"] == pytest.approx(0.3 - settled)
    assert found["lag_peak"] == pytest.approx(0.0, abs=1e-3)
    assert (found["start_stiffness_1"], found["start_stiffness_2"]) == pytest.approx(
        (0.0, 2.0), abs=0.04)


# --- consistency


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_sensors_that_disagree_show_by_how_much(direction: float) -> None:
    since = times("extended")
    theta = direction * 300.0 * since
    found = consistency(signals_of(
        since, theta, np.full(len(since), direction * 300.0 * 1.004), profile="extended",
        position=theta * 0.997 / RATIO), EXTENDED.segments)
    for window in ("full", "quarter"):
        assert found[f"speed_over_angle_{window}"] == pytest.approx(4.0 * direction, rel=1e-6)
        assert found[f"position_over_angle_{window}"] == pytest.approx(-3.0 * direction, rel=1e-6)


def test_a_motor_that_still_gains_speed_agrees_with_its_own_angle() -> None:
    """A heavy friction at a low bus: the slew has begun and the speed is not reached yet."""
    since = times("extended")
    late = 40.0 * np.exp(-since / 0.08)
    found = consistency(signals_of(
        since, 300.0 * since + 0.08 * late, 300.0 - late, profile="extended"),
        EXTENDED.segments)
    assert found["speed_over_angle_full"] == pytest.approx(0.0, abs=1e-3)


def test_noise_offsets_and_sums_of_the_currents() -> None:
    since = times()
    sign = np.where(np.arange(len(since)) % 2, 1.0, -1.0)
    currents = sign[:, None] * np.array([0.1, 0.3, 0.2]) + np.array([0.0, 0.0, 0.06])
    found = consistency(
        signals_of(since, np.zeros(len(since)), 0.5 * sign, currents=currents,
                   position=np.full(len(since), -0.398)), STEP.segments)
    # About a line, whose two numbers cost two of some 45 samples.
    assert found["noise_speed"] == pytest.approx(np.log(0.5), abs=0.03)
    assert found["noise_current"] == pytest.approx(np.log(0.3), abs=0.03)
    assert found["noise_current_least"] == pytest.approx(np.log(0.1), abs=0.03)
    assert found["start_position"] == pytest.approx(2.0)
    assert found["sum_rms"] == pytest.approx(np.log(0.6))
    assert found["sum_mean"] == pytest.approx(0.06)
    assert found["reference_rms"] == pytest.approx(np.log(0.2))
    assert found["reference_spread"] == pytest.approx((0.3 - 0.1) / 0.2)


def test_a_motion_at_rest_is_no_noise() -> None:
    """A shaft that unwinds as the drive lets go: within the first third of the interval."""
    since = times()
    rest = since[since < 0.0]
    begin, third = rest[0], (rest[-1] - rest[0]) / 3.0
    unwinds = np.where(since < begin + third, 30.0 * np.cos(np.pi * (since - begin) / third), 0.0)
    drift = 20.0 * since
    sign = np.where(np.arange(len(since)) % 2, 0.5, -0.5)
    found = consistency(signals_of(since, np.zeros(len(since)), sign + unwinds + drift),
                        STEP.segments)
    assert found["noise_speed"] == pytest.approx(np.log(0.5), abs=0.03)


# --- reversal


def turned_round(level: float, load: float, width: float, stiffness: float) -> Signals:
    """Return the reversals of the extended test: gentle, with a gap of `width` (rad)."""
    since = times("extended")
    speed = np.zeros(len(since))
    torque = np.zeros(len(since))
    for begin, direction in EXTENDED.reversals:
        here = (since > begin - 0.05) & (since < begin + EXTENDED.reversal_length + 0.01)
        speed[here] = direction * 25.0 * np.clip((since[here] - begin - 0.02) / 0.02, -1.0, 1.0)
    theta = np.cumsum(speed) * (since[1] - since[0])
    for begin, direction in EXTENDED.reversals:
        here = (since > begin) & (since < begin + EXTENDED.reversal_length)
        along = direction * theta[here]
        x = along - along.min()
        gap = np.minimum(x - 0.4, 0.0) + np.maximum(x - 0.4 - width * RATIO, 0.0)
        torque[here] = load + direction * (level + stiffness * STIFFNESS * gap)
    torque += MOTOR.inertia * np.gradient(speed, since) + MOTOR.viscous_friction * speed
    return signals_of(since, theta, speed, profile="extended", torque=torque,
                      position=np.zeros(len(since)))


def test_gap_is_read_off_its_curve_and_a_load_shows_as_half_the_difference() -> None:
    signals = turned_round(0.35, 0.04, 3e-4, 1.5)
    back, ahead = (reversal_gap(signals, begin, EXTENDED.reversal_length, direction)
                   for begin, direction in EXTENDED.reversals)
    for gap in (back, ahead):
        assert gap.width == pytest.approx(3e-4, abs=1e-5)
        assert gap.slope == pytest.approx(1.5, rel=0.02)
        assert gap.bend == pytest.approx(0.0, abs=0.02)
        assert gap.error < 2e-3
    assert 0.5 * (ahead.level + back.level) == pytest.approx(0.35, abs=2e-3)
    assert 0.5 * (ahead.level - back.level) == pytest.approx(0.04, abs=1e-3)


# --- acceleration


@pytest.mark.parametrize("amplitude", [0.0, 0.02, 0.08])
def test_inertia_error_is_the_torque_that_the_balance_leaves(amplitude: float) -> None:
    since = times()
    turn = 2.0 * np.pi * 4.0 * since
    speed = 400.0 * np.sin(turn)
    theta = -400.0 / (8.0 * np.pi) * np.cos(turn)
    wound = 1e-4 * np.sin(2.0 * turn + 0.4)
    torque = (1.2 * MOTOR.inertia * 400.0 * 8.0 * np.pi * np.cos(turn) + 0.25 * np.sign(speed)
              + 2e-4 * speed + wound * ACTUATOR.shaft.stiffness / RATIO + 0.03
              + amplitude * np.sin(2.0 * np.pi * 150.0 * since))
    found = inertia(signals_of(since, theta, speed, torque=torque, position=theta / RATIO - wound),
                    ((0.0, 0.4),))
    assert found["inertia"] == pytest.approx(np.log(1.2), abs=0.01)
    # 1 mN m is the floor; the mean over 0.5 ms keeps 99 % of 150 Hz.
    assert np.exp(found["inertia_error"]) == pytest.approx(1e-3 + amplitude / np.sqrt(2), rel=0.03)
