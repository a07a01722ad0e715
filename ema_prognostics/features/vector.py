"""Features as vectors: differences to the baseline, squashing, rotation of the phases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_record.actuator import load_actuator

ABSOLUTE = "absolute_"
"""Marks a feature itself beside its difference to the baseline."""
START = "start_position"
START_TOLERANCE = 0.6
"""How far from its start a test may begin, of the wind-up under static friction, which holds the
surface there: 0.4 was seen."""


def difference_names(names: Sequence[str]) -> list[str]:
    """Return the names with a baseline: differences, then the features themselves."""
    return [*names, *(f"{ABSOLUTE}{n}" for n in names)]


def differences(record: np.ndarray, baseline: np.ndarray) -> np.ndarray:
    """Return the features with a baseline, shape (n, 2 d), of two arrays of shape (n, d)."""
    return np.hstack([record - baseline, record])


def squash(x: np.ndarray, center: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Return asinh((x − centre) / spread): linear near healthy, logarithmic far away."""
    return np.arcsinh((x - center) / spread)


def start_allowed(x: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Return features, shape (n, d), with the position before the test zero where it may be.

    Before a live test the surface is driven to its start and stands up to `START_TOLERANCE`
    off; only what is beyond counts.
    """
    if START not in names:
        return x
    actuator = load_actuator()
    tolerance = START_TOLERANCE * 1e3 * actuator.wind_up / actuator.gear.ratio  # mrad
    out = x.copy()
    off = out[:, list(names).index(START)]
    out[:, list(names).index(START)] = np.sign(off) * np.maximum(
        np.abs(off) - tolerance, 0.0)
    return out


def rotate(x: np.ndarray, names: Sequence[str], thirds: int) -> np.ndarray:
    """Return the features as if the rotor angle were counted from a phase further on.

    A fault of phase b, rotated by one third, looks like the same fault of phase a: line h of
    phase b lags by h 120°.

    Parameters
    ----------
    x : ndarray, shape (n, d). Features.
    names : of the features; ``..._m<h>_re`` is followed by ``..._m<h>_im``.
    thirds : number of phases.
    """
    out = x.copy()
    for k, name in enumerate(names):
        if name.endswith("_re") and "_m" in name:
            h = int(name[name.rindex("_m") + 2:-3])
            turned = (x[:, k] + 1j * x[:, k + 1]) * np.exp(2j * np.pi * h * thirds / 3.0)
            out[:, k], out[:, k + 1] = turned.real, turned.imag
    return out
