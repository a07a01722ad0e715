"""Matched filters on the torque lines: how strong each line is, and how much like a short.

A fault changes the torque constants, so line h of the torque residual is the same part of the
torque at every speed (DESIGN, section 4): the lines of the slews are averaged with the weights
that scatter least over healthy units, and counted in healthy deviations σ_h. A short in phase k
has lines 2 and 4 in fixed proportion, turned by −h k 120°; an eccentricity has lines 1 and 3 in
any direction, so there the amplitude is what tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

HARMONICS = 6
SPEEDS = ("quarter", "full")
SHORT_LINES = (2, 4)
FLOOR = 1e-6
DERIVED = (
    *(f"amplitude_{h}" for h in range(1, HARMONICS + 1)),
    "short_like_a", "short_like_b", "short_like_c", "short_like_best", "short_unlike",
    "odd_amplitude",
)
"""Names of what `LineFilter.derive` returns, in order."""


def even_lines(names: Sequence[str], x: np.ndarray, part: str = "even") -> np.ndarray:
    """Return the lines of the slews forward and back, averaged; complex, shape (n, speeds, 6).

    Parameters
    ----------
    names : of the features.
    x : ndarray, shape (n, d). Features.
    part : even, or odd: half the difference of forward and back.
    """
    index = {name: k for k, name in enumerate(names)}
    speeds = [s for s in SPEEDS if f"{s}_{part}_m1_re" in index]
    found = np.empty((len(x), len(speeds), HARMONICS), dtype=complex)
    for i, speed in enumerate(speeds):
        for h in range(HARMONICS):
            stem = f"{speed}_{part}_m{h + 1}"
            found[:, i, h] = x[:, index[f"{stem}_re"]] + 1j * x[:, index[f"{stem}_im"]]
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class LineFilter:
    """The filters of one view.

    Attributes
    ----------
    weight : ndarray, shape (speeds, 6). Of each speed's line, summing to 1.
    deviation : ndarray, shape (6,). Healthy standard deviation of the weighted lines.
    template : ndarray, complex, shape (2,). Lines 2 and 4 of a short in phase a, per fraction.
    """

    weight: np.ndarray
    deviation: np.ndarray
    template: np.ndarray

    def derive(self, names: Sequence[str], x: np.ndarray) -> np.ndarray:
        """Return `DERIVED` for features `x`, shape (n, d), in healthy deviations."""
        lines = (even_lines(names, x) * self.weight).sum(axis=1) / self.deviation
        pick = [h - 1 for h in SHORT_LINES]
        measured = lines[:, pick]
        turns = np.exp(-2j * np.pi / 3.0 * np.outer(np.arange(3), SHORT_LINES))
        patterns = turns * self.template / self.deviation[pick]
        patterns = patterns / np.sqrt((np.abs(patterns) ** 2).sum(axis=1))[:, None]
        like = (measured @ patterns.conj().T).real
        best = np.maximum(like.max(axis=1), 0.0)
        rest = np.maximum((np.abs(measured) ** 2).sum(axis=1) - best**2, 0.0)
        odd = even_lines(names, x, "odd")
        run_out = (np.abs(odd).max(axis=(1, 2)) if odd.shape[1] else np.zeros(len(x)))
        return np.column_stack([
            np.abs(lines), like, best, np.sqrt(rest), run_out / self.deviation.min()
        ])


def fit_line_filter(
    names: Sequence[str], healthy: np.ndarray, shorted: np.ndarray, fraction: np.ndarray
) -> LineFilter:
    """Return the filters from healthy records and shorts of phase a.

    Parameters
    ----------
    names : of the features.
    healthy : ndarray, shape (n, d).
    shorted : ndarray, shape (m, d). Records with a short in phase a alone.
    fraction : ndarray, shape (m,). Their shorted turns.
    """
    sound = even_lines(names, healthy)
    speeds = sound.shape[1]
    weight, deviation = np.empty((speeds, HARMONICS)), np.empty(HARMONICS)
    for h in range(HARMONICS):
        part = sound[:, :, h]
        covariance = (part.conj().T @ part).real / len(part) + FLOOR * np.eye(speeds)
        inverse = np.linalg.solve(covariance, np.ones(speeds))
        weight[:, h] = inverse / inverse.sum()
        deviation[h] = np.sqrt(weight[:, h] @ covariance @ weight[:, h])
    lines = (even_lines(names, shorted) * weight).sum(axis=1)[:, [h - 1 for h in SHORT_LINES]]
    small = fraction < 0.15
    template = (fraction[small] @ lines[small]) / max(float((fraction[small] ** 2).sum()), FLOOR)
    return LineFilter(weight=weight, deviation=deviation, template=template)
