"""Rules on the stream of blocks: gaps, clocks, order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ema_record.channels import MOTOR_SPEED, ROTOR_ANGLE, TIME
from ema_record.checks.facts import BagFacts, Hit, Rule
from ema_record.record import LARGEST_STEP, SampleBlock

RECEPTION_SHIFT = 0.2
"""Lasting shift of the reception clock against the samples' that no delay explains (s)."""
_NEIGHBOURS = 20


def _overlaps(blocks: Sequence[SampleBlock], number: int) -> bool:
    """Return whether the times of a block lie within those of another one."""
    begin, end = (float(blocks[number].samples[k, TIME]) for k in (0, -1))
    return any(
        float(b.samples[0, TIME]) <= end and begin <= float(b.samples[-1, TIME])
        for k, b in enumerate(blocks) if k != number
    )


def _orders(facts: BagFacts) -> Iterator[tuple[str, Hit]]:
    """Return blocks that do not follow the one before: kind and place."""
    blocks = facts.blocks
    if not blocks or facts.in_order:
        return
    seen: dict[bytes, int] = {}
    latest = -np.inf
    for number, block in enumerate(blocks):
        begin = float(block.samples[0, TIME])
        key = block.samples.tobytes()
        if key in seen:
            yield "duplicate", Hit(
                f"block {number} at {begin:.4f} s is the same as block {seen[key]}",
                begin, float(len(block.samples)), "samples",
            )
        elif begin <= latest:
            kind = "clock" if _overlaps(blocks, number) else "order"
            what = "time steps back" if kind == "clock" else "comes after later ones: time steps"
            yield kind, Hit(
                f"block {number} {what} from {latest:.4f} s to {begin:.4f} s",
                begin, latest - begin, "s",
            )
        timed = block.samples[np.isfinite(block.samples[:, TIME]), TIME]
        steps = np.diff(timed)
        if len(steps) and not steps.min() > 0.0:
            row = int(np.argmax(~(steps > 0.0)))
            yield "clock", Hit(
                f"time steps back within block {number}", float(timed[row]),
                float(abs(steps[row])), "s",
            )
        seen.setdefault(key, number)
        latest = max(latest, float(timed.max(initial=-np.inf)))


def _jumps(facts: BagFacts) -> Iterator[tuple[str, Hit]]:
    """Return forward jumps of time: whether samples are missing or the clock jumped."""
    s, interval = facts.samples, facts.interval
    if len(s) < 2:
        return
    if s[0, TIME] > LARGEST_STEP * interval:
        missing, span = float(s[0, TIME]) / interval - 0.5, float(np.ptp(s[:, TIME]))
        whole = facts.profile and span > facts.profile.duration - LARGEST_STEP * interval
        yield "gap", Hit(
            f"the times of a whole test begin at {s[0, TIME]:.4f} s: count them from its command"
            if whole else f"the first {missing:.0f} samples are missing",
            0.0, float(s[0, TIME]), "s",
        )
    steps = np.diff(s[:, TIME])
    if len(facts.unusable):
        steps -= interval * np.diff(np.searchsorted(facts.unusable, s[:, TIME], side="left"))
    reception = {float(b.samples[0, TIME]): k for k, b in enumerate(facts.blocks)}
    for row in np.flatnonzero(steps > LARGEST_STEP * interval).tolist():
        jump = float(steps[row]) - interval
        number = reception.get(float(s[row + 1, TIME]), 0)
        if number > 0 and not facts.uploaded:
            waited = 1e-9 * (facts.blocks[number].log_time - facts.blocks[number - 1].log_time)
            usual = len(facts.blocks[number].samples) * interval
            lost = waited - usual > 0.5 * jump
        elif not facts.has(ROTOR_ANGLE):
            lost = True
        else:
            turned = s[row + 1, ROTOR_ANGLE] - s[row, ROTOR_ANGLE]
            speed = s[row, MOTOR_SPEED] * facts.actuator.motor.pole_pairs
            by_gap, by_clock = (
                abs(np.angle(np.exp(1j * (turned - speed * t))))
                for t in (jump + interval, interval)
            )
            lost = bool(by_gap <= by_clock)
        if lost:
            yield "gap", Hit(
                f"{jump / interval:.0f} samples are missing after {s[row, TIME]:.4f} s",
                float(s[row, TIME]), jump, "s",
            )
        else:
            yield "clock", Hit(
                f"time jumps by {1e3 * jump:.3f} ms at {s[row, TIME]:.4f} s, the motion does not",
                float(s[row, TIME]), jump, "s",
            )


def irregular(facts: BagFacts) -> list[tuple[str, Hit]]:
    """Return all that is irregular in the stream: kind and place."""
    return [*_jumps(facts), *_orders(facts)]


def _of_kind(kind: str) -> Callable[[BagFacts], list[Hit]]:
    """Return the function that finds irregularities of one kind."""

    def find(facts: BagFacts) -> list[Hit]:
        return [hit for found, hit in facts.derived(irregular) if found == kind]

    return find


def reception_clock(facts: BagFacts) -> Iterator[Hit]:
    """Find steps of the recorder's clock; what was uploaded came in a time of its own."""
    if len(facts.blocks) < 2 or facts.uploaded:
        return
    logged = np.array([block.log_time for block in facts.blocks])
    ends = np.array([float(block.samples[-1, TIME]) for block in facts.blocks])
    back = np.flatnonzero(np.diff(logged) < 0)
    if len(back):
        k = int(back[0])
        size = 1e-9 * float(logged[k] - logged[k + 1])
        yield Hit(f"the recorder's clock steps back by {size:.3f} s", float(ends[k]), -size, "s")
        return
    if not np.isfinite(ends).all() or np.diff(ends).min() <= 0.0:
        return  # told by the rules on the samples' clock
    offset = 1e-9 * (logged - logged[0]) - (ends - ends[0])
    for k in range(1, len(offset)):
        step = offset[k:].min() - offset[max(0, k - _NEIGHBOURS):k].max()
        if step > RECEPTION_SHIFT:
            yield Hit(
                f"the recorder's clock jumps by {step:.3f} s against the samples'",
                float(ends[k]), float(step), "s",
            )
            return


def repeated(facts: BagFacts) -> Iterator[Hit]:
    """Find data that come again at a later time, noise and all."""
    s = facts.samples
    if len(s) < 100:
        return
    weights = np.sqrt([2, 3, 5, 7, 11, 13, 17, 19, 23])
    mark = np.zeros(len(s))
    for column in facts.columns[1:]:
        mark += weights[column - 1] * s[:, column]
    if np.diff(np.sort(mark)).all():
        return
    order = np.argsort(mark, kind="stable")
    before = np.zeros(len(s), dtype=np.int64)
    same = mark[order][1:] == mark[order][:-1]
    before[order[1:][same]] = (order[1:] - order[:-1])[same]
    moving = np.abs(s[:, MOTOR_SPEED]) > facts.standing
    again = (before > 1) & moving
    edges = np.flatnonzero(np.diff(np.where(again, before, 0), prepend=0, append=0))
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist()):
        if again[begin] and end - begin >= 20:
            yield Hit(
                f"{end - begin} samples are those of {before[begin]} samples before",
                float(s[begin, TIME]), float(end - begin), "samples",
            )


_RECORD_AGAIN = "record the test again; look for lost messages or a loaded recorder"
RULES = (
    Rule(name="gap", find=_of_kind("gap"), remedy=_RECORD_AGAIN),
    Rule(name="clock_jump", find=_of_kind("clock"),
         remedy="use a monotonic clock in the acquisition and record the test again"),
    Rule(name="duplicate_block", find=_of_kind("duplicate"),
         remedy="look for a second publisher or a bag merged twice; record the test again"),
    Rule(name="reordered_block", find=_of_kind("order"),
         remedy="use reliable, in-order transport and record the test again"),
    Rule(name="repeated_data", find=repeated,
         remedy="the acquisition sent an old buffer: update its software, record again"),
    Rule(name="reception_clock", find=reception_clock, level="warning",
         remedy="the recorder's clock was set during the test: do not set it while recording"),
)
