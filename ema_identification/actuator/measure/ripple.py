"""Ripple of any period: the clearest torque line that is left.

The line must have one phase in rotor angle in many sections of the test, as a ripple of the
machine has; a limit cycle that keeps step with the rotor in one section has not.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.measure.features import FeatureMap

STRONG_LINE = 8.0
"""Least residual of a line (standard deviations, re and im)."""
COHERENT = 0.85
"""Least part of the power of a line that has one phase in all sections."""
ONE_SPEED = 20.0, 0.95
"""The same two for the sections of one speed alone: two of them agree by chance more often."""


class _Line(NamedTuple):
    """A line of one order in the sections of one group."""

    common: float
    """Power of one phase (variances, re and im)."""
    coherence: float
    """The same, of all its power."""
    amplitude: float
    """N m."""
    place: str


class _Left(NamedTuple):
    """A line of one order that is left in one section."""

    line: complex
    """mA."""
    weight: float
    """1 / variance of its parts."""


def largest_line(
    fmap: FeatureMap, residual: np.ndarray, deviation: np.ndarray
) -> tuple[int, float, str] | None:
    """Return order, amplitude (N m) and segment of the clearest torque line that is left.

    A ripple of the machine has one phase in rotor angle in all sections of the test, or one that
    turns over with the direction; a limit cycle that keeps step with the rotor in one section has
    neither.

    Parameters
    ----------
    fmap : of the record.
    residual : ndarray, shape (d,), in standard deviations.
    deviation : ndarray, shape (d,). Standard deviations of a repeat.
    """
    speeds = {s.name: s.speed for s in fmap.plan.segments}
    sizes = {name: round(abs(v), 3) for name, v in speeds.items()}
    groups = [(list(speeds), STRONG_LINE, COHERENT)] + [
        ([n for n in speeds if sizes[n] == v], *ONE_SPEED)
        for v in sorted(set(sizes.values()), reverse=True)]
    left = _left(fmap, residual, deviation)
    clear = {order: [line for group in groups if (line := _clear(places, speeds, *group))]
             for order, places in left.items()}
    clear = {order: lines for order, lines in clear.items() if lines}
    if not clear:
        return None
    order = max(clear, key=lambda o: max(line.common for line in clear[o]))
    line = max(clear[order], key=lambda x: x.coherence)
    (text,) = (s.text for s in fmap.plan.segments if s.name == line.place)
    return order, line.amplitude, text


def _left(
    fmap: FeatureMap, residual: np.ndarray, deviation: np.ndarray
) -> dict[int, dict[str, _Left]]:
    """Return the torque lines that are left, by order and place."""
    lines: dict[tuple[int, str], complex] = defaultdict(complex)
    variances: dict[tuple[int, str], float] = defaultdict(float)
    for feature, x, sd in zip(fmap.features, residual, deviation):
        if ".torque_line_" in feature.name:
            key = int(feature.name.split("_")[2]), feature.place
            lines[key] += float(x * sd) * (1.0 if feature.name.endswith("_re") else 1j)
            variances[key] += 0.5 * float(sd)**2
    found: dict[int, dict[str, _Left]] = defaultdict(dict)
    for (order, place), line in lines.items():
        found[order][place] = _Left(line, 1.0 / variances[order, place])
    return found


def _clear(
    places: Mapping[str, _Left], speeds: Mapping[str, float], among: Sequence[str],
    strong: float, coherent: float,
) -> _Line | None:
    """Return what the sections `among` have in common, where that is clear."""
    chosen = [p for p in among if p in places]
    if len(chosen) < 2:
        return None
    lines = np.array([places[p].line for p in chosen])
    weight = np.array([places[p].weight for p in chosen])
    sense = np.sign([speeds[p] for p in chosen])
    along = max((_power_along(lines, weight), _power_along(sense * lines, weight)), key=np.sum)
    power = weight * np.abs(lines)**2
    common, whole = float(along.sum()), float(power.sum())
    if (common > max(2.0 * strong**2, coherent * whole)
            and common - along.max() > strong**2):
        return _Line(
            common=common, coherence=common / whole,
            amplitude=2e-3 * float(power @ np.abs(lines) / power.sum()),
            place=chosen[int(np.argmax(power))])
    return None


def _power_along(lines: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the power of each line along the phase that most of their power has.

    How large a line is may differ among sections: at low speed the shaft holds the rotor, and the
    current sees less of the same ripple.
    """
    whole = weight * np.abs(lines) @ lines
    if whole == 0.0:
        return np.zeros(len(lines))
    return np.asarray(weight * np.maximum(0.0, (lines * np.conj(whole / abs(whole))).real)**2)
