"""What is wrong with a rig's record, each with its remedy, before anything is fitted."""

from __future__ import annotations

import math

import numpy as np

from ema_record.errors import IncompleteRecordError, InvalidRecordError
from ema_record.rig import POSITION, SPEED, RigRecord

MIN_SAMPLES = 200
TOLERANCE = 0.05
"""Of the ratio of speed to the derivative of position."""

FOLLOWS = 0.9
"""Least correlation of the integral of the speed with the position."""
STILL = 2.0
"""Spread of a position over that of its steps; white noise has 0.7."""
RUN = ("record a run with reversals and at least two speeds, for example a sine or trapezoids of "
       "speed")

_RATIOS = {
    "rotary": {
        60.0 / (2 * math.pi): "speed is in rev/min (rpm), not rad/s",
        180.0 / math.pi: "speed is in deg/s, or position in units of 57.3 degrees less",
        1.0 / (2 * math.pi): "speed is in rev/s, not rad/s",
        math.pi / 180.0: "position is in degrees, not rad",
        2 * math.pi: "position is in turns, not rad",
        6.0: "speed is in rev/min (rpm) and position in degrees times 2 pi: check both",
        1.0 / 6.0: "speed is in rev/min (rpm) and position in degrees",
        60.0: "speed is in rev/min (rpm) and position in turns",
    },
    "linear": {
        1000.0: "speed is in mm/s and position in m",
        1e-3: "position is in mm and speed in m/s",
        100.0: "speed is in cm/s and position in m",
        0.01: "position is in cm and speed in m/s",
        60.0: "speed is in m/min, not m/s",
        1000.0 * 60.0: "speed is in mm/min, not m/s",
    },
}


def too_short(record: RigRecord, why: str) -> IncompleteRecordError:
    """Return the error for a record that is too short."""
    return IncompleteRecordError(
        f"{record.source}: too short to identify ({why}): record several cycles of the motion in "
        "both directions"
    )


def no_motion(record: RigRecord, rms: float, standstill: float) -> InvalidRecordError:
    """Return the error for a record in which nothing moves."""
    unit = record.axis.speed_unit
    return InvalidRecordError(
        f"{record.source}: no excitation: speed {rms:.3g} {unit} rms, standstill is below "
        f"{standstill:.3g} {unit}: {RUN}"
    )


def check_record(record: RigRecord) -> None:
    """Refuse records that are too short, or whose input or output does not change.

    Raises
    ------
    IncompleteRecordError, InvalidRecordError
        The channel is named, with the remedy.

    """
    if len(record) < MIN_SAMPLES:
        raise too_short(record, f"{len(record)} samples, at least {MIN_SAMPLES}")
    for channel in record.channels[1:]:
        if channel.name not in (record.axis.input_channel.name, POSITION, SPEED):
            continue
        values = record.channel(channel.name)
        if np.ptp(values) == 0.0:
            raise InvalidRecordError(
                f"{record.source}: {channel.name} is {values[0]:.4g} {channel.unit} throughout: "
                "name another column in the map, or record a run in which it changes"
            )


def check_units(record: RigRecord) -> None:
    """Compare the speed with the derivative of the position, where both are measured.

    Raises
    ------
    InvalidRecordError
        Their ratio is not 1; the unit that it suggests is named.

    """
    if not (record.has(POSITION) and record.has(SPEED)):
        return
    time, position, speed = record.time, record.channel(POSITION), record.channel(SPEED)
    travelled = np.concatenate(
        [[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))])
    ratio, quality = _ratio(time, position, travelled)
    if quality < FOLLOWS and np.std(position) < STILL * np.std(np.diff(position)):
        raise InvalidRecordError(
            f"{record.source}: no excitation: the position is noise about one place: {RUN}")
    if not math.isfinite(ratio) or quality < FOLLOWS:
        raise InvalidRecordError(
            f"{record.source}: the speed does not follow the position (correlation of its "
            f"integral {quality:.2f}, at least {FOLLOWS:g}): check the columns of the map"
        )
    if abs(ratio - 1.0) <= TOLERANCE:
        return
    if abs(ratio + 1.0) <= TOLERANCE:
        raise InvalidRecordError(
            f"{record.source}: speed and position have opposite signs: set 'scale: -1' for one "
            "of them in the map"
        )
    known = _RATIOS[record.axis.motion]
    near = min(known, key=lambda value: abs(math.log(abs(ratio) / value)))
    guess = f": {known[near]}" if abs(abs(ratio) / near - 1.0) <= TOLERANCE else ""
    raise InvalidRecordError(
        f"{record.source}: the speed integrates to {ratio:.4g} times the position{guess}: "
        "correct the unit or the scale in the map and import again"
    )


def _ratio(time: np.ndarray, position: np.ndarray, travelled: np.ndarray) -> tuple[float, float]:
    """Return the slope of the travelled way against position, short-term, and its quality.

    Differences over a hundredth of the record, so that a drift of the integral and noise of
    the position matter little.
    """
    count = len(time)
    lag = max(1, count // 200)
    way = position[lag:] - position[:-lag]
    own = travelled[lag:] - travelled[:-lag]
    power = float(way @ way)
    if power == 0.0:
        return math.nan, 0.0
    correlation = float(way @ own) / math.sqrt(power * float(own @ own) or 1.0)
    return float(way @ own) / power, abs(correlation)
