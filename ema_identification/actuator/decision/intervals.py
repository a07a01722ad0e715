"""Intervals of what was named, by draws of its coordinates from their covariance."""

from __future__ import annotations

import numpy as np

from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.laws.terms import LawFit
from ema_identification.result import Parameter
from ema_sim.effects import EFFECTS
from ema_sim.effects.base import Quantity

QUANTILE = 1.645
"""Of the normal distribution, for an interval of 90 %."""
DRAWS = 400


SLOPE_ERROR = 0.2
"""Relative error of a slope, which feigns information: two columns that differ by less are one."""


def posterior_of(unit: TestedUnit, fit: LawFit) -> tuple[np.ndarray, np.ndarray]:
    """Return how far the mean is from the fit, and the covariance, of laws and unit's numbers.

    On the scale of the fit, the error of simulated laws included. What errors of the slopes feign
    is taken off the information and off the pull that goes with it (errors in variables: Fuller,
    Measurement Error Models, 1987, section 2.2), so that a law that acts on the same number as a
    tolerance is as uncertain as that, about where the tolerance is expected.
    """
    white = unit.whitener(fit.runs, unit.without_law().mean if fit.terms else None)
    rest = unit.values - fit.mean
    columns = white.columns(fit.slopes, rest)
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-9)
    values, vectors = np.linalg.eigh((columns / scale).T @ (columns / scale))
    share = np.maximum(1.0 - SLOPE_ERROR**2 / np.maximum(values, 1e-12), 0.0)
    known = (vectors * share * values) @ vectors.T * np.outer(scale, scale)
    pull = vectors @ (share * (vectors.T @ (columns.T @ white.residual(rest) / scale))) * scale
    weight = np.append(np.full(fit.free, 1e-6 * scale[:fit.free] ** 2), unit.weight)
    pull[fit.free:] -= unit.weight * (fit.z - unit.centre)
    covariance = np.linalg.inv(known + np.diag(weight))
    return covariance @ pull, covariance


def parameters_of(unit: TestedUnit, fit: LawFit, index: int) -> tuple[Parameter, ...]:
    """Return the parameters of a law with intervals of 90 %, by draws of its coordinates."""
    begin = sum(t.variant.size for t in fit.terms[:index])
    term = fit.terms[index]
    part = slice(begin, begin + term.variant.size)
    shift, covariance = posterior_of(unit, fit)
    draws = np.random.default_rng(0).multivariate_normal(
        term.u + shift[part], covariance[part, part], size=DRAWS)
    draws = np.clip(draws, term.variant.low, term.variant.high)
    kinds = {f.name: f.kind for f in EFFECTS[term.variant.effect].fields}
    found = []
    for name, value in term.variant.settings(term.u).items():
        kind, middle = kinds[name], float(value)
        if not isinstance(kind, Quantity):
            continue
        values = np.array([float(term.variant.settings(u)[name]) for u in draws])
        if kind.unit == "rad" and name in ("phase", "angle"):
            values = middle + np.angle(np.exp(1j * (values - middle)))
        low, high = (float(x) for x in np.quantile(values, (0.05, 0.95)))
        found.append(Parameter(name=f"{term.variant.effect}.{name}", value=middle,
                               low=min(low, middle), high=max(high, middle), unit=kind.unit))
    return tuple(found)
