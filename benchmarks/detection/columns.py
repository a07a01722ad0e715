"""The comparison: ours, a plain perceptron on the same features, the paper's literal scheme."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.detection.fleet import draw
from benchmarks.detection.generate import COUNTS, Tested
from benchmarks.detection.judge import CLASS, Judged, View
from benchmarks.detection.peers import Called, mlp_columns, paper_columns
from benchmarks.detection.table import plain
from ema_prognostics.cascade.model_file import Model
from ema_prognostics.training.campaign import Campaign
from ema_prognostics.training.rates import ORIGIN, detection, rate

PAPER_UNITS = 60
"""Records a group that the paper's scheme judges; each is simulated again."""
UNNAMED = ("healthy", "unknown", "invalid", "incomplete")


def _column(tests: Sequence[Tested], called: Sequence[Called], visible: Mapping[str, float]
            ) -> dict[str, Any]:
    healthy = [c.outcome not in UNNAMED for t, c in zip(tests, called)
               if t.case.group == "healthy"]
    strangers = [c.outcome not in ("unknown", "invalid", "incomplete")
                 for t, c in zip(tests, called) if t.case.group in ("stranger", "sensor")]
    right, faults = [], {}
    for group, name in CLASS.items():
        mine = [(next(iter(t.case.truth.values())), c) for t, c in zip(tests, called)
                if t.case.group == group]
        found = [c.outcome not in UNNAMED for _, c in mine]
        right += [name in c.outcome.split("+") for (x, c), f in zip(mine, found)
                  if f and x >= visible.get(group, 0.0)]
        curve = detection(np.array([x for x, _ in mine]),
                          np.array(found, dtype=bool), ORIGIN.get(group, 0.0)) if mine else None
        faults[group] = None if curve is None else curve.a90_95
    return {"false alarms": plain(rate(healthy)), "strangers wrong": plain(rate(strangers)),
            "right class": plain(rate(right)), "a90_95": faults}


def _ours(judged: Sequence[Judged]) -> list[Called]:
    return [Called(j.outcome) for j in judged]


def comparison(
    campaign: Campaign, fleet: Sequence[Tested], judged: Mapping[View, Sequence[Judged]],
    visible: Mapping[str, float], model: Model, *, jobs: int,
) -> dict[str, Any]:
    """Return the columns of the comparison; the right class is counted from `visible` on."""
    columns = {"ours, fleet": _column(fleet, _ours(judged["fleet"]), visible),
               "perceptron, fleet": _column(fleet, mlp_columns(campaign, fleet), visible)}
    with_base = [t for t in fleet if t.base is not None]
    columns["ours, baseline"] = _column(with_base, _ours(judged["baseline"]), visible)
    columns["perceptron, baseline"] = _column(
        with_base, mlp_columns(campaign, with_base, "baseline"), visible)
    few = [(g, 100_000 * i + n) for i, (g, count) in enumerate(COUNTS.items())
           for n in range(min(PAPER_UNITS, count))]
    drawn = [draw(g, seed) for g, seed in few]
    called = paper_columns([(actuator, case) for actuator, _, case in drawn], model, jobs=jobs)
    tests = [Tested(case, None, None, "") for _, _, case in drawn]
    columns["paper, literal"] = _column(tests, called, visible)
    return columns
