"""Parameters with their intervals, the residual's correlation within blocks counted."""

from __future__ import annotations

import math

import numpy as np

from ema_identification.result import Parameter
from ema_identification.rig.fit.balance import InputBalance
from ema_identification.rig.fit.regression import Blocks, covariance, half_width
from ema_identification.rig.laws.base import Term, physical, unit_of

SYSTEMATIC = 0.002
"""Least standard error, relative: how a record was sampled, held and filtered is not known better,
and no transducer is."""
STEP = 1e-3
"""Relative step of the derivative with respect to a shape ..."""
LEAST_STEADY = 0.3
"""Share of the rows away from reversals that is needed to judge without the others."""
SEEN = 0.3
"""Likewise the rms of a regressor there, over that of all rows."""
COARSE_STEP = 0.1
"""... and of one that the motion crosses in single samples: a gap, a distance."""


def without_modifiers(balance: InputBalance, index: int) -> tuple[InputBalance, int]:
    """Return the balance less the terms that only modify the one at `index`, and its index.

    A Stribeck term changes what ``coulomb_friction.level`` means: the level alone is that
    which fits best over the motion that was recorded.
    """
    name = balance.terms[index].law.name
    for other in reversed(range(len(balance.terms))):
        if name in balance.terms[other].law.requires:
            balance = balance.without(other)
            index -= other < index
    return balance, index


def parameters(balance: InputBalance, index: int, blocks: Blocks) -> tuple[Parameter, ...]:
    """Return the parameters of one term with intervals of `INTERVAL_LEVEL`.

    Parameters
    ----------
    balance : the fitted model.
    index : which term.
    blocks : what is correlated.
    """
    term, span = balance.terms[index], balance.span(index)
    fixed = balance.fixed
    values = balance.fit.coefficients[span]
    columns, slopes = balance.free_columns, _slopes(balance, index)
    place = np.cumsum(~fixed) - 1
    own = [int(place[k]) for k in range(span.start, span.stop) if not fixed[k]]
    columns_and_slopes = np.column_stack([columns, *slopes])
    variance = covariance(columns_and_slopes, balance.fit.residual, blocks) \
        + _of_reversals(balance, columns_and_slopes)
    found: list[Parameter] = []

    def add(name: str, value: float, wide: float) -> None:
        found.append(Parameter(
            name=f"{term.law.name}.{name}", value=value, low=value - wide, high=value + wide,
            unit=unit_of(term.law.units[name], balance.design.trajectory.axis)))

    if term.law.periodic:
        for name, value, wide in _wave(term, values, variance, own, blocks):
            add(name, value, wide)
    else:  # a part of a delay is a shift of the input
        shift = balance.design.lead if term.law.name == "control_delay" else 0.0
        for k, name in enumerate(term.law.coefficients):
            wide = half_width(variance[own[k], own[k]] + (SYSTEMATIC * float(values[k])) ** 2,
                              blocks) if len(own) == len(values) else 0.0
            add(name, float(values[k]) + shift, wide)
    for k, name in enumerate(term.law.shape):
        wide = 0.0
        if slopes:
            at = columns.shape[1] + k
            least = 0.0 if term.law.periodic else SYSTEMATIC * term.shape[k]  # a clock is exact
            wide = half_width(variance[at, at] + least**2, blocks)
            if term.law.against == "test phase":  # a gap is not negative
                wide = min(wide, abs(term.shape[k]))
        add(name, term.shape[k], wide)
    return tuple(found)


def _of_reversals(balance: InputBalance, columns: np.ndarray) -> np.ndarray:
    """Return the variance that stands for what happens at reversals, shape (p, p).

    There the sign of the speed is known least and dry friction is least like a law. By so much
    as the estimates change without these rows, as one standard error.
    """
    trajectory = balance.design.trajectory
    steady = trajectory.steady
    away = columns[steady]
    if steady.all() or steady.sum() < max(LEAST_STEADY * len(steady), 10 * columns.shape[1]):
        return np.zeros((columns.shape[1], columns.shape[1]))
    scale = np.sqrt(np.maximum(np.mean(columns**2, axis=0), 1e-300))
    kept = np.sqrt(np.mean(away**2, axis=0)) > SEEN * scale
    change = np.zeros(columns.shape[1])
    found, *_ = np.linalg.lstsq(away[:, kept] / scale[kept], balance.fit.residual[steady],
                                rcond=1e-6)
    change[kept] = found / scale[kept]
    return np.outer(change, change)


def _slopes(balance: InputBalance, index: int) -> list[np.ndarray]:
    """Return the regressors that small changes of the shape stand for."""
    term, span = balance.terms[index], balance.span(index)
    whole = term.law.periodic and not term.law.looked_for \
        and balance.design.trajectory.axis.motion == "rotary" \
        and term.shape[0] == round(term.shape[0])
    if whole or term.law.name == "position_dependent_friction":
        return []
    trajectory = balance.design.trajectory
    slopes = []
    for k, value in enumerate(term.shape):
        fine = term.law.against in ("speed", "frequency")
        step = (STEP if fine else COARSE_STEP) * (abs(value) or 1.0)
        if term.law.looked_for:
            step = 0.02 / max(float(np.ptp(trajectory.time)), 1e-9)
        elif term.law.periodic:
            step = 0.02 / max(trajectory.turns, 1e-9)
        high, low = (balance.design.columns(
            Term(law=term.law, shape=(*term.shape[:k], value + way, *term.shape[k + 1:])),
            trajectory) for way in (step, -step))
        slopes.append((high - low) @ balance.fit.coefficients[span] / (2.0 * step))
    return slopes


def _wave(
    term: Term, values: np.ndarray, variance: np.ndarray, own: list[int], blocks: Blocks
) -> list[tuple[str, float, float]]:
    """Return amplitude and phase of a wave, with half the interval of each."""
    named = physical(term.law, term.shape, values)
    size, phase = named["amplitude"], named["phase"]
    if len(own) == 2 and size > 0.0:
        direction = values / size
        across = np.array([-direction[1], direction[0]]) / size
        block = variance[np.ix_(own, own)]
        wide = half_width(
            float(direction @ block @ direction) + (SYSTEMATIC * size) ** 2, blocks)
        angle = min(half_width(float(across @ block @ across), blocks), math.pi)
    else:
        wide = angle = 0.0
    return [("amplitude", size, wide), ("phase", phase, angle)]
