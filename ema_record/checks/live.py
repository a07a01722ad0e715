"""The record checks of the built-in test: what the guard of a verdict finds, in eight groups.

A finding that makes the record invalid or incomplete is an error; one that makes the verdict
unknown is a warning. Beside them each group tells what it measures, and a few bounds of its own
warn of what is unusual and may be a fault of the actuator. The worst level wins.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ema_record.actuator import Actuator
from ema_record.channels import (
    CHANNELS,
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    SURFACE_POSITION,
    TIME,
)
from ema_record.checks.facts import SUM_OFFSET, BagFacts, Finding, facts_of_record
from ema_record.checks.guard import OUTCOMES, guard_findings, plain
from ema_record.checks.origin import RATE_TOLERANCE
from ema_record.checks.stream import irregular
from ema_record.limits import MAX_DURATION
from ema_record.record import Record

BEYOND_STOPS = 13.0 / 12.0
"""Times the end stop that no surface reads: it stands at the stop, its transducer is off."""
BEYOND_LIMIT = 1.005
"""Times the current limit to which references go, rounded by their converter."""
SATURATION_TIME = 12.8
"""Longest time at the current limit that is usual (of that in which the motor runs up)."""
CURRENT_SUM = 0.0909
"""Mean of i_a + i_b + i_c that no sensor may show (of the limit); unusual: `SUM_OFFSET`."""
TRAVEL = (1.0 / 80.0, 1.0 / 12.0)
"""Difference between integrated speed and position: unusual, impossible (of the end stop), beyond
what the shaft twists."""
REACHED = 0.03
"""Distance from the expected course that is unusual (of the end stop), beyond the way at the slew
speed in the time of run-up."""
LAST = 1.0 - 1e-6
"""Samples by which a clock that is a little off may miss the end of a test: less than one."""
GROUPS = {
    "count": ("gap", "record_length", "sample_rate", "test_not_complete", "other_actuator"),
    "time order": ("clock_jump", "repeated_data"),
    "finite": ("not_finite", "missing_channel"),
    "range": ("wrong_unit", "saturation", "spike", "stuck_channel", "held_samples",
              "sensor_noise"),
    "current sum": ("swapped_phases",),
    "speed against position": ("discontinuity",),
    "command reached": ("wrong_profile",),
}
"""Rules of each check; the others go by their channel, see `group_of`."""
BY_CHANNEL = "current sum", "speed against position"
"""Checks of these others: of currents, and of all else."""
_GROUP = {rule: group for group, rules in GROUPS.items() for rule in rules}


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
    limits: dict[str, float] = field(default_factory=dict)
    """Largest usual size of those of `values` that have one."""


def group_of(finding: Finding) -> str:
    """Return the check that tells of a finding of the guard."""
    return _GROUP.get(finding.rule, BY_CHANNEL["current" not in finding.channel])


def rules_of(check: str) -> tuple[str, ...]:
    """Return the rules of the guard that a check may tell of."""
    others = [rule for rule in OUTCOMES if rule not in _GROUP] if check in BY_CHANNEL else []
    return *GROUPS.get(check, ()), *others


def check_record(record: Record, actuator: Actuator | None = None) -> list[CheckResult]:
    """Return the results of all checks, in the order of `CHECKS`.

    Parameters
    ----------
    record : one test. Its samples may be of any value, in any order.
    actuator : what was tested, default the kit's.
    """
    facts = facts_of_record(record, actuator)
    return check_facts(facts, guard_findings(facts))


def check_facts(facts: BagFacts, findings: Sequence[Finding]) -> list[CheckResult]:
    """Return the results of all checks on facts in which the guard has these `findings`."""
    with np.errstate(all="ignore"):  # the values of a record may be anything
        measured = [_plain(check(facts)) for check in CHECKS]
    return [_with(result, [f for f in findings if group_of(f) == result.name])
            for result in measured]


def _plain(result: CheckResult) -> CheckResult:
    return replace(result, message=plain(result.message),
                   values={name: plain(value) for name, value in result.values.items()})


def _with(result: CheckResult, findings: list[Finding]) -> CheckResult:
    """Return the result of a check together with what the guard finds in its group."""
    for finding in findings:
        level = Level.WARN if OUTCOMES[finding.rule] == "unknown" else Level.ERROR
        if level > result.level:
            result = replace(result, level=level, message=f"{result.message}; {finding.message}")
    return result


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


def _count(facts: BagFacts) -> CheckResult:
    """Compare the number of samples with the profile's length, and count gaps."""
    n = sum(len(block.samples) for block in facts.blocks)
    duration = facts.profile.duration if facts.profile else 0.0
    expected = round(duration / facts.interval) if len(facts.samples) > 1 else 0
    gaps = sum(kind == "gap" for kind, _ in facts.derived(irregular))
    span = float(np.ptp(facts.samples[:, TIME])) if expected else 0.0
    interval = span / max(len(facts.samples) - 1, 1)
    whole = (abs(n * interval - duration) < LAST * interval
             and abs(n - expected) <= RATE_TOLERANCE * expected)
    return CheckResult(
        name="count", level=Level.OK if whole and expected > 1 else Level.ERROR,
        message=f"{n} of {expected} samples, {gaps} gaps",
        values={"samples": str(n), "expected": str(expected), "gaps": str(gaps)},
        limits={"gaps": 0.0},
    )


def _time_order(facts: BagFacts) -> CheckResult:
    """Count steps of time from sample to sample that do not go on."""
    backwards = sum(
        int(np.count_nonzero(~(np.diff(block.samples[:, TIME]) > 0.0))) for block in facts.blocks
    )
    return CheckResult(
        name="time order", level=Level.ERROR if backwards else Level.OK,
        message=f"{backwards} steps back or still" if backwards else "time increases",
        values={"backwards": str(backwards)}, limits={"backwards": 0.0},
    )


def _finite(facts: BagFacts) -> CheckResult:
    """Name the channels with values that are no numbers."""
    bad = np.sum([(~np.isfinite(b.samples)).sum(axis=0) for b in facts.blocks]
                 or [np.zeros(len(CHANNELS))], axis=0)[list(facts.columns)]
    names = [CHANNELS[c].name for c, wrong in zip(facts.columns, bad) if wrong]
    return CheckResult(
        name="finite", level=Level.ERROR if names else Level.OK,
        message=f"not finite: {', '.join(names)}" if names else "all values are finite",
        values={"not_finite": str(int(bad.sum()))}, limits={"not_finite": 0.0},
    )


def ranges(actuator: Actuator) -> dict[str, tuple[float, float]]:
    """Return what each transducer can give, in the unit of its channel.

    One without a converter gives any speed and any current.
    """
    c = actuator.converters
    limit = BEYOND_LIMIT * actuator.inverter.current_limit
    none = 0.0 if actuator.acquisition.converters else np.inf
    upper = {
        "motor_speed": 0.5 * c.speed_range + none,
        "surface_position": BEYOND_STOPS * actuator.surface.end_stop,
        **{f"phase_current_{phase}": 0.5 * c.current_range + none for phase in "abc"},
        **{f"reference_current_{phase}": limit for phase in "abc"},
    }
    both = {name: (-bound, bound) for name, bound in upper.items()}
    return {
        "time": (0.0, MAX_DURATION + 1.0), "rotor_angle": (-1e-6, 2.0 * np.pi + 1e-3), **both
    }


def _range(facts: BagFacts) -> CheckResult:
    """Check that every value is one that its transducer can give."""
    outside = []
    bounds = ranges(facts.actuator)
    for channel, column in zip(CHANNELS, facts.samples.T):
        lower, upper = bounds[channel.name]
        wrong = int(np.count_nonzero((column < lower) | (column > upper)))
        if wrong:
            outside.append(f"{channel.name} {wrong} times outside {lower:g} to {upper:g} "
                           f"{channel.unit}")
    return CheckResult(
        name="range", level=Level.ERROR if outside else Level.OK,
        message="; ".join(outside) or "all values are within their ranges",
        values={"channels_outside": str(len(outside))}, limits={"channels_outside": 0.0},
    )


def _saturation(facts: BagFacts) -> CheckResult:
    """Look for a current that stays at its limit."""
    limit = facts.actuator.inverter.current_limit
    asked = REFERENCE_CURRENTS if facts.has_references else facts.currents
    reference = np.abs(facts.samples[:, asked]).max(axis=1, initial=0.0)
    at_limit = (reference >= 0.99 * limit).astype(np.int8)
    edges = np.flatnonzero(np.diff(at_limit, prepend=0, append=0))
    longest = int((edges[1::2] - edges[::2]).max()) * facts.interval if len(edges) else 0.0
    usual = SATURATION_TIME * facts.run_up
    return CheckResult(
        name="saturation", level=Level.WARN if longest > usual else Level.OK,
        message=f"at most {longest:.3f} s on end at the current limit of {limit:g} A",
        values={"longest_s": f"{longest:.4f}"}, limits={"longest_s": usual},
    )


def _current_sum(facts: BagFacts) -> CheckResult:
    """Check that the phase currents of the star sum to zero in the mean."""
    if len(facts.currents) < 3:
        return CheckResult(name="current sum", level=Level.OK, message="two currents: no sum")
    limits = (facts.offset_bound(SUM_OFFSET),
              CURRENT_SUM * facts.actuator.inverter.current_limit)
    total = facts.samples[:, PHASE_CURRENTS].sum(axis=1)
    mean = float(total.mean()) if len(total) else 0.0
    return CheckResult(
        name="current sum",
        level=_graded(abs(mean), limits),
        message=f"mean of i_a + i_b + i_c is {mean:+.3f} A",
        values={"mean_A": f"{mean:.4f}"}, limits={"mean_A": limits[0]},
    )


def _speed_against_position(facts: BagFacts) -> CheckResult:
    """Compare the integrated motor speed with the surface position."""
    s, stop = facts.samples, facts.actuator.surface.end_stop
    if not facts.has(SURFACE_POSITION):
        return CheckResult(name="speed against position", level=Level.OK,
                           message="the position was not recorded")
    travel = np.zeros(len(s))
    if len(s) > 1:
        speed = s[:, MOTOR_SPEED] / facts.actuator.gear.ratio
        travel[1:] = np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(s[:, TIME]))
    span = float(np.ptp(s[:, SURFACE_POSITION] - travel)) if len(s) else 0.0
    return CheckResult(
        name="speed against position", level=_graded((span - facts.twist) / stop, TRAVEL),
        message=f"integrated speed and position differ by {1e3 * span:.2f} mrad",
        values={"difference_rad": f"{span:.6f}"},
        limits={"difference_rad": TRAVEL[0] * stop + facts.twist},
    )


def expected_course(facts: BagFacts) -> np.ndarray:
    """Return where a healthy position control takes the surface, shape (n,) (rad).

    ``dx/dt = sat(gain (command - x), slew speed)`` from the first measured position, with the
    gain of the loop at the surface.
    """
    s, actuator = facts.samples, facts.actuator
    if facts.profile is None or len(s) < 2:
        return facts.surface
    at = float(facts.surface[0])
    step = actuator.slew_speed * facts.interval
    gain = min(1.0, actuator.control.position_gain / actuator.gear.ratio * facts.interval)
    course = []
    for goal in facts.profile.command(s[:, TIME]).tolist():
        move = gain * (goal - at)
        if move > step:
            move = step
        elif move < -step:
            move = -step
        at += move
        course.append(at)
    return np.array(course)


def _command_reached(facts: BagFacts) -> CheckResult:
    """Check that the surface follows the command as far as speed limit and loop gain allow."""
    s = facts.samples
    if len(s) < 2 or facts.profile is None:
        return CheckResult(name="command reached", level=Level.ERROR, message="no samples")
    position = facts.surface
    away = float(np.abs(position - expected_course(facts)).max())
    usual = REACHED * facts.actuator.surface.end_stop + facts.actuator.slew_speed * facts.run_up
    left = float(position[-1] - facts.profile.command(s[-1:, TIME])[0])
    return CheckResult(
        name="command reached",
        level=Level.WARN if away > usual else Level.OK,
        message=f"at most {1e3 * away:.1f} mrad from the expected course, "
        f"{1e3 * left:+.1f} mrad from the command at the end",
        values={"away_rad": f"{away:.6f}", "end_rad": f"{left:.6f}"},
        limits={"away_rad": usual},
    )


CHECKS: tuple[Callable[[BagFacts], CheckResult], ...] = (
    _count, _time_order, _finite, _range, _saturation, _current_sum, _speed_against_position,
    _command_reached,
)
