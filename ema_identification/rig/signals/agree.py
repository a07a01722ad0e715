"""The band in which inertia and viscous friction are those of narrower bands too.

Noise of a position, differentiated twice, is in the regressor of the inertia and makes it too
small, the more the wider the band. A resonance changes it as well; but what resonates follows the
input, and noise does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import signal

from ema_identification.report.words import number
from ema_identification.rig.signals.trajectory import derivative, low_pass, monotone_low_pass
from ema_rig.record import POSITION, SPEED

OCTAVES = 4
ROOM = 2.0
"""The narrowest band holds the motion so many times."""
SHORT = 0.03
"""Share by which the inertia of a band may be below that of half of it ..."""
SURE = 2.0
"""... beyond so many standard errors of their difference, by the jackknife over blocks."""
ALIKE = 0.1
"""Share by which values of two bands differ at most to agree."""
FOLLOWS = 0.5
"""Mean coherence of input and acceleration in the upper octave above which it is no noise."""
BLOCKS, LEAST_ROWS = 12, 60
ROWS_A_BAND = 2.5


@dataclass(frozen=True, slots=True, kw_only=True)
class _Estimate:
    band: float
    inertia: float
    viscous: float
    parts: np.ndarray
    """The inertia without each block of time, shape (BLOCKS,)."""


def agreeing_band(
    pieces: Sequence[dict[str, np.ndarray]], edge: float, motion: float, notes: list[str]
) -> float:
    """Return the widest band, of `edge` and its halves, whose inertia noise does not make small.

    Parameters
    ----------
    pieces : sequence of dict of ndarray. Stretches of a record, evenly sampled, with ``input`` and
        ``rate``.
    edge, motion : band of the response, and of the speed (Hz).
    notes : the bands over which both agree are added, with the values.
    """
    found: list[_Estimate] = []
    for octave in range(OCTAVES):
        band = edge / 2**octave
        own = _estimate(pieces, band) if octave == 0 or band >= ROOM * motion else None
        if own is None:
            break
        found.append(own)
    if len(found) < 2:
        notes.append(f"band {number(edge)} Hz, no wider than the motion needs")
        return edge
    at = 0
    while at + 1 < len(found) and _falls_short(found[at], found[at + 1]) \
            and _coherence(pieces, found[at].band) < FOLLOWS:
        at += 1
    if at:
        notes.append(f"band taken at {number(found[at].band)} Hz instead of {number(edge)} Hz: "
                     f"above it noise makes the inertia too small ({number(found[0].inertia)} "
                     f"instead of {number(found[at].inertia)})")
    last = at
    while last + 1 < len(found) and _alike(found[at], found[last + 1]):
        last += 1
    if last > at:
        notes.append("inertia and viscous friction, without any other law "
                     f"{number(found[at].inertia)} and {number(found[at].viscous)}, agree over "
                     f"bands of {number(found[last].band)} to {number(found[at].band)} Hz")
    elif at + 1 < len(found):
        notes.append("inertia or viscous friction differ between bands of "
                     f"{number(found[at + 1].band)} and {number(found[at].band)} Hz "
                     f"({number(found[at + 1].inertia)} and {number(found[at].inertia)}; "
                     f"{number(found[at + 1].viscous)} and {number(found[at].viscous)}): the "
                     "record hardly shows them, a law is missing, or there is a resonance")
    return found[at].band


def _falls_short(wide: _Estimate, narrow: _Estimate) -> bool:
    error = float(np.sqrt((BLOCKS - 1) * np.var(narrow.parts - wide.parts)))
    return narrow.inertia - wide.inertia > max(SHORT * abs(narrow.inertia), SURE * error)


def _alike(one: _Estimate, other: _Estimate) -> bool:
    """Return whether both values are the same."""
    return all(abs(a - b) <= ALIKE * abs(a)
               for a, b in ((one.inertia, other.inertia), (one.viscous, other.viscous)))


def _motion_of(piece: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return speed and acceleration of a stretch."""
    step = 1.0 / float(piece["rate"])
    speed = piece[SPEED] if SPEED in piece else derivative(piece[POSITION], step)
    return speed, derivative(speed, step)


def _estimate(pieces: Sequence[dict[str, np.ndarray]], band: float) -> _Estimate | None:
    """Return inertia and viscous friction under one band, beside dry friction and an offset."""
    rows = []
    for piece in pieces:
        rate = float(piece["rate"])
        speed, hard = _motion_of(piece)
        columns = np.column_stack([
            hard, speed, np.sign(monotone_low_pass(speed, rate, band)), np.ones(len(speed)),
            piece["input"]])
        every = max(1, int(rate / (ROWS_A_BAND * band)))
        edge = int(0.5 * rate / band) + 1
        rows.append(low_pass(columns, rate, band)[edge:len(columns) - edge:every])
    data = np.concatenate(rows)
    if len(data) < LEAST_ROWS:
        return None
    scale = np.maximum(np.sqrt(np.mean(data[:, :4] ** 2, axis=0)), 1e-300)
    columns, target = data[:, :4] / scale, data[:, 4]
    whole, *_ = np.linalg.lstsq(columns, target, rcond=1e-8)
    parts = np.array([np.linalg.lstsq(
        np.delete(columns, own, axis=0), np.delete(target, own), rcond=1e-8)[0]
        for own in np.array_split(np.arange(len(target)), BLOCKS)])
    return _Estimate(band=band, inertia=float(whole[0] / scale[0]),
                     viscous=float(whole[1] / scale[1]), parts=parts[:, 0] / scale[0])


def _coherence(pieces: Sequence[dict[str, np.ndarray]], band: float) -> float:
    """Return the mean coherence of input and acceleration in the octave below `band`."""
    longest = max(pieces, key=lambda piece: len(piece["input"]))
    rate = float(longest["rate"])
    length = int(min(len(longest["input"]) // 4, 16 * rate / band))
    frequency, coherence = signal.coherence(
        longest["input"], _motion_of(longest)[1], rate, nperseg=max(length, 16))
    inside = (frequency >= 0.5 * band) & (frequency <= band)
    return float(np.mean(coherence[inside])) if inside.any() else 0.0
