"""What physics allows for friction without a baseline, when viscous friction is not known.

A test measures the logarithms of the torque at full speed, at a quarter of it, on the ramp and in
the gap of zero shaft torque (that of the motor alone), and of the torque constant. They depend on
the dry friction of motor and surface, which is what is asked for, and on what is not known and
only spread: the viscous friction of both, the torque constant, the flat top (which shifts the
measured constant), the mean gain of the current sensors. With the noise of repeated tests that is
a linear model with Gaussian priors; its information matrix (Cramér and Rao; van Trees 1968 with
the priors) gives the least error s of a dry friction. A unit's own friction is uniform within its
tolerance, so the bound is the increase that lifts nine of ten units beyond what a part α of
healthy ones shows: both are quantiles of log(1 + u) + s z.

    python -m benchmarks.detection.friction_bound
"""

from __future__ import annotations

import argparse
import math
from typing import NamedTuple

import numpy as np

from ema_prognostics.features.extract import extract
from ema_record.actuator import Actuator, load_actuator
from ema_record.profile import load_profile
from ema_record.spread import TypeSpread, load_spread
from ema_sim.simulate import simulate

TORQUES = ("torque_full", "torque_quarter", "torque_ramp", "gap_torque")
CONSTANT = "winding_back_emf"
FOUND = 0.9
FIRST_SEED = 991_000
FLAT_TOP_SHIFT = 0.1
"""Of the logarithm of the measured constant by the flat top (1/rad): −0.9 % for 5 deg."""


class FrictionBound(NamedTuple):
    """Bound of one side."""

    error: float
    """Least standard deviation of the logarithm of a dry friction."""
    a90: float
    """Increase found in nine of ten."""


def levels(a: Actuator, speeds: tuple[float, float, float]) -> np.ndarray:
    """Return the derivatives of the four log torques by log dry friction and log viscosity.

    Parameters
    ----------
    a : nominal actuator.
    speeds : of full slew, quarter slew and ramp (rad/s, of the motor); that of the gap is the
        ramp's.

    Returns
    -------
    ndarray, shape (4, 4). Columns: dry motor, dry surface, viscous motor, viscous surface.
    """
    ratio = a.gear.ratio
    rows = []
    for speed, surface in zip((*speeds, speeds[2]), (1.0, 1.0, 1.0, 0.0)):
        parts = np.array([
            a.motor.dynamic_friction, surface * a.surface.dynamic_friction / ratio,
            a.motor.viscous_friction * speed,
            surface * a.surface.viscous_friction * speed / ratio**2])
        rows.append(parts / parts.sum())
    return np.array(rows)


def least_errors(
    noise: np.ndarray, a: Actuator, spread: TypeSpread, speeds: tuple[float, float, float], *,
    viscous_known: bool,
) -> np.ndarray:
    """Return the least errors of the log dry friction of motor and surface, shape (2,).

    Parameters
    ----------
    noise : ndarray, shape (5, 5). Covariance of `TORQUES` and `CONSTANT` over repeated tests.
    a, spread, speeds : nominal actuator, its tolerances and conditions, see `levels`.
    viscous_known : whether the viscous friction is that of the description.
    """
    t, c = spread.tolerances, spread.conditions
    jacobian = np.zeros((5, 7))
    jacobian[:4, :4] = levels(a, speeds)
    jacobian[:4, 4] = -1.0  # torque is current times the nominal constant
    jacobian[4, 4] = 1.0
    jacobian[4, 5] = FLAT_TOP_SHIFT
    jacobian[:4, 6] = 1.0  # mean gain of the sensors
    grease = 1e-6 if viscous_known else math.log(t.viscous_factor) / math.sqrt(3.0)
    prior = np.array([1e3, 1e3, grease, grease, t.back_emf / math.sqrt(3.0),
                      t.flat_top / math.sqrt(3.0), c.current_gain / 3.0])
    information = jacobian.T @ np.linalg.solve(noise, jacobian) + np.diag(1.0 / prior**2)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))[:2]))


def bound(error: float, half: float, false_alarms: float) -> FrictionBound:
    """Return the bound for an error of the logarithm and a tolerance of ± `half`."""
    u = np.linspace(-half, half, 20_001)
    z = np.linspace(-4.5, 4.5, 181)
    weight = np.exp(-0.5 * z**2)
    value = (np.log1p(u)[:, None] + error * z).ravel()
    order = np.argsort(value)
    share = np.cumsum(np.tile(weight, len(u))[order])
    share /= share[-1]
    high = value[order][np.searchsorted(share, 1.0 - false_alarms)]
    low = value[order][np.searchsorted(share, 1.0 - FOUND)]
    return FrictionBound(error, float(np.expm1(high - low)))


def main() -> None:
    """Print the bounds for the present kit."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--repeats", type=int, default=60)
    parser.add_argument("--noise", type=float, default=1.0, help="factor on the sensor noise")
    options = parser.parse_args()
    a, spread = load_actuator(), load_spread()
    found = [extract(simulate(load_profile("extended"), seed=FIRST_SEED + k, noise=options.noise),
                     "extended") for k in range(options.repeats)]
    rows = np.array([[f[n] for n in (*TORQUES, CONSTANT)] for f in found])
    noise = np.cov(rows, rowvar=False)
    full = math.exp(np.mean([f["speed_full"] for f in found]))
    profile = load_profile("extended")
    slopes = sorted({round(abs((y - x) / (t - s)) * a.gear.ratio, 1)
                     for (s, x), (t, y) in zip(profile.points, profile.points[1:])
                     if t > s and y != x}, reverse=True)
    speeds = (full, slopes[0], slopes[-1])
    print("standard deviation of one test (%): " + ", ".join(
        f"{n} {100 * s:.2f}" for n, s in zip((*TORQUES, CONSTANT), np.sqrt(np.diag(noise)))))
    print(f"speeds (rad/s): {', '.join(f'{s:.0f}' for s in speeds)}")
    for known in (True, False):
        errors = least_errors(noise, a, spread, speeds, viscous_known=known)
        for side, error, half in zip(("motor", "surface"), errors, (
                spread.tolerances.motor_friction, spread.tolerances.surface_friction)):
            rates = ", ".join(f"{100 * bound(float(error), half, r).a90:.1f} % at {100 * r:g} %"
                              for r in (0.01, 0.0005))
            print(f"{side}, viscous friction {'known' if known else 'unknown'}: "
                  f"least error {100 * error:.2f} %, a90 {rates} false alarms")


if __name__ == "__main__":
    main()
