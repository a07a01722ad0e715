"""What a recorder did to its columns: spikes, values that are held, steps of a converter.

Spikes are taken out and held samples left out, since every law would lean on them; both are said,
and so are the steps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ema_identification.report.words import number
from ema_identification.rig.signals.plausible import GAP
from ema_rig.record import POSITION, SPEED, RigRecord

SPIKE, LARGE = 20.0, 0.05
"""A spike stands out by so many robust deviations of the second difference, and by this share of
the range."""
BACK = 0.3
"""It is back within this share of itself; of a step half of it is not."""
FEW_SPIKES = 0.01
"""Share of the samples, at most: more is no spike."""
MOST_HELD = 50
ALWAYS = 0.98
"""Share of the changes that fall on every m-th sample, for a channel to be held for m."""
LEAST_CHANGES, LEVELS = 100, 30
LEAST_LEFT = 400
"""Samples that are left at least, for held ones to be left out."""
SAME = 0.05
"""Least share of samples that repeat the one before, for the steps of a converter to be told."""


def cleaned(record: RigRecord, notes: list[str]) -> RigRecord:
    """Return the record without spikes and held samples; what was done is added to `notes`."""
    samples = record.samples.copy()
    kept = [record.axis.input_channel.name, POSITION, SPEED]
    places = [k for k, channel in enumerate(record.channels) if channel.name in kept]
    steps = np.diff(record.time)
    whole = steps <= GAP * np.median(steps)
    near = np.r_[False, whole] & np.r_[whole, False]
    for k in places:
        spikes = spikes_of(samples[:, k])
        spikes = spikes[near[spikes]]
        if len(spikes):
            samples[spikes, k] = 0.5 * (samples[spikes - 1, k] + samples[spikes + 1, k])
            notes.append(f"{record.source}: {len(spikes)} spike(s) of one sample taken out of "
                         f"{record.channels[k].name}, the first at {samples[spikes[0], 0]:.4g} s")
    held = {record.channels[k].name: held_for(samples[:, k]) for k in places}
    most, phase = max(held.values())
    if most > 1 and len(samples) // most >= LEAST_LEFT:
        samples = samples[phase::most]
        names = ", ".join(f"{name} for {m} samples" for name, (m, _) in held.items() if m > 1)
        notes.append(f"{record.source}: values are held ({names}): one sample of {most} is used")
    elif most > 1:
        name = max(held, key=lambda name: held[name])
        notes.append(f"{record.source}: {name} is held for {most} samples, too long for this "
                     "record to leave the others out: record longer, or faster")
    for k in places:
        step = step_of(samples[:, k])
        if step is not None:
            channel = record.channels[k]
            turn = f", {2 * np.pi / step:.5g} a turn" if channel.name == POSITION \
                and record.axis.motion == "rotary" else ""
            notes.append(f"{record.source}: {channel.name} has steps of {number(step)} "
                         f"{channel.unit}{turn}")
    return replace(record, samples=samples)


def spikes_of(values: np.ndarray) -> np.ndarray:
    """Return the samples that stand alone, shape (k,); a step is none, as it does not return."""
    bend = values[1:-1] - 0.5 * (values[2:] + values[:-2])
    low, high = np.quantile(values, [0.01, 0.99])
    usual = 1.4826 * float(np.median(np.abs(bend)))
    large = np.abs(bend) > max(SPIKE * usual, LARGE * float(high - low), 1e-300)
    before, after = np.r_[0.0, bend[:-1]], np.r_[bend[1:], 0.0]
    back = np.maximum(np.abs(before + 0.5 * bend), np.abs(after + 0.5 * bend)) \
        < BACK * np.abs(bend)
    found = np.nonzero(large & back)[0] + 1
    return found if len(found) <= FEW_SPIKES * len(values) else np.empty(0, dtype=np.int64)


def held_for(values: np.ndarray) -> tuple[int, int]:
    """Return for how many samples a channel holds each value, 1 where it does not; and the first.

    Held ones change at every m-th sample only, whatever the motion. A command of a few levels that
    keeps a clock is no held one: it is what it says in between too.
    """
    changes = np.nonzero(np.diff(values))[0] + 1
    if len(np.unique(values)) < LEVELS or not LEAST_CHANGES <= len(changes) <= 0.55 * len(values):
        return 1, 0
    for m in range(MOST_HELD, 1, -1):
        phases = np.bincount(changes % m, minlength=m)
        if phases.max() >= ALWAYS * len(changes):
            return m, int(np.argmax(phases))
    return 1, 0


def step_of(values: np.ndarray) -> float | None:
    """Return the step of a converter that is seen in the values, None where it is not."""
    steps = np.diff(values)
    if np.mean(steps == 0.0) < SAME:
        return None
    levels = np.diff(np.unique(values))
    levels = levels[levels > 1e-9 * float(np.ptp(values) or 1.0)]
    if len(levels) < 5:
        return None
    step = float(np.min(levels))
    off = np.abs(levels / step - np.rint(levels / step))
    return step if float(np.mean(off < 0.05)) > 0.95 else None
