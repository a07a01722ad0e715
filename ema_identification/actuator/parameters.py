"""Numbers that were estimated, as parameters of the catalogue with their intervals."""

from __future__ import annotations

import numpy as np

from ema_identification.actuator.evidence import Evidence
from ema_identification.actuator.fit import Fit
from ema_identification.actuator.recalibration import Recalibration
from ema_identification.actuator.spread import TOLERANCES
from ema_identification.identification import Parameter
from ema_sim.effects import EFFECTS
from ema_sim.effects.base import Quantity

QUANTILE = 1.645
"""Of the normal distribution, for an interval of 90 %."""
DRAWS = 400
SYSTEMATIC = 0.012
"""Relative error of a coordinate that no noise explains (integration, slopes)."""
WIDER = 1.3
"""On half widths: without it 137 of 162 intervals of units whose answer is known held the truth,
with it 142 (blind panel, units judged before)."""
ABOVE, INCOMPLETE, MOST = 1.2, 0.1, 0.25
"""A fit that leaves more than `ABOVE` times what a complete one does is off by a further
`INCOMPLETE` for each time more, at most `MOST`."""


def covariance_of(fit: Fit, index: int, usual: float) -> np.ndarray:
    """Return the covariance of the coordinates of term `index`, errors of the model included.

    Parameters as of `parameters_of`.
    """
    begin = sum(t.variant.size for t in fit.terms[:index])
    u = fit.terms[index].u
    part = slice(begin, begin + len(u))
    error = SYSTEMATIC + float(np.clip(INCOMPLETE * (fit.cost / usual - ABOVE), 0.0, MOST))
    noise = fit.covariance[part, part] * (fit.inflation * max(1.0, fit.spread))**2
    return np.asarray(noise + np.eye(len(u)) * (error * np.linalg.norm(u))**2)


def parameters_of(fit: Fit, index: int, usual: float) -> tuple[Parameter, ...]:
    """Return the parameters of term `index` of a fit with intervals of 90 %.

    Coordinates are drawn from their covariance and turned into parameters, so that an amplitude
    and a phase get intervals too.

    Parameters
    ----------
    fit : of all effects.
    index : of the effect.
    usual : cost that a complete model leaves.
    """
    term, covariance = fit.terms[index], covariance_of(fit, index, usual)
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(term.u, WIDER**2 * covariance, size=DRAWS)
    draws = np.clip(draws, term.variant.low, term.variant.high)
    centre = term.variant.settings(term.u)
    kinds = {f.name: f.kind for f in EFFECTS[term.variant.effect].fields}
    found = []
    for name, value in centre.items():
        kind = kinds[name]
        if not isinstance(kind, Quantity):
            continue
        values = np.array([float(term.variant.settings(u)[name]) for u in draws])
        if kind.unit == "rad" and name in ("phase", "angle"):
            values = float(value) + np.angle(np.exp(1j * (values - float(value))))
        low, high = np.quantile(values, (0.05, 0.95))
        found.append(Parameter(name=f"{term.variant.effect}.{name}", value=float(value),
                               low=min(float(low), float(value)),
                               high=max(float(high), float(value)), unit=kind.unit))
    return tuple(found)


def recalibrated_of(fit: Fit | Recalibration, evidence: Evidence) -> tuple[Parameter, ...]:
    """Return the tolerances of the unit, as relative or absolute deviations from the model."""
    z = evidence.tolerances.of(0, fit.z)
    sd = evidence.tolerances.of(0, np.sqrt(np.diag(fit.covariance))[fit.free:])
    return tuple(
        Parameter(name=t.name, value=float(t.half_width * x),
                  low=float(t.half_width * (x - QUANTILE * s)),
                  high=float(t.half_width * (x + QUANTILE * s)), unit=t.unit)
        for t, x, s in zip(TOLERANCES, z, sd)
    )
