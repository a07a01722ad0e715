"""The common drive, and the features that are compared. numpy only: peers import it too.

A sine-wave permanent-magnet motor at its regulated speed against dry and viscous friction:
the numbers of config/actuator.yaml, the surface's friction and inertia referred to the motor.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable

import numpy as np

R, L, K = 1.065, 0.72e-3, 0.0376
"""Resistance (Ω), inductance (H), back-EMF constant (V s/rad) of a phase; one pole pair."""
V_LEG, BAND, I_MAX = 48.0, 0.5, 22.0
"""Leg voltage ± (V), half width of the hysteresis (A), limit of the reference (A)."""
J = 1.5e-5 + 0.20 / 500.0**2
"""Inertia (kg m²)."""
DRY, VISCOUS = 0.30 + 60.0 / 500.0, 1e-4 + 2.0 / 500.0**2
"""Friction at the motor (N m), (N m s/rad)."""
OMEGA, KP, KI, PERIOD = 790.6, 0.30, 60.0, 50e-6
"""Speed (rad/s) and its PI control (A s/rad, A/rad), control period (s)."""
SAMPLE = 50e-6
"""Samples are means over this interval (s)."""
LENGTH, WINDOW = 0.12, 0.08
"""Simulated time and the end of it that the features are taken from (s)."""
ANGLES = tuple(2.0 * math.pi * (n + 0.25) / 4 for n in range(4))
"""Rotor angles at the start (rad): relays are chaotic, features are means over these."""
FEATURES = ("torque", "current rms", "torque ripple")
"""Mean torque (N m), rms of the phase currents (A), rms of the torque about its mean (N m)."""


def features(samples: np.ndarray) -> dict[str, float]:
    """Return `FEATURES` of samples, shape (n, 4): torque (N m), phase currents (A)."""
    window = samples[-round(WINDOW / SAMPLE):]
    return {
        "torque": float(window[:, 0].mean()),
        "current rms": float(np.sqrt((window[:, 1:] ** 2).mean())),
        "torque ripple": float(window[:, 0].std()),
    }


def standard_error(values: list[float]) -> float:
    """Return the standard error of the mean of `values`, relative to it; NaN of one value."""
    if len(values) < 2:
        return math.nan
    return float(np.std(values, ddof=1) / math.sqrt(len(values)) / abs(np.mean(values)))


def measure(
    run: Callable[[float], np.ndarray], length: float = LENGTH, angles: tuple = ANGLES
) -> dict:
    """Return mean features over `angles`, wall and CPU time a simulated second (medians).

    `run` takes the start angle (rad) and returns samples, shape (n, 4); `length` is what it
    simulates (s). A first run, not timed, warms up.
    """
    run(angles[0])
    walls, cpus, found = [], [], []
    for angle in angles:
        wall, cpu = time.perf_counter(), time.process_time()
        samples = run(angle)
        walls.append((time.perf_counter() - wall) / length)
        cpus.append((time.process_time() - cpu) / length)
        found.append(features(samples))
    return {
        "wall": float(np.median(walls)), "cpu": float(np.median(cpus)),
        "values": {name: float(np.mean([f[name] for f in found])) for name in FEATURES},
        "spread": {name: standard_error([f[name] for f in found]) for name in FEATURES},
    }


def on_grid(time_: np.ndarray, values: np.ndarray, length: float) -> np.ndarray:
    """Return means over samples of values, shape (m, 4), linear between instants `time_`."""
    steps = np.diff(time_)[:, None]
    total = np.vstack([np.zeros(4), np.cumsum(0.5 * steps * (values[1:] + values[:-1]), axis=0)])
    edges = np.arange(round(length / SAMPLE) + 1) * SAMPLE
    at = np.column_stack([np.interp(edges, time_, column) for column in total.T])
    return np.diff(at, axis=0) / SAMPLE


def report(rows: list[dict]) -> None:
    """Print rows for the process that started this one."""
    json.dump(rows, sys.stdout)
    print(flush=True)
