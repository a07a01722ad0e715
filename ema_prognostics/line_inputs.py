"""Torque lines of all segments combined, and what the networks read off them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_prognostics.turns import TURN

SHORT_LINES = {2: 0.278, 4: 0.132}
"""|m_h| of a turn short per shorted part of the turns (DESIGN, section 4)."""
ANN_A_NAMES = (
    "odd_lines", "even_lines", "line_5", "short_direction_2", "short_direction_4",
)
GUARD_NAMES = (
    "line_1", "line_2", "line_3", "line_4", "line_5", "line_6", "short_direction_2",
    "short_direction_4",
)
SHORT_NAMES = ("log_matched", "log_line_2", "log_line_4")
ECCENTRICITY_NAMES = (
    "log_total", "share_1", "share_2", "share_3", "share_4", "direction_1_3", "direction_3",
)
PHASES = ("a", "b", "c")


@dataclass(frozen=True, slots=True, kw_only=True)
class LineStatistics:
    """Lines of healthy units: what is subtracted, how the segments are weighted.

    Attributes
    ----------
    baseline : ndarray, complex, shape (segments, 6). Mean of healthy units.
    weight : ndarray, shape (segments, 6). Sums to 1 over the segments.
    deviation : ndarray, shape (6,). Rms of the combined lines of healthy units.
    """

    baseline: np.ndarray
    weight: np.ndarray
    deviation: np.ndarray

    def combine(self, lines: np.ndarray) -> np.ndarray:
        """Return the combined lines, complex, shape (..., 6), of (..., segments, 6)."""
        return np.sum((lines - self.baseline) * self.weight, axis=-2)


def line_statistics(lines: np.ndarray) -> LineStatistics:
    """Return the statistics of healthy units, `lines` complex, shape (n, segments, 6)."""
    baseline = lines.mean(axis=0)
    inverse = 1.0 / np.mean(np.abs(lines - baseline) ** 2, axis=0)
    weight = inverse / inverse.sum(axis=0)
    combined = np.sum((lines - baseline) * weight, axis=1)
    return LineStatistics(
        baseline=baseline, weight=weight,
        deviation=np.sqrt(np.mean(np.abs(combined) ** 2, axis=0)),
    )


def _direction(line: np.ndarray, deviation: float) -> np.ndarray:
    """Return +1 where a line points as a short of any phase does, -1 opposite, 0 if faint."""
    return np.tanh(np.abs(line) / (4.0 * deviation)) * np.cos(3.0 * np.angle(line))


def _directions(combined: np.ndarray, statistics: LineStatistics) -> np.ndarray:
    """Return how lines 2 and 4 point, shape (n, 2)."""
    return np.column_stack([
        _direction(combined[:, h - 1], statistics.deviation[h - 1]) for h in (2, 4)
    ])


def ann_a_inputs(combined: np.ndarray, statistics: LineStatistics) -> np.ndarray:
    """Return the inputs of ANN_A, shape (n, 5), for combined lines, shape (n, 6).

    The size of the odd lines 1 and 3 together, of the even lines 2 and 4 together, of line 5,
    all relative to healthy units, and how lines 2 and 4 point.
    """
    size = np.abs(combined) / statistics.deviation
    sizes = [np.hypot(size[:, 0], size[:, 2]), np.hypot(size[:, 1], size[:, 3]), size[:, 4]]
    return np.column_stack([*np.arcsinh(sizes), _directions(combined, statistics)])


def guard_inputs(combined: np.ndarray, statistics: LineStatistics) -> np.ndarray:
    """Return what the guard compares, shape (n, 8): every line, and how 2 and 4 point."""
    sizes = np.arcsinh(np.abs(combined) / statistics.deviation)
    return np.column_stack([sizes, _directions(combined, statistics)])


def matched_short(
    combined: np.ndarray, statistics: LineStatistics
) -> tuple[np.ndarray, np.ndarray]:
    """Return phase (index) and shorted part of the turns, shape (n,) each, by matched filter."""
    estimate = np.zeros((3, len(combined)))
    norm = 0.0
    for h, size in SHORT_LINES.items():
        weight = statistics.deviation[h - 1] ** -2
        norm += weight * size**2
        for k in range(3):
            turned = combined[:, h - 1] * np.exp(1j * h * k * TURN / 3.0)
            estimate[k] += weight * size * turned.real
    estimate /= norm
    phase = np.argmax(estimate, axis=0)
    return phase, estimate[phase, np.arange(len(combined))]


def short_inputs(combined: np.ndarray, statistics: LineStatistics) -> np.ndarray:
    """Return the inputs of the turn short's ANN_B, shape (n, 3): logs of three estimates of x."""
    _, matched = matched_short(combined, statistics)
    floor = statistics.deviation[1] / SHORT_LINES[2]
    return np.log(np.column_stack([
        np.maximum(matched, floor),
        np.maximum(np.abs(combined[:, 1]) / SHORT_LINES[2], floor),
        np.maximum(np.abs(combined[:, 3]) / SHORT_LINES[4], floor),
    ]))


def eccentricity_inputs(combined: np.ndarray, statistics: LineStatistics) -> np.ndarray:
    """Return the inputs of the eccentricity's ANN_B, shape (n, 7).

    The size of lines 1 to 4 together, their shares, and two angles that neither the phase nor
    the sign of ζ turns: with the angle of the eccentricity the lines grow and shrink.
    """
    sizes = np.abs(combined[:, :4])
    total = np.sqrt(np.sum(sizes**2, axis=1))
    clear = np.tanh(sizes[:, [0, 2]] / (4.0 * statistics.deviation[[0, 2]]))
    turned = np.cos(3.0 * np.angle(combined[:, 0]) - np.angle(combined[:, 2]))
    return np.column_stack([
        np.log(total + statistics.deviation[:4].mean()), sizes / total[:, None],
        clear.min(axis=1) * turned, clear[:, 1] * np.cos(2.0 * np.angle(combined[:, 2])),
    ])
