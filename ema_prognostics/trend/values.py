"""How a measured value moves from record to record: steps, growth, and a limit of one's own.

For values that a regression gives with their intervals; rate and forecast are those of `growth`.
A step is where two means explain the values better than one line does, beyond chance after all
looks (two-sample t test, Bonferroni over the places).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ema_prognostics.trend.forecast import Forecast, forecast, outlook
from ema_prognostics.trend.growth import QUANTILE, Growth, growth

LEVEL = 0.005
"""Highest p-value of a step and of a growth, each after its looks: a rig has many values."""
SIDE = 3
"""Records on either side of a step at least."""
OVER_LINE = 0.7
"""Share of the squares about a line that a step leaves at most."""
RECENT = 5
"""Last records whose median is the value now where there is no growth."""
LAST = 2
"""Last records whose 90 % intervals pass a limit together, by chance once in 400."""


class StepChange(NamedTuple):
    """A value that is another from one record on."""

    record: int
    """Number of the first one with the new value."""
    before: float
    after: float
    interval: tuple[float, float]
    """Of the change, 90 %."""
    p_value: float


class Passage(NamedTuple):
    """When a limit is reached, by number of the record with its 90 % interval."""

    limit: float
    passed: bool
    record: int | None
    """None: no growth towards it, or no end in sight."""
    interval: tuple[int, int | None] | None
    """None: no growth towards it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ValueTrend:
    """One value over the records.

    Attributes
    ----------
    name, unit : of the value.
    number, value, lower, upper : ndarray, shape (n,). Records that show it, with its 90 %
        interval.
    steps : where it changed at once.
    growth : since the last step, of ``way`` times the value; None: too few records.
    way : 1 rising, -1 falling, 0 neither.
    limit : of one's own, where given.
    """

    name: str
    unit: str
    number: np.ndarray
    value: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    steps: tuple[StepChange, ...]
    growth: Growth | None
    way: int
    limit: Passage | None = None

    @property
    def now(self) -> float:
        """The value at the end."""
        if self.growth is not None and self.way:
            return self.way * self.growth.severity
        return float(np.median(self.value[_since(self.number, self.steps)][-RECENT:]))

    @property
    def moves(self) -> bool:
        """Whether it stepped, grows or falls, or has passed its limit."""
        return bool(self.steps) or self.way != 0 or (self.limit is not None and self.limit.passed)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        rate = None
        if self.growth is not None:
            low, high = self.growth.rate_interval
            sign = self.way or 1
            rate = {"rate": sign * self.growth.rate,
                    "interval": [low, high] if sign > 0 else [-high, -low],
                    "p_value": self.growth.p_value, "records": self.growth.count}
        return {
            "name": self.name, "unit": self.unit, "now": self.now,
            "way": ("falls", "steady", "rises")[self.way + 1],
            "values": [{"record": int(n), "value": v, "interval": [low, high]}
                       for n, v, low, high in zip(self.number, self.value.tolist(),
                                                  self.lower.tolist(), self.upper.tolist())],
            "steps": [{**s._asdict(), "interval": list(s.interval)} for s in self.steps],
            "growth": rate,
            "limit": None if self.limit is None else {
                "value": self.limit.limit, "passed": self.limit.passed,
                "record": self.limit.record,
                "interval": None if self.limit.interval is None else list(self.limit.interval)},
        }


def value_trend(
    name: str, unit: str, values: Mapping[int, tuple[float, float, float]], limit: float | None
) -> ValueTrend:
    """Return the trend of one value.

    Parameters
    ----------
    name, unit : of the value.
    values : by number of the record: value and the ends of its 90 % interval; one at least.
    limit : that the value should not pass, whichever side of it the first records lie; or None.
    """
    number = np.array(sorted(values), dtype=np.int64)
    value, lower, upper = np.array([values[int(n)] for n in number], dtype=float).T
    steps = tuple(_steps(number, value, 0.5 * (upper - lower)))
    own = _since(number, steps)
    rise, way = _growth(number[own], value[own], lower[own], upper[own])
    found = ValueTrend(name=name, unit=unit, number=number, value=value, lower=lower, upper=upper,
                       steps=steps, growth=rise, way=way)
    return found if limit is None else replace(found, limit=_passage(found, limit))


def _since(number: np.ndarray, steps: tuple[StepChange, ...]) -> np.ndarray:
    """Return which records follow the last step."""
    return np.asarray(number >= (steps[-1].record if steps else number[0]))


def _growth(
    number: np.ndarray, value: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[Growth | None, int]:
    """Return the growth of a value or of its negative, and which."""
    up = growth(number, value, lower, upper, LEVEL)
    down = growth(number, -value, -upper, -lower, LEVEL)
    if up is None or down is None:
        return None, 0
    if down.growing:
        return down, -1
    return up, int(up.growing)


def _passage(found: ValueTrend, limit: float) -> Passage:
    """Return when a limit is passed: by the value now, or by both last records for sure."""
    side = 1.0 if limit >= float(np.median(found.value[:SIDE])) else -1.0
    inner = found.lower if side > 0.0 else found.upper
    if side * (found.now - limit) >= 0.0 or (
            len(inner) > LAST and (side * (inner[-LAST:] - limit) >= 0.0).all()):
        return Passage(limit, passed=True, record=None, interval=None)
    rise = found.growth
    if rise is None or found.way != side:
        return Passage(limit, passed=False, record=None, interval=None)
    ahead = _coming(found, rise, limit)
    record, interval = (None, None) if ahead is None else ahead.after(int(found.number[-1]))
    return Passage(limit, passed=False, record=record, interval=interval)


def _coming(found: ValueTrend, rise: Growth, limit: float) -> Forecast | None:
    """Return how many records after the last one a limit is reached.

    Values are counted upwards and above 0, as severities are.
    """
    own = _since(found.number, found.steps)
    ends = (found.lower[own], found.upper[own])[::found.way]
    above = 2.0 * max(abs(limit), float(np.abs(found.value[own]).max()))
    value, lower, upper = (above + found.way * v for v in (found.value[own], *ends))
    seen = outlook(found.number[own], value, lower, upper,
                   replace(rise, severity=above + rise.severity))
    return None if seen is None else forecast(seen, above + found.way * limit)


def _steps(number: np.ndarray, value: np.ndarray, half: np.ndarray) -> list[StepChange]:
    """Return the steps of a value, by halving at the clearest one."""
    from scipy import stats

    count = len(value)
    places = np.arange(SIDE, count - SIDE + 1)
    if not len(places):
        return []
    scores = [_t(value, k) for k in places.tolist()]
    at = int(np.argmax([abs(score) for score, _ in scores]))
    place, (score, error) = int(places[at]), scores[at]
    before, after = float(value[:place].mean()), float(value[place:].mean())
    p_value = min(1.0, len(places) * 2.0 * float(stats.t.sf(abs(score), count - 2)))
    line = np.polyfit(number, value, 1)
    about_line = float(np.sum((value - np.polyval(line, number)) ** 2))
    about_step = float(np.sum((value[:place] - before) ** 2)
                       + np.sum((value[place:] - after) ** 2))
    clear = abs(after - before) > float(np.median(half)) / QUANTILE
    if p_value > LEVEL or about_step > OVER_LINE * about_line or not clear:
        return []
    wide = float(stats.t.ppf(0.95, count - 2)) * error
    step = StepChange(int(number[place]), before, after,
                      (after - before - wide, after - before + wide), p_value)
    return [*_steps(number[:place], value[:place], half[:place]), step,
            *_steps(number[place:], value[place:], half[place:])]


def _t(value: np.ndarray, place: int) -> tuple[float, float]:
    """Return the t statistic of a step, and the standard error of its size."""
    first, second = value[:place], value[place:]
    squares = float(np.sum((first - first.mean()) ** 2) + np.sum((second - second.mean()) ** 2))
    error = math.sqrt(squares / (len(value) - 2) * (1.0 / len(first) + 1.0 / len(second)))
    change = float(second.mean() - first.mean())
    return change / max(error, 1e-12 * abs(change), 1e-300), error
