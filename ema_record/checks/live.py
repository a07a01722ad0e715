"""The record checks: can this record be trusted, whatever the actuator's health.

A check is a name and a function from a `Record` to a `CheckResult`; the worst level wins.
An error means that the record is no good; a warning, that something is unusual and may be a
fault of the actuator.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from ema_record.channels import (
    CHANNELS,
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    SURFACE_POSITION,
)
from ema_record.record import Record

GEAR_RATIO = 500.0
"""Motor rad a surface rad."""
SLEW_SPEED = 790.6 / GEAR_RATIO
"""Highest speed of the surface (rad/s)."""
CURRENT_LIMIT = 22.0
"""Limit of the reference current (A)."""
RANGES = {
    "time": (0.0, 61.0),
    "motor_speed": (-1000.0, 1000.0),
    "phase_current_a": (-32.0, 32.0),
    "phase_current_b": (-32.0, 32.0),
    "phase_current_c": (-32.0, 32.0),
    "reference_current_a": (-CURRENT_LIMIT - 0.1, CURRENT_LIMIT + 0.1),
    "reference_current_b": (-CURRENT_LIMIT - 0.1, CURRENT_LIMIT + 0.1),
    "reference_current_c": (-CURRENT_LIMIT - 0.1, CURRENT_LIMIT + 0.1),
    "rotor_angle": (-1e-6, 2.0 * np.pi + 1e-3),
    "surface_position": (-0.65, 0.65),
}
"""What each transducer can give, in the unit of its channel."""
SATURATION_TIME = 0.1
"""Longest time at the current limit that is usual (s)."""
CURRENT_SUM = (0.3, 2.0)
"""Mean of i_a + i_b + i_c that is unusual, and that no sensor may show (A)."""
TRAVEL = (10e-3, 50e-3)
"""Difference between integrated speed and position: unusual, impossible (rad)."""
POSITION_GAIN = 2e4 / GEAR_RATIO
"""Of the position control, surface speed a position error (1/s)."""
REACHED = 30e-3
"""Distance from the expected course that is unusual (rad)."""


class Level(enum.IntEnum):
    """How bad a result is; numbers as in diagnostic_msgs."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """What a check found."""

    name: str
    level: Level
    message: str
    values: dict[str, str] = field(default_factory=dict)


Check = Callable[[Record], CheckResult]


def check_record(record: Record) -> list[CheckResult]:
    """Return the results of all checks, in the order of `CHECKS`."""
    return [check(record) for check in CHECKS]


def worst(results: Iterable[CheckResult]) -> Level:
    """Return the worst level of the results."""
    return max((result.level for result in results), default=Level.OK)


def _graded(value: float, limits: tuple[float, float]) -> Level:
    return Level(sum(value > limit for limit in limits))


def check_counters(published: int | None, recorded: int) -> CheckResult:
    """Compare the samples that the acquisition published with those in the record.

    Parameters
    ----------
    published : counter of the acquisition for this test; None: it did not say.
    recorded : samples in the bag.
    """
    lost = None if published is None else published - recorded
    if lost is None:
        level, message = Level.ERROR, "the acquisition did not say how many samples it published"
    elif lost:
        level, message = Level.ERROR, f"{abs(lost)} samples {'lost' if lost > 0 else 'too many'}"
    else:
        level, message = Level.OK, f"all {recorded} published samples are recorded"
    return CheckResult(name="counters", level=level, message=message, values={
        "samples_published": "unknown" if published is None else str(published),
        "samples_recorded": str(recorded),
    })


def check_count(record: Record) -> CheckResult:
    """Compare the number of samples with the profile's length, and look for gaps."""
    expected = round(record.profile.duration * record.rate) if len(record) > 1 else 0
    steps = np.diff(record.time)
    gaps = int(np.count_nonzero(steps > 1.5 / record.rate)) if len(steps) else 0
    missing = expected - len(record)
    good = len(record) > 1 and missing == 0 and gaps == 0
    return CheckResult(
        name="count", level=Level.OK if good else Level.ERROR,
        message=f"{len(record)} of {expected} samples, {gaps} gaps",
        values={"samples": str(len(record)), "expected": str(expected), "gaps": str(gaps)},
    )


def check_time_order(record: Record) -> CheckResult:
    """Check that time increases from sample to sample."""
    backwards = int(np.count_nonzero(~(np.diff(record.time) > 0.0)))
    return CheckResult(
        name="time order", level=Level.ERROR if backwards else Level.OK,
        message=f"{backwards} steps back or still" if backwards else "time increases",
        values={"backwards": str(backwards)},
    )


def check_finite(record: Record) -> CheckResult:
    """Check that every value is a finite number."""
    bad = ~np.isfinite(record.samples)
    names = [c.name for c, wrong in zip(CHANNELS, bad.any(axis=0)) if wrong]
    return CheckResult(
        name="finite", level=Level.ERROR if names else Level.OK,
        message=f"not finite: {', '.join(names)}" if names else "all values are finite",
        values={"not_finite": str(int(bad.sum()))},
    )


def check_range(record: Record) -> CheckResult:
    """Check that every value is one that its transducer can give."""
    outside = []
    for channel, column in zip(CHANNELS, record.samples.T):
        lower, upper = RANGES[channel.name]
        wrong = int(np.count_nonzero((column < lower) | (column > upper)))
        if wrong:
            outside.append(f"{channel.name} {wrong} times outside {lower:g} to {upper:g} "
                           f"{channel.unit}")
    return CheckResult(
        name="range", level=Level.ERROR if outside else Level.OK,
        message="; ".join(outside) or "all values are within their ranges",
        values={"channels_outside": str(len(outside))},
    )


def check_saturation(record: Record) -> CheckResult:
    """Look for a current that stays at its limit."""
    reference = np.abs(record.samples[:, REFERENCE_CURRENTS]).max(axis=1, initial=0.0)
    edges = np.flatnonzero(np.diff(np.concatenate(
        [[0], (reference >= 0.99 * CURRENT_LIMIT).astype(np.int8), [0]]
    )))
    longest = int((edges[1::2] - edges[::2]).max(initial=0)) / record.rate if len(edges) else 0.0
    return CheckResult(
        name="saturation", level=Level.WARN if longest > SATURATION_TIME else Level.OK,
        message=f"at most {longest:.3f} s on end at the current limit of {CURRENT_LIMIT:g} A",
        values={"longest_s": f"{longest:.4f}"},
    )


def check_current_sum(record: Record) -> CheckResult:
    """Check that the phase currents of the star sum to zero in the mean."""
    total = record.samples[:, PHASE_CURRENTS].sum(axis=1)
    mean = float(np.nanmean(total)) if len(total) else 0.0
    return CheckResult(
        name="current sum", level=_graded(abs(mean), CURRENT_SUM),
        message=f"mean of i_a + i_b + i_c is {mean:+.3f} A",
        values={"mean_A": f"{mean:.4f}"},
    )


def check_speed_against_position(record: Record) -> CheckResult:
    """Compare the integrated motor speed with the surface position."""
    travel = np.zeros(len(record))
    if len(record) > 1:
        speed = record.samples[:, MOTOR_SPEED] / GEAR_RATIO
        travel[1:] = np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(record.time))
    difference = record.samples[:, SURFACE_POSITION] - travel
    difference = difference[np.isfinite(difference)]
    span = float(np.ptp(difference)) if len(difference) else 0.0
    return CheckResult(
        name="speed against position", level=_graded(span, TRAVEL),
        message=f"integrated speed and position differ by {1e3 * span:.2f} mrad",
        values={"difference_rad": f"{span:.6f}"},
    )


def expected_course(record: Record) -> np.ndarray:
    """Return where a healthy position control takes the surface, shape (n,) (rad).

    ``dx/dt = sat(POSITION_GAIN (command - x), SLEW_SPEED)`` from the first measured position.
    """
    course = np.empty(len(record))
    at = float(record.samples[0, SURFACE_POSITION]) if len(record) else 0.0
    step, gain = SLEW_SPEED / record.rate, POSITION_GAIN / record.rate
    for k, goal in enumerate(record.profile.command(record.time).tolist()):
        at += min(max(gain * (goal - at), -step), step)
        course[k] = at
    return course


def check_command_reached(record: Record) -> CheckResult:
    """Check that the surface follows the command as far as speed limit and loop gain allow."""
    if len(record) < 2 or not np.isfinite(record.time).all():
        return CheckResult(name="command reached", level=Level.ERROR, message="no samples")
    position = record.samples[:, SURFACE_POSITION]
    away = float(np.nanmax(np.abs(position - expected_course(record)), initial=0.0))
    left = float(position[-1] - record.profile.command(record.time[-1:])[0])
    return CheckResult(
        name="command reached", level=Level.WARN if not away <= REACHED else Level.OK,
        message=f"at most {1e3 * away:.1f} mrad from the expected course, "
        f"{1e3 * left:+.1f} mrad from the command at the end",
        values={"away_rad": f"{away:.6f}", "end_rad": f"{left:.6f}"},
    )


CHECKS: tuple[Check, ...] = (
    check_count, check_time_order, check_finite, check_range, check_saturation,
    check_current_sum, check_speed_against_position, check_command_reached,
)
