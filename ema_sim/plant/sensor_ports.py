"""Ports of sensors, commutation and controller; those of the machine are in `ports`."""

from __future__ import annotations

from ema_record.actuator import Actuator, Converters
from ema_sim.effects import (
    control_delay,
    current_sensor_gain,
    current_sensor_offset,
    hall_misalignment,
    position_sensor_offset,
    quantisation,
    speed_sensor_runout,
)
from ema_sim.effects.base import AllEffects
from ema_sim.effects.compile import law
from ema_sim.plant.parts import Sensors


@law
def current_gain(e: AllEffects, phase: int) -> float:
    """Gain of the current sensor of a phase."""
    return current_sensor_gain.gain(e.current_sensor_gain, phase)


@law
def current_offset(e: AllEffects, phase: int) -> float:
    """Offset of the current sensor of a phase (A)."""
    return current_sensor_offset.offset(e.current_sensor_offset, phase)


@law
def speed_factor(e: AllEffects, theta_r: float) -> float:
    """Factor on the measured speed at mechanical rotor angle (rad)."""
    return speed_sensor_runout.factor(e.speed_sensor_runout, theta_r)


@law
def position_offset(e: AllEffects) -> float:
    """Offset of the position transducer (rad)."""
    return position_sensor_offset.offset(e.position_sensor_offset)


@law
def position_step(e: AllEffects, c: Converters) -> float:
    """Step of the position converter (rad)."""
    return c.position_range / 2.0**c.position_bits * quantisation.coarser(
        e.quantisation.position_bits_lost
    )


@law
def speed_step(e: AllEffects, c: Converters) -> float:
    """Step of the speed converter (rad/s)."""
    return c.speed_range / 2.0**c.speed_bits * quantisation.coarser(
        e.quantisation.speed_bits_lost
    )


@law
def commutation_angle(e: AllEffects) -> float:
    """What the commutation sensor reads beyond the electrical angle (rad)."""
    return hall_misalignment.sensor_angle(e.hall_misalignment)


@law
def delay_periods(e: AllEffects, a: Actuator) -> float:
    """Delay of the reference current in control periods."""
    return control_delay.periods(e.control_delay, a.control.period)


@law
def read_as(
    x: Sensors, sign_a: float, sign_b: float, current: float
) -> tuple[float, float, float]:
    """Return the currents (A) that the sensors read as `current` times the signs of the phases.

    The sensors read i gain + offset; the signs sum to zero.
    """
    return (
        (sign_a * current - x.offset_a) / x.gain_a,
        (sign_b * current - x.offset_b) / x.gain_b,
        ((-sign_a - sign_b) * current - x.offset_c) / x.gain_c,
    )
