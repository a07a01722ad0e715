"""What physics allows for the shifted eccentricity, by its angle and by the noise.

In the shifted mode the torque has line 3 alone. With φ_k the angle of phase k, the parts of the
three phases add to a term that turns with the angle α of the eccentricity and one that turns
against it, so the line is three times as strong along the phase as across it. No tolerance of the
unit makes it: a single record is tested, and a baseline would only add its noise.

The best test of a line whose direction is not known is that of its length. From the noise of the
lines (repeats of the nominal unit) and their shift by the fault follow the severity found in 90 %
of records, and what a benchmark of so many units would say of the test that is best.

    python -m benchmarks.detection.bounds_by_angle
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2, ncx2

from benchmarks.detection.bounds import Fault, Library
from benchmarks.detection.detectability import FALSE_ALARMS, FOUND, inverse_covariance
from ema_prognostics.training.rates import detection

LINES = tuple(f"{speed}_even_m{h}_" for speed in ("quarter", "full") for h in (1, 3))
"""Lines that an eccentricity makes, and no tolerance."""
ANGLES = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0)
"""To the phase (deg); the rest follows by symmetry."""
NOISES = (0.5, 1.0, 2.0)
SEVERITY = 0.01
"""At which the derivative is taken."""
SPAN = (1e-3, 0.05)
"""Severities of the benchmark, evenly in the logarithm."""
LEAST_RATE = 0.001
"""Rate of false alarms that one family of faults may take of the whole."""


def strength(library: Library, angle: float) -> float:
    """Return the shift by a severity of 1, in standard deviations of the noise, at `angle`."""
    fault = Fault("shifted", {
        "rotor_eccentricity.zeta": "x", "rotor_eccentricity.mode": "shifted",
        "rotor_eccentricity.angle": float(np.radians(angle))}, SEVERITY, 1, 2, (0.006, 0.008))
    pick = [k for k, name in enumerate(library.names) if name.startswith(LINES)]
    signature = library.signature(fault)[pick]
    return float(np.sqrt(signature @ inverse_covariance(library.base[:, pick]) @ signature))


def found_at(shift: np.ndarray, rate: float) -> np.ndarray:
    """Return the probability that the test of the length finds `shift` (standard deviations)."""
    return ncx2.sf(chi2.isf(rate, 2), 2, np.maximum(shift, 1e-9) ** 2)


def bound(strengths: np.ndarray, rate: float, found: float = FOUND) -> float:
    """Return the severity found in `found` of records, `strengths` being equally frequent."""
    low, high = 1e-5, 1.0
    while high / low > 1.001:
        middle = np.sqrt(low * high)
        if found_at(middle * strengths, rate).mean() < found:
            low = middle
        else:
            high = middle
    return float(high)


def benchmark(strengths: np.ndarray, rate: float, units: int, fleets: int = 200
              ) -> tuple[float, ...]:
    """Return 5, 50 and 95 % quantiles of the a90/95 that fleets of `units` give for this test."""
    rng = np.random.default_rng(990_002)
    results = []
    for _ in range(fleets):
        severity = np.exp(rng.uniform(*np.log(SPAN), units))
        p = found_at(severity * rng.choice(strengths, units), rate)
        curve = detection(severity, rng.uniform(size=units) < p)
        results.append(np.inf if curve is None else curve.a90_95)
    return tuple(float(q) for q in np.quantile(results, (0.05, 0.5, 0.95)))


def by_angle(repeats: int, base_repeats: int, noises: Sequence[float] = NOISES) -> np.ndarray:
    """Return the strengths, shape (noises, angles)."""
    libraries = (Library(repeats, base_repeats, noise) for noise in noises)
    return np.array([[strength(library, a) for a in ANGLES] for library in libraries])


def main() -> None:
    """Compute and print the bounds."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--repeats", type=int, default=16, help="runs a derivative")
    parser.add_argument("--base-repeats", type=int, default=150, help="runs of the nominal unit")
    parser.add_argument("--units", type=int, default=200, help="units of a benchmark")
    options = parser.parse_args()
    table = by_angle(options.repeats, options.base_repeats)
    for rate in (FALSE_ALARMS, LEAST_RATE):
        print(f"\nshifted eccentricity found in {FOUND:.0%} of records, percent of the gap; "
              f"{rate:.1%} false alarms")
        print(f"{'noise':>8}" + "".join(f"{a:>7.0f} deg" for a in ANGLES))
        for noise, row in zip(NOISES, table):
            print(f"{noise:>8g}" + "".join(
                f"{100.0 * bound(np.array([s]), rate):>11.2f}" for s in row))
        # Any angle and noise: strength falls with the noise, angles repeat every 90 degrees.
        angle = np.linspace(0.0, 90.0, 91)
        noise = np.exp(np.linspace(np.log(0.5), np.log(2.0), 41))
        nominal = np.interp(angle, ANGLES, table[1])
        anywhere = (nominal[:, None] / noise).ravel()
        low, middle, high = benchmark(anywhere, rate, options.units)
        print(f"any angle, noise 0.5 to 2: a90 {100.0 * bound(anywhere, rate):.2f}; a90/95 of "
              f"{options.units} units {100.0 * middle:.2f} ({100.0 * low:.2f} to "
              f"{100.0 * high:.2f} in nine fleets of ten)")


if __name__ == "__main__":
    main()
