"""The control law, measured on a record: how the reference current follows from its inputs.

Position, speed and reference currents are recorded, the command is known. So the controller can be
judged alone, whatever the drive behind it does. A law that does not hold is another controller, or
a sensor that records otherwise than the controller reads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ema_record.actuator import Actuator, Control
from ema_record.channels import REFERENCE_CURRENTS
from ema_record.record import Record
from ema_sim.machine import TURN, unit_trapezoid

BLOCK = 20
"""Samples of a sum, over which what converters and instants of reading differ by cancels. Gains
drawn within 10 % are measured with 7 % (rms; 100 units each of our own and of the second
simulator); of 10 and 40 samples the integral one with 9 and 7 %, up to 29 and 32 % off."""
FEWEST = 50
"""Fewest sums."""
FREE = 0.5
"""Least part of the samples of a sum at which the law can be asked."""
LIMITED = 0.98
"""Part of the current limit from which the law says nothing about the slope of the current."""
SATURATED = 1.05
"""Speed wanted, of the limit, from which the position's noise and a command that acts otherwise
than at once say nothing: there e is the limit less the speed."""
MIXED = (0.02, 2e-3)
"""Third phase in units of the largest, and in A, from which a sample holds a commutation."""
OUTLIER, SWEEPS = 2.0, 5
"""Residual in robust standard deviations beyond which a sum counts less and less (Cauchy:
one may be far off in error and current at once), and rounds of that."""
OFF = (0.25, 0.3)
"""Relative deviation from which a gain is another one, proportional and integral; those 200 units,
tolerances of 0.1 included, are up to 0.13 and 0.19 off."""


class Gains(NamedTuple):
    """Of the speed control, as measured."""

    proportional: float
    """A s/rad."""
    integral: float
    """A/rad."""

    def text(self, model: Control) -> str:
        """Return the gains in words, beside those of the model."""
        return (f"the reference current follows speed and position with gains of "
                f"{self.proportional:.2f} A s/rad and {self.integral:.0f} A/rad, the model's are "
                f"{model.proportional_gain:.2f} and {model.integral_gain:.0f}")


def measured_gains(record: Record, actuator: Actuator) -> Gains | None:
    """Return the gains with which the reference current follows from what was measured.

    The speed control is i = Kp e + Ki ∫ e dt with e = clip(gain (command - position)) - speed
    (`ema_sim.plant.control`), so Δi = Kp Δe + Ki ∫ e dt over any time in which it is not limited.
    Both gains come from a robust regression over all such times in which the speed wanted is at
    its limit: elsewhere the noise of the position, times a large gain, is in Δe (errors in
    variables), and when the command acts.

    None if the record has another rate than the controller or no reference current, or if too few
    samples are left, as of a test without slews.
    """
    c = actuator.control
    time = record.time
    if (len(time) < FEWEST * BLOCK or c.proportional_gain <= 0.0 or c.integral_gain <= 0.0
            or abs(float(np.median(np.diff(time))) / c.period - 1.0) > 1e-3
            or not record.samples[:, REFERENCE_CURRENTS].any()):
        return None
    current = _reference(record, actuator.motor.flat_top)
    goal = record.profile.command(time - 0.5 * c.period + 1e-9)
    wanted = c.position_gain * (goal - record.channel("surface_position"))
    error = np.clip(wanted, -c.speed_limit, c.speed_limit) - record.channel("motor_speed")
    limit = LIMITED * actuator.inverter.current_limit
    known = np.isfinite(current) & (np.abs(current) < limit) & (time > record.profile.inverter_off)
    known &= np.abs(wanted) > SATURATED * c.speed_limit
    free = known[1:] & known[:-1]
    rows = np.stack([np.diff(current), np.diff(error), c.period * error[1:]])
    n = len(free) // BLOCK * BLOCK
    inside = free[:n].reshape(-1, BLOCK)
    sums = np.where(inside, rows[:, :n].reshape(3, -1, BLOCK), 0.0).sum(axis=2)
    sums = sums[:, inside.mean(axis=1) >= FREE]
    return _regressed(sums[0], sums[1:].T) if sums.shape[1] >= FEWEST else None


def _regressed(target: np.ndarray, columns: np.ndarray) -> Gains:
    weight = np.ones(len(target))
    for _ in range(SWEEPS):
        found, *_ = np.linalg.lstsq(columns * weight[:, None], target * weight, rcond=None)
        rest = np.abs(target - columns @ found)
        usual = 1.48 * float(np.median(rest)) + 1e-9
        weight = 1.0 / np.hypot(1.0, rest / (OUTLIER * usual))
    return Gains(float(found[0]), float(found[1]))


def _reference(record: Record, flat_top: float) -> np.ndarray:
    """Return the reference current, shape (n,) (A), positive for positive torque; NaN unclear.

    In a sector two phases have it with opposite signs; where a sample holds a commutation the
    three are a mixture.
    """
    phases = record.samples[:, REFERENCE_CURRENTS]
    rows = np.sort(np.abs(phases), axis=1)
    share, least = MIXED
    mixed = (rows[:, 0] > share * rows[:, 2] + least) | (
        rows[:, 1] < (1.0 - share) * rows[:, 2] - least)
    angle = record.channel("rotor_angle")
    torque = sum(unit_trapezoid(angle - k * TURN / 3.0, flat_top) * phases[:, k] for k in range(3))
    return np.where(mixed, np.nan, np.sign(torque) * rows[:, 2])


class ControlLaw(NamedTuple):
    """What the control law says by itself."""

    holds: bool
    """Whether a run of the fitted unit has the same gains."""
    text: str


def same_law(measured: Gains, other: Gains, control: Control) -> bool:
    """Whether two measurements agree.

    A delay leaves no proportional gain, and the integral one then says nothing.
    """
    if abs(measured.proportional - other.proportional) > OFF[0] * control.proportional_gain:
        return False
    delayed = abs(other.proportional / control.proportional_gain - 1.0) > OFF[0]
    return delayed or abs(measured.integral - other.integral) < OFF[1] * control.integral_gain


def control_law(record: Record, run: Record, actuator: Actuator) -> ControlLaw | None:
    """Return what the law of a record says, beside a run of the fitted unit; None if nothing.

    The unit is fitted with its latencies: a command that acts a period later is no other law.
    """
    recorder = actuator.acquisition
    if not (recorder.reference_currents and recorder.surface_position):
        return None
    measured, own = measured_gains(record, actuator), measured_gains(run, actuator)
    if measured is None or own is None:
        return None
    return ControlLaw(holds=same_law(measured, own, actuator.control),
                      text=measured.text(actuator.control))
