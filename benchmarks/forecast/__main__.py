"""The forecast of `ema trend` beside others, by the metric functions of progpy.

Severities grow by a known law to the level *large* and are seen with the errors of the verdicts
(`courses`). At several parts of the life each forecaster (`peers`) says when the level is
reached. The level is that of the true severity.

    pip install progpy==1.9.0
    python -m benchmarks.forecast --courses 60 --seed 20261124 --parts 0.5

A forecast is a whole flight: what falls between two is the later one, for all forecasters.
Columns: forecasts made; coverage of their 90 % intervals, of the flights as they are printed;
width of the intervals and forecast flight, median, in parts of the flights that were left; at
half life: alpha-lambda (half of the forecast within 20 % of what is left), the same of the
median alone, and relative accuracy of the median; prognostic horizon in parts of the life (from
the first of the asked parts at which half of the forecast lies within 20 %). No forecast counts
as not met. Below the last table: on how many courses alpha-lambda and near were met by `ema trend`
alone and by the other alone, with the two-sided sign test.

Judged so far: seeds 20261123 and, with two ways of speeding up, 20261124 (as above, declared).
"""

from __future__ import annotations

import argparse
import importlib.util
import json
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.detection.report import make_table
from benchmarks.forecast.courses import LAWS, Course, draw_course
from benchmarks.forecast.peers import FORECASTERS, Forecaster, Seen
from ema_cli.console import progress
from ema_prognostics.training.rates import Rate, rate
from ema_prognostics.trend.announcement import falls
from ema_record.files import new_file

PARTS = (0.2, 0.35, 0.5, 0.65, 0.8)
"""Of the life, at which a forecast is asked for unless others are given."""
HALF = 0.5
ALPHA, BETA = 0.2, 0.5
EVENT = "passed"
TAILS = (0.05, 0.5, 0.95)


@dataclass(slots=True, kw_only=True)
class Score:
    """What one forecaster gave on the courses of one law."""

    asked: int = 0
    covered: list[bool] = field(default_factory=list)
    covered_half: list[bool] = field(default_factory=list)
    width: list[float] = field(default_factory=list)
    late: list[float] = field(default_factory=list)
    late_half: list[float] = field(default_factory=list)
    alpha_lambda: list[bool] = field(default_factory=list)
    near: list[bool] = field(default_factory=list)
    accuracy: list[float] = field(default_factory=list)
    horizon: list[float] = field(default_factory=list)

    def add(self, other: Score) -> None:
        """Add what another law gave."""
        for name in self.__dataclass_fields__:
            setattr(self, name, getattr(self, name) + getattr(other, name))

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers of the table."""
        def middle(values: list[float]) -> float | None:
            return float(np.median(values)) if values else None

        return {
            "asked": self.asked, "made": len(self.covered),
            "coverage": rate(self.covered)._asdict(),
            "coverage at half life": rate(self.covered_half)._asdict(),
            "width": middle(self.width), "forecast": middle(self.late),
            "forecast at half life": middle(self.late_half),
            "alpha-lambda": rate(self.alpha_lambda)._asdict(),
            "median within 20 %": rate(self.near)._asdict(),
            "relative accuracy": middle(self.accuracy), "horizon": middle(self.horizon),
        }


def seen_of(course: Course, flights: int) -> Seen:
    """Return what is known after `flights` flights, from the last fall on as in the trend."""
    history = course.history(flights)
    used = history.number >= max([*falls(history), 1])
    return Seen(history.number[used], history.severity[used], history.lower[used],
                history.upper[used], course.level)


def measure(
    course: Course, forecaster: Forecaster, seed: int, parts: Sequence[float] = PARTS
) -> Score:
    """Return the score of one forecaster on one course."""
    from progpy.predictors import ToEPredictionProfile
    from progpy.uncertain_data import UnweightedSamples

    rng = np.random.default_rng([seed, course.passed, len(course.severity)])
    score, profile = Score(), ToEPredictionProfile()
    life = course.passed - course.first
    for part in parts:
        now = course.first + round(part * life)
        left = course.passed - now
        score.asked += 1
        flights = forecaster(seen_of(course, now + 1), rng)
        flights = None if flights is None else np.ceil(flights)
        if flights is None:
            if part == HALF:
                score.near.append(False)
                score.alpha_lambda.append(False)
            continue
        toe = UnweightedSamples([{EVENT: now + t} for t in flights])
        profile.add_prediction(now, toe)
        low, median, high = np.quantile(flights, TAILS, method="inverted_cdf")
        inside = bool(low <= left <= high)
        score.covered.append(inside)
        score.width.append((high - low) / left)
        score.late.append(median / left)
        if part == HALF:
            score.covered_half.append(inside)
            score.late_half.append(median / left)
            score.near.append(bool(abs(median - left) <= ALPHA * left))
            score.alpha_lambda.append(bool(profile.alpha_lambda(
                {EVENT: course.passed}, now, ALPHA, BETA)[EVENT]))
            score.accuracy.append(float(UnweightedSamples([{EVENT: median}]).relative_accuracy(
                {EVENT: left})[EVENT]))
    found = profile.prognostic_horizon(_near_enough, {EVENT: course.passed})[EVENT]
    score.horizon.append(0.0 if found is None else float(found) / life)
    return score


def _near_enough(left: Any, truth: dict[str, float]) -> dict[str, bool]:
    bounds = {EVENT: ((1.0 - ALPHA) * truth[EVENT], (1.0 + ALPHA) * truth[EVENT])}
    return {EVENT: bool(left.percentage_in_bounds(bounds)[EVENT] >= BETA)}


def measure_all(
    courses: int, seed: int, laws: Iterable[str] = tuple(LAWS), parts: Sequence[float] = PARTS
) -> dict[str, dict[str, Score]]:
    """Return the scores by law, and of all laws together, and by forecaster."""
    scores: dict[str, dict[str, Score]] = defaultdict(lambda: defaultdict(Score))
    laws = list(laws)
    with progress("forecasts", len(laws) * courses) as step:
        for done, (law, number) in enumerate((w, k) for w in laws for k in range(courses)):
            course = draw_course(law, number, seed)
            for name, forecaster in FORECASTERS.items():
                found = measure(course, forecaster, seed, parts)
                scores[law][name].add(found)
                scores["all"][name].add(found)
            step(done + 1)
    return {law: dict(by_name) for law, by_name in scores.items()}


def _percent(found: Rate) -> str:
    return f"{100 * found.value:.0f} ({100 * found.lower:.0f}-{100 * found.upper:.0f})"


def print_scores(law: str, scores: dict[str, Score], console: Console) -> None:
    """Print the table of one law."""
    table = make_table(
        law, "forecaster", "made", "coverage, %", "at half life, %", "width", "forecast",
        "alpha-lambda, %", "median near, %", "accuracy", "horizon")
    for name, score in scores.items():
        found = score.to_dict()
        numbers = ["-" if found[key] is None else f"{found[key]:.2f}" for key in
                   ("width", "forecast", "relative accuracy", "horizon")]
        table.add_row(
            name, f"{found['made']}/{found['asked']}",
            f"{100 * rate(score.covered).value:.0f}", _percent(rate(score.covered_half)),
            *numbers[:2], _percent(rate(score.alpha_lambda)), _percent(rate(score.near)),
            *numbers[2:])
    console.print(table)


def paired(ours: list[bool], theirs: list[bool]) -> tuple[int, int, float]:
    """Return how many ours alone and theirs alone meet, and the p-value of the sign test."""
    from scipy.stats import binomtest

    only, others = (sum(a and not b for a, b in zip(x, y))
                    for x, y in ((ours, theirs), (theirs, ours)))
    return only, others, float(binomtest(only, max(1, only + others)).pvalue)


def print_pairs(scores: dict[str, Score], console: Console) -> None:
    """Print what `ema trend` and each other forecaster alone meet."""
    ours, *others = scores
    for name in others:
        for what in ("alpha_lambda", "near"):
            a, b, p = paired(getattr(scores[ours], what), getattr(scores[name], what))
            console.print(f"{what}: {ours} alone {a}, {name} alone {b}, p = {p:.2g}")


def main() -> None:
    """Draw the courses, forecast, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--courses", type=int, default=20, help="of each law")
    parser.add_argument("--seed", type=int, default=20_261_125)
    parser.add_argument("--parts", type=float, nargs="+", default=PARTS, help="of the life")
    parser.add_argument("--out", type=Path, help="JSON file with all numbers")
    options = parser.parse_args()
    if options.courses < 1:
        parser.error(f"--courses {options.courses}: give at least 1")
    if importlib.util.find_spec("progpy") is None:
        parser.error("progpy is not installed: pip install progpy==1.9.0")
    scores = measure_all(options.courses, options.seed, parts=options.parts)
    console = Console(width=150)
    for law, by_name in scores.items():
        print_scores(law, by_name, console)
    print_pairs(scores["all"], console)
    if options.out is not None:
        with new_file(options.out) as temporary:
            temporary.write_text(json.dumps({
                "seed": options.seed, "courses": options.courses,
                "scores": {law: {n: s.to_dict() for n, s in by_name.items()}
                           for law, by_name in scores.items()},
            }, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
