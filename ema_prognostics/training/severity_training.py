"""Training of the networks that say how much, and the width of their intervals.

Errors are those of records whose units the network did not see: the units are parted, and each
part is judged by a network of the others. A second network learns how large the error is to be
expected, judged on units that it did not see either; the interval is that, times a factor that
grows or falls with what the network says, one that does so with the noise of the record, and one
where another fault is there too.
"""

from __future__ import annotations

import numpy as np

from ema_prognostics.cascade.classes import CLASS_OF, SEVERITY_OF, scale_of
from ema_prognostics.cascade.model_body import NetworkPart, SeverityPart, View, rounded
from ema_prognostics.networks.fitting import fit_regressor
from ema_prognostics.training.calibration import conformal_quantile, local_quantiles

UNITS = {"short": 2e-3, "eccentricity": 2e-3, "static_eccentricity": 2e-3,
         "motor_friction": 0.05, "surface_friction": 0.05, "backlash": 0.3}
"""Severity below which a network's target is linear, in `classes.scale_of` its class."""
STEP_UNITS = {**UNITS, "motor_friction": 1.0, "surface_friction": 1.0}
"""The same of a single step, whose one speed shows no friction that has grown by some tenths."""
DECAY: dict[View, float] = {"fleet": 3.0, "baseline": 0.7}
"""Penalty on the weights of the severities' networks."""
LEAST: dict[View, dict[str, float]] = {
    "fleet": {"short": 0.005, "static_eccentricity": 0.005, "backlash": 0.6},
    "baseline": {"motor_friction": 0.025, "surface_friction": 0.025, "backlash": 0.6},
}
"""Smallest severity that is announced, in `classes.scale_of`; others: 0. Where networks see far
less than is asked for, the least that they see is as likely a side of something else: a third to
half of the target."""
COVERED: dict[View, float] = {"fleet": 0.905, "baseline": 0.895}
"""Part of the training's own errors that an interval holds, so that it holds 90 % of new ones.

A little less than 0.9, since the networks of the expected error that judge a part of the units
were trained on fewer than the one that is kept. Set by hand: 0.88 and 0.9 held 90.6 and 90.4 % of
the errors of four fleets that the cascade was developed on, which are not kept. What the values
give elsewhere is in the validation of every training and in `benchmarks.detection`."""
SCALE_DECAY = 30.0
"""The same, of the networks of their expected error."""
LEAST_ERROR = 0.01
"""Floor of a severity's error, in the network's output."""
GROUP_CLASS = {group: CLASS_OF[output] for output, group in SEVERITY_OF.items()}
NOISE_BINS = 3
"""Most bins of the noise."""
FEWEST = 40
"""Announced records that an interval needs; of fewer, all with the fault set it."""


def train_severity(
    group: str, view: View, x: np.ndarray, label: np.ndarray, part: np.ndarray,
    announced: np.ndarray, alone: np.ndarray, noise: np.ndarray, inputs: list[str], *,
    kind: str, hidden: int, seed: int, iterations: int,
) -> SeverityPart:
    """Return the network of a group, its expected error and the factors of its interval.

    Parameters
    ----------
    group, view : whose severity, with or without baseline.
    x : ndarray, shape (n, d). Inputs of records with the fault.
    label : ndarray, shape (n,). Their severities.
    part : ndarray of int, shape (n,). Part of the units; the network is trained without part 0.
    announced : ndarray of bool, shape (n,). Where the fault is found; only of these a severity
        is told.
    alone : ndarray of bool, shape (n,). Where no other fault is there.
    noise : ndarray, shape (n,). Of each record, squashed.
    inputs : names of the inputs.
    kind : of the test.
    hidden, seed, iterations : of the networks.
    """
    scale = scale_of(GROUP_CLASS[group])
    unit = scale * (STEP_UNITS if kind == "step" else UNITS)[group]
    target = np.arcsinh(label / unit)
    value = np.empty(len(x))
    for k in sorted(set(part.tolist()), reverse=True):
        out = part == k
        network = NetworkPart.of(fit_regressor(
            x[~out], target[~out, None], iterations=2 * iterations, members=3,
            decay=DECAY[view], hidden=hidden, seed=seed))
        value[out] = network.build()(x[out])[:, 0]
    error = np.abs(target - value)
    size = np.log(error + LEAST_ERROR)

    def error_network(rows: np.ndarray) -> NetworkPart:
        return NetworkPart.of(fit_regressor(
            x[rows], size[rows, None], iterations=iterations, members=2, hidden=6, seed=seed,
            decay=SCALE_DECAY))

    ratio = np.empty(len(x))
    for k in np.unique(part):
        out = part == k
        ratio[out] = error[out] / np.exp(error_network(~out).build()(x[out])[:, 0])
    error_size = error_network(np.ones(len(x), dtype=bool))
    least = scale * LEAST[view].get(group, 0.0)
    told = announced & (value >= np.arcsinh(least / unit))
    counted = told & alone if np.count_nonzero(told & alone) >= FEWEST else alone
    knots, factors = local_quantiles(value[counted], ratio[counted], COVERED[view])
    ratio /= np.interp(value, knots, factors)
    noise_knots, noise_factors = local_quantiles(
        noise[counted], ratio[counted], COVERED[view], NOISE_BINS)
    ratio /= np.interp(noise, noise_knots, noise_factors)
    beside, company = told & ~alone, 1.0
    if np.count_nonzero(beside) >= FEWEST:
        company = conformal_quantile(ratio[beside], COVERED[view])
    return SeverityPart(
        inputs=inputs, network=network, scale=error_size, unit=unit, knots=rounded(knots),
        factors=rounded(factors), noise_knots=rounded(noise_knots),
        noise_factors=rounded(noise_factors), company=float(f"{company:.6g}"),
        upper=float(f"{label.max():.6g}"), least=least,
    )
