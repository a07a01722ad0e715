"""The comparison: ours, a plain perceptron on the same features, the paper's literal scheme.

The paper's two networks know neither a healthy actuator nor friction, backlash or "unknown".
The perceptron is scikit-learn's with its defaults: it has no guard, no calibrated threshold and
no interval.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.detection.fleet import Case, draw, record_of
from benchmarks.detection.generate import COUNTS, Tested
from benchmarks.detection.judge import CLASS, Judged, View
from benchmarks.detection.table import plain
from ema_prognostics.cascade.classes import CLASS_OF, OUTPUTS, SHORTS
from ema_prognostics.cascade.model_file import TrainedModel
from ema_prognostics.features.vector import differences
from ema_prognostics.training.fleet import FleetFeatures
from ema_prognostics.training.rates import ORIGIN, detection_curve, rate
from ema_prognostics.verdict.diagnose import diagnose
from ema_prognostics.verdict.report import verdict_of_error
from ema_record.actuator import Actuator
from ema_record.errors import RecordError

HIDDEN = (64,)
ITERATIONS = 300
PAPER_UNITS = 60
"""Records a group that the paper's scheme judges; each is simulated again."""
UNNAMED = ("healthy", "unknown", "invalid", "incomplete")


class Called(NamedTuple):
    """What a scheme says of one record."""

    outcome: str
    """healthy, unknown, incomplete, invalid, or the classes named, sorted, joined by ``+``."""
    phase: str | None = None
    """Of a short, where one is named."""
    severity: float | None = None
    """Of the class named first."""


def paper_columns(
    cases: Sequence[tuple[Actuator, Case]], model: TrainedModel, *, jobs: int = 1
) -> list[Called]:
    """Return what the paper's literal scheme says of each case; each is simulated again.

    Parameters
    ----------
    cases : unit and test, as `fleet.draw` gives them.
    jobs : processes.
    """
    from joblib import Parallel, delayed

    parts = [cases[k:k + 8] for k in range(0, len(cases), 8)]
    found = Parallel(n_jobs=jobs)(delayed(_paper_part)(part, model) for part in parts)
    return [called for part in found for called in part]


def _paper_part(cases: Sequence[tuple[Actuator, Case]], model: TrainedModel) -> list[Called]:
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1):
        return [_paper_call(actuator, case, model) for actuator, case in cases]


def _paper_call(actuator: Actuator, case: Case, model: TrainedModel) -> Called:
    try:
        verdict = diagnose(record_of(actuator, case), model, mode="paper")
    except RecordError as error:
        verdict = verdict_of_error(error, "")
    if verdict.outcome != "fault":
        return Called(verdict.outcome)
    names = sorted({f.fault_class for f in verdict.faults})
    return Called("+".join(names), verdict.faults[0].phase, verdict.faults[0].severity)


class Perceptron:
    """Plain perceptrons of scikit-learn: one that says which outputs, one each for how much."""

    def __init__(self, train: FleetFeatures, view: View = "fleet", *, seed: int = 1) -> None:
        """Fit on a training campaign, standardised features, default settings."""
        from sklearn.neural_network import MLPClassifier, MLPRegressor
        from sklearn.preprocessing import StandardScaler

        self.names, self.view = list(train.names), view
        x = self._inputs(train.record, train.baseline)
        self._scaler = StandardScaler().fit(x)
        x = self._scaler.transform(x)
        present = train.severity > 0.0
        plain: dict[str, Any] = {"hidden_layer_sizes": HIDDEN, "max_iter": ITERATIONS,
                                 "random_state": seed}
        self._which = _fit(MLPClassifier(**plain), x, present.astype(int))
        self._severity: dict[str, Any] = {}
        for k, output in enumerate(OUTPUTS):
            rows = present[:, k]
            if np.count_nonzero(rows) >= 20:
                self._severity[output] = _fit(
                    MLPRegressor(**plain), x[rows], np.log(train.severity[rows, k]))

    def _inputs(self, record: np.ndarray, baseline: np.ndarray) -> np.ndarray:
        return record if self.view == "fleet" else differences(record, baseline)

    def call(self, record: np.ndarray, baseline: np.ndarray) -> list[Called]:
        """Return what the perceptrons say of records, features of shape (n, d) each."""
        x = self._scaler.transform(self._inputs(record, baseline))
        probability = self._which.predict_proba(x)
        return [self._call(row, p) for row, p in zip(x, probability)]

    def _call(self, x: np.ndarray, probability: np.ndarray) -> Called:
        outputs = [OUTPUTS[k] for k in np.argsort(-probability) if probability[k] > 0.5]
        if not outputs:
            return Called("healthy")
        phase = next((o[-1] for o in outputs if o in SHORTS), None)
        network = self._severity.get(outputs[0])
        severity = None if network is None else float(np.exp(network.predict(x[None])[0]))
        return Called("+".join(sorted({CLASS_OF[o] for o in outputs})), phase, severity)


def _fit(estimator: Any, x: np.ndarray, y: np.ndarray) -> Any:
    from sklearn.exceptions import ConvergenceWarning
    from threadpoolctl import threadpool_limits

    with warnings.catch_warnings(), threadpool_limits(limits=1):
        warnings.simplefilter("ignore", ConvergenceWarning)
        return estimator.fit(x, y)


def mlp_columns(
    train: FleetFeatures, held_out: Sequence[Tested], view: View = "fleet"
) -> list[Called]:
    """Return what plain perceptrons, trained on `train`, say of each held-out test.

    Parameters
    ----------
    train : the training campaign of the shipped model.
    held_out : the benchmark's fleet; a test without features is called ``invalid``.
    view : with or without the unit's baseline.
    """
    perceptron = Perceptron(train, view, seed=1)
    called = [Called("invalid")] * len(held_out)
    rows = [k for k, t in enumerate(held_out) if t.later is not None and t.base is not None]
    if not rows:
        return called
    record, base = (
        np.array([[values[n] for n in perceptron.names] for values in tests])
        for tests in ([held_out[k].later or {} for k in rows],
                      [held_out[k].base or {} for k in rows])
    )
    for k, found in zip(rows, perceptron.call(record, base)):
        called[k] = found
    return called


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
        curve = None if not mine else detection_curve(
            np.array([x for x, _ in mine]), np.array(found, dtype=bool), ORIGIN.get(group, 0.0))
        faults[group] = None if curve is None else curve.a90_95
    return {"false alarms": plain(rate(healthy)), "strangers wrong": plain(rate(strangers)),
            "right class": plain(rate(right)), "a90_95": faults}


def _ours(judged: Sequence[Judged]) -> list[Called]:
    return [Called(j.outcome) for j in judged]


def comparison(
    campaign: FleetFeatures, fleet: Sequence[Tested], judged: Mapping[View, Sequence[Judged]],
    visible: Mapping[str, float], model: TrainedModel, *, jobs: int,
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
