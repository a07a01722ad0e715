"""Small charts as SVG text, for a page without scripts: a trace, evidence, a trend.

All take plain numbers and give one ``<svg>`` element with a title for readers that do not see it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np

WIDTH = 660
"""Of a chart (user units; it scales with the page)."""
INK, QUIET, BAND, OWN, BLUE, RED = (
    "#1d2530", "#5b6570", "#cfd8e3", "#9cc7e8", "#0072b2", "#b34d00")
LONGEST = 52
"""Text beside a row of evidence (characters)."""
POINTS = 480
"""Of a trace, at most."""


class AxisScale(NamedTuple):
    """From numbers to user units."""

    low: float
    high: float
    begin: float
    end: float

    def __call__(self, value: float) -> float:
        """Return where a value stands, kept to the axis."""
        span = (self.high - self.low) or 1.0
        at = self.begin + (value - self.low) / span * (self.end - self.begin)
        least, most = sorted((self.begin, self.end))
        return round(min(max(at, least), most), 1)


def _svg(height: float, title: str, *parts: str) -> str:
    return (f'<svg viewBox="0 0 {WIDTH} {height:g}" role="img" aria-label="{escape(title)}" '
            f'xmlns="http://www.w3.org/2000/svg">{"".join(parts)}</svg>')


def _text(x: float, y: float, text: str, anchor: str = "start", color: str = QUIET) -> str:
    return (f'<text x="{x:g}" y="{y:g}" fill="{color}" font-size="11" '
            f'text-anchor="{anchor}">{escape(text)}</text>')


def _line(xs: Sequence[float], ys: Sequence[float], color: str, extra: str = "") -> str:
    points = " ".join(f"{x:g},{y:g}" for x, y in zip(xs, ys))
    return f'<polyline points="{points}" fill="none" stroke="{color}" {extra}/>'


def _cut(text: str) -> str:
    """Return a text that leaves its column to the next one."""
    return text if len(text) <= LONGEST else text[:LONGEST - 1].rstrip() + "…"


def _box(x: float, y: float, width: float, height: float, color: str) -> str:
    return (f'<rect x="{x:g}" y="{y:g}" width="{max(width, 1.5):g}" height="{height:g}" '
            f'fill="{color}"/>')


def trace(
    time: np.ndarray, command: np.ndarray, measured: np.ndarray,
    phases: Sequence[tuple[float, float, str]], labels: Mapping[str, str],
) -> str:
    """Return surface position against time, the phases of the test shaded.

    Parameters
    ----------
    time, command, measured : ndarray, shape (n,) (s, rad, rad).
    phases : begin, end (s) and name of each.
    labels : ``title``, ``command``, ``measured``.
    """
    height, left, bottom = 116.0, 58.0, 98.0
    pick = np.unique(np.linspace(0, len(time) - 1, min(POINTS, len(time))).astype(int))
    both = np.concatenate([command[pick], measured[pick]])
    x = AxisScale(float(time[0]), float(time[-1]), left, WIDTH - 4.0)
    y = AxisScale(float(both.min()), float(both.max()), bottom - 4.0, 16.0)
    parts = []
    for begin, end, name in phases:
        parts.append(_box(x(begin), 14.0, x(end) - x(begin), bottom - 14.0, "#eef1f5"))
        parts.append(_text(0.5 * (x(begin) + x(end)), 10.0, name, "middle"))
    for values, color, extra in ((measured, BLUE, 'stroke-width="2"'),
                                 (command, INK, 'stroke-width="1" stroke-dasharray="4 3"')):
        ys = [y(v) for v in values[pick]]
        parts.append(_line([x(t) for t in time[pick]], ys, color, extra))
    for value in (float(both.min()), 0.0, float(both.max())):
        said = f"{value:.2g} rad".replace("-", "−")
        parts.append(_text(left - 4.0, y(value) + 4.0, said, "end"))
    parts += [_text(left, 112.0, f"{round(float(time[0]), 2):g} s"),
              _text(WIDTH - 4.0, 112.0, f"{time[-1]:.3g} s", "end"),
              _text(0.5 * WIDTH, 112.0, f"— {labels['measured']}   - - {labels['command']}",
                    "middle")]
    return _svg(height, labels["title"], *parts)


def evidence(rows: Sequence[Mapping[str, Any]], labels: Mapping[str, str]) -> str:
    """Return each value beside the bands of healthy units and of the unit itself.

    Parameters
    ----------
    rows : ``text``, ``shown``, ``value``, ``healthy`` and ``own`` (range or None), ``times``.
    labels : ``title``, ``healthy``, ``own``, ``measured``.
    """
    step, left, right = 21.0, 404.0, WIDTH - 46.0
    parts = []
    for k, row in enumerate(rows):
        top = 20.0 + k * step
        ends = [row["value"], *(row["healthy"] or ()), *(row["own"] or ())]
        margin = 0.06 * (max(ends) - min(ends) or 1.0)
        x = AxisScale(min(ends) - margin, max(ends) + margin, left, right)
        parts.append(_text(0.0, top + 10.8, _cut(row["text"]), "start", INK))
        parts.append(_text(left - 8.0, top + 10.8, row["shown"], "end", INK))
        parts.append(_box(left, top + 7.0, right - left, 1.0, "#e3e7ec"))
        for key, color, inset in (("healthy", BAND, 0.0), ("own", OWN, 3.0)):
            if row[key]:
                low, high = row[key]
                parts.append(_box(x(low), top + 1.0 + inset, x(high) - x(low), 13.0 - 2.0 * inset,
                                  color))
        at = x(row["value"])
        parts.append(f'<path d="M{at:g} {top + 1:g}l5 6.5-5 6.5-5-6.5z" fill="{RED}"/>')
        parts.append(_text(WIDTH, top + 10.8, row["times"], "end", INK))
    legend = [_box(left, 4.0, 12.0, 8.0, BAND), _text(left + 16.0, 12.0, labels["healthy"]),
              f'<path d="M{right - 60:g} 3l4 5-4 5-4-5z" fill="{RED}"/>',
              _text(right - 52.0, 12.0, labels["measured"])]
    if any(row["own"] for row in rows):
        legend += [_box(0.0, 4.0, 12.0, 8.0, OWN), _text(16.0, 12.0, labels["own"])]
    return _svg(24.0 + step * len(rows), labels["title"], *legend, *parts)


def trend(
    series: Sequence[Mapping[str, Any]], levels: Sequence[tuple[str, float]],
    labels: Mapping[str, str],
) -> str:
    """Return the size of a fault over the flights with its intervals.

    Parameters
    ----------
    series : ``flight``, ``value`` (None: not found), ``low``, ``high``.
    levels : name and size of each.
    labels : ``title``, ``unit``, ``flight``.
    """
    left, bottom = 44.0, 72.0
    found = [one for one in series if one["value"] is not None]
    top = max([one["high"] for one in found] + [1e-12])
    x = AxisScale(1.0, float(max(2, len(series))), left + 8.0, WIDTH - 70.0)
    y = AxisScale(0.0, 1.05 * top, bottom, 8.0)
    parts = [_line([left, WIDTH - 62.0], [bottom, bottom], "#b5bec9")]
    for name, value in levels:
        if value < 1.05 * top:
            parts.append(_line([left, WIDTH - 62.0], [y(value)] * 2, QUIET,
                               'stroke-dasharray="5 4"'))
            parts.append(_text(WIDTH - 58.0, y(value) + 4.0, name))
    for one in series:
        at = x(one["flight"])
        if one["value"] is None:
            parts.append(f'<circle cx="{at:g}" cy="{bottom:g}" r="2" fill="{QUIET}"/>')
            continue
        parts.append(_line([at, at], [y(one["low"]), y(one["high"])], BLUE))
        parts.append(f'<circle cx="{at:g}" cy="{y(one["value"]):g}" r="3" fill="{BLUE}"/>')
    parts += [_text(left - 4.0, y(top) + 6.0, f"{top:.3g}", "end"),
              _text(left - 4.0, bottom, "0", "end"),
              _text(left, 88.0, "1"), _text(x(len(series)), 88.0, str(len(series)), "middle"),
              _text(0.5 * WIDTH, 88.0, f"{labels['flight']} ({labels['unit']})", "middle")]
    return _svg(92.0, labels["title"], *parts)
