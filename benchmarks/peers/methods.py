"""Three peers: what each names of regression problems, and how its limit is found.

Each gives a score to every region of a problem, large where something is there. What it may name
lies beyond the limits of `limits`, which all healthy units keep. A term is a law, with its cosine
and its sine where it has two.
"""

from __future__ import annotations

import importlib.util
import logging
import re
import warnings
from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import f as fisher

from benchmarks.peers.ports import Problem, recalibrated

Scores = dict[str, float]
"""By region: the port, for LISDD the regime too."""
RIDGE, ROUNDS = 1e-4, 20
"""Of STLSQ."""
TRIED = np.geomspace(0.01, 10.0, 28)
"""Thresholds, in rms of the response."""
ROWS = 300
"""That ADCD is given, evenly from all: it compiles and fits each candidate."""
RATE = 0.05
"""False discovery rate of LISDD."""
BLOCKS = 16
"""Of a problem's rows in time; LISDD fits on two of eight, holds out two, tests on four."""


class Method(NamedTuple):
    """One peer."""

    package: str
    """That it needs, empty: none."""
    scores: Callable[[Problem], Scores]
    answer: Callable[[Sequence[Problem], Scores], tuple[list[str], bool]]
    """Names of columns beyond the limits; whether it says that something else is there."""

    @property
    def absent(self) -> bool:
        """Whether its package is not installed."""
        return bool(self.package) and importlib.util.find_spec(self.package) is None


def limits(healthy: Sequence[Scores]) -> Scores:
    """Return the largest score of each region: of the next unit, one in n + 1 goes beyond."""
    return {key: max(s[key] for s in healthy if key in s)
            for key in sorted(set().union(*healthy))}


def terms(problem: Problem) -> list[list[int]]:
    """Return the columns of each term."""
    def stem(place: int) -> str:
        return "|".join(name.removesuffix("_cos").removesuffix("_sin").removesuffix(".cos")
                        .removesuffix(".sin") for name in problem.names[place].split("|"))

    return [list(places) for _, places in
            groupby(sorted(range(len(problem.names)), key=stem), key=stem)]


def fitted(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return coefficients by least squares."""
    return np.asarray(np.linalg.lstsq(columns, target, rcond=None)[0])


def left(columns: np.ndarray, target: np.ndarray) -> float:
    """Return the sum of squares that least squares leaves."""
    return float(np.sum((target - columns @ fitted(columns, target)) ** 2))


def kept_by_stlsq(problem: Problem, threshold: float) -> np.ndarray:
    """Return which columns pysindy's STLSQ keeps; `threshold` in the unit of the response.

    S. L. Brunton, J. L. Proctor, J. N. Kutz, PNAS 113(15), 2016. Rows are replaced by those of
    the triangular factor: the same normal equations.
    """
    from pysindy import STLSQ

    n, k = problem.columns.shape
    rows = np.linalg.qr(np.column_stack([problem.columns, problem.response]), mode="r")
    model = STLSQ(threshold=threshold, alpha=RIDGE * n, max_iter=ROUNDS)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns where nothing is left
        model.fit(rows[:, :k], rows[:, k:])
    return np.asarray(model.coef_).ravel() != 0.0


def stlsq_scores(problem: Problem) -> Scores:
    """Return the lowest threshold of `TRIED` at which nothing is kept, by bisection."""
    size = float(np.sqrt(np.mean(problem.response**2)))
    low, high = 0, len(TRIED) - 1
    while low < high:
        middle = (low + high) // 2
        if kept_by_stlsq(problem, TRIED[middle] * size).any():
            low = middle + 1
        else:
            high = middle
    return {problem.port: float(TRIED[low]) * size}


def stlsq_answer(problems: Sequence[Problem], limit: Scores) -> tuple[list[str], bool]:
    """Return what STLSQ keeps; it never says that something else is there."""
    return [problem.names[k] for problem in problems
            for k in np.flatnonzero(kept_by_stlsq(problem, limit[problem.port]))], False


def adcd_scores(problem: Problem) -> Scores:
    """Return what its criterion grows with, -ln(NMSE), of the best term: ADCD has no null.

    Nothing to explain, as of a supply that stands still, is no anomaly.
    """
    power = float(np.sum(problem.response**2))
    if power == 0.0:
        return {problem.port: 0.0}
    best = min(left(problem.columns[:, term], problem.response) for term in terms(problem))
    return {problem.port: float(-np.log(best / power)) + 1e-3}


def adcd_answer(problems: Sequence[Problem], limit: Scores) -> tuple[list[str], bool]:
    """Return the columns of ADCD's best correction of each anomalous port.

    M. A. Erdita, ADCD 3.0, 2026. A port is anomalous beyond its limit. Its proposers make
    powers and exponentials of one variable; here a proposer in their place offers the terms, so
    that its gates, its fit and its BIC choose.
    """
    from adcd.api import CustomAnomalyScenario
    from adcd.arc_scorer import ARCScorer, build_arc_regimes
    from adcd.correction_orchestrator import CorrectionOrchestrator
    from adcd.dimensional_checker import ASTValidator, DimensionalChecker
    from adcd.jax_optimizer import JAXOptimizer
    from adcd.llm_proposer import BaseProposer
    from adcd.pipeline import Stage1Pipeline

    class Offered(BaseProposer):  # type: ignore[misc]
        """All columns alone, then whole terms and pairs of the best; signs as they correlate."""

        def __init__(self, whole: list[list[int]]) -> None:
            self.whole = {place: term for term in whole for place in term}

        def propose(self, context: Any) -> list[str]:
            """Return expressions; all vanish with the motion `s`, as its asymptotic gate asks."""
            def text(term: Sequence[int]) -> str:
                columns = np.column_stack([context.X_data[f"x{k}"] for k in term])
                sizes = fitted(columns, context.residual_data)
                return "s*(" + "".join(f"{'-' if c < 0 else '+'}theta_{n}*x{k}" for n, (c, k) in
                                       enumerate(zip(sizes, term))) + ")"

            if not context.previous_best:
                return [text([k]) for k in self.whole]
            best = [k for k in (columns_in(expr) for expr, _ in context.previous_best)
                    if len(k) == 1]
            top = self.whole[best[0][0]]
            tried = [self.whole[k[0]] for k in best] + [
                [*top, *self.whole[k[0]]] for k in best[1:5] if k[0] not in top]
            return list(dict.fromkeys(text(sorted(term)) for term in tried if len(term) > 1))

    logging.disable(logging.WARNING)
    named, other = [], False
    for problem in problems:
        if adcd_scores(problem)[problem.port] <= limit[problem.port]:
            continue
        rows = np.linspace(0, len(problem.response) - 1, ROWS).astype(int)
        target = problem.response[rows] / np.sqrt(np.mean(problem.response[rows] ** 2))
        x = {f"x{k}": problem.columns[rows, k] for k in range(len(problem.names))}
        scenario = CustomAnomalyScenario(
            {**x, "s": np.full(len(rows), 2.0)}, target, np.zeros(len(rows)), "0", "additive",
            "s", "0")
        search = CorrectionOrchestrator(
            Offered(terms(problem)), Stage1Pipeline(
                ASTValidator(max_tokens=60), DimensionalChecker(),
                ARCScorer(build_arc_regimes("s", "0"))),
            JAXOptimizer(), max_iterations=2, verbose=False)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it looks for trends over `s`
            found = search.search_correction(scenario)
        if -np.log(found.best_nmse_residual * np.var(target)) > limit[problem.port]:
            named += [problem.names[k] for k in columns_in(found.best_expr)]
        else:
            other = True
    return named, other


def columns_in(expression: str) -> list[int]:
    """Return the numbers of the columns that an expression of ADCD holds."""
    return sorted({int(k) for k in re.findall(r"\bx(\d+)\b", expression)})


def _localised(problem: Problem) -> tuple[np.ndarray, Scores]:
    """Return the residual after the fit on the clean half of the regimes, and their energies.

    Energies are in noise, half the mean square of successive differences (von Neumann, 1941).
    """
    present = [c for c in np.unique(problem.regime) if np.sum(problem.regime == c) > BLOCKS]

    def energies(residual: np.ndarray) -> dict[int, float]:
        noise = 0.5 * np.mean(np.diff(residual) ** 2) + 1e-30
        return {c: float(np.mean(residual[problem.regime == c] ** 2) / noise) for c in present}

    first = energies(problem.response)
    clean = sorted(first, key=lambda c: first[c])[:max(1, len(first) // 2)]
    residual = recalibrated(problem.raw, problem.base, np.isin(problem.regime, clean))
    return residual, {f"{problem.port}/{c}": e for c, e in energies(residual).items()}


def lisdd_scores(problem: Problem) -> Scores:
    """Return the residual energy of each regime."""
    return _localised(problem)[1]


def lisdd_answer(problems: Sequence[Problem], limit: Scores) -> tuple[list[str], bool]:
    """Return certified terms; a port with a discrepant regime and none is something else.

    After the abstract of Y. Wang, "Where Is My Physics Wrong? Localized and Identifiable
    Discovery of Model Discrepancy", arXiv 2606.23215, 2026, by us: known physics is fitted on a
    clean regime, discrepant regimes are those of too much residual energy, the term is chosen by
    exhaustive holdout, an F test on rows that did not choose certifies it, over all regions by
    the procedure of Benjamini and Hochberg (1995).
    """
    tested: list[tuple[float, list[str]]] = []
    for problem in problems:
        residual, energies = _localised(problem)
        flagged = [int(key.rpartition("/")[2]) for key, e in energies.items()
                   if e > limit.get(key, np.inf)]
        if flagged:
            rows = np.flatnonzero(np.isin(problem.regime, flagged))
            tested.append(_certified(problem, residual, rows))
    order = sorted(range(len(tested)), key=lambda k: tested[k][0])
    passed = max((rank + 1 for rank, k in enumerate(order)
                  if tested[k][0] <= RATE * (rank + 1) / len(tested)), default=0)
    named = [name for k in order[:passed] for name in tested[k][1]]
    return named, passed < len(tested)


def _certified(problem: Problem, residual: np.ndarray, rows: np.ndarray
               ) -> tuple[float, list[str]]:
    """Return the p-value of the term that holdout chooses, and its names."""
    part = np.arange(len(rows)) * BLOCKS // len(rows) % 4
    fit, hold, test = rows[part == 0], rows[part == 2], rows[part % 2 == 1]

    def error(term: list[int]) -> float:
        found = fitted(problem.columns[np.ix_(fit, term)], residual[fit])
        return float(np.sum((residual[hold] - problem.columns[np.ix_(hold, term)] @ found) ** 2))

    term = min(terms(problem), key=error)
    rest = left(problem.columns[np.ix_(test, term)], residual[test])
    free = len(test) - len(term)
    ratio = (float(np.sum(residual[test] ** 2)) - rest) / len(term) / (rest / free + 1e-30)
    return float(fisher.sf(ratio, len(term), free)), [problem.names[k] for k in term]


METHODS = {
    "STLSQ (pysindy)": Method("pysindy", stlsq_scores, stlsq_answer),
    "LISDD, by us": Method("", lisdd_scores, lisdd_answer),
    "ADCD": Method("adcd", adcd_scores, adcd_answer),
}
