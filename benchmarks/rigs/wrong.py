"""Records that cannot be what they are called, and two axes of which one moves the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.rigs.kinds import trapezoids
from ema_rig.record import RigRecord
from support.rigs import RIGS, make, motion_of, rms

SAYS = {
    "wrong sign": ("reversed",), "unsigned": ("no sign",), "wrapped": ("counter", "starts again"),
    "clipped": ("clipped",), "swapped": ("swapped",),
    "wrong unit": ("rev/min", "deg", "mm", "turns", "ms"),
}
"""Words of which one must stand in the refusal."""


def wrong_record(kind: str, number: int, seed: int) -> RigRecord:
    """Return a record with one thing wrong; of a rotary rig with position and speed."""
    rng = np.random.default_rng([seed, number, 7])
    rig = RIGS[("joint", "motor", "spindle")[number // 6 % 3]]
    rig = replace(rig, outputs=("position", "speed"))
    record = make(rig, int(rng.integers(1 << 30)), {"coulomb_friction": rng.uniform(0.2, 0.5)})
    samples = record.samples.copy()  # time, input, position, speed
    if kind == "wrong sign":
        samples[:, 1] *= -1.0
    elif kind == "unsigned":
        samples[:, 1] = np.abs(samples[:, 1])
    elif kind == "wrapped":
        samples[:, 2] = np.mod(samples[:, 2], 0.4 * np.ptp(samples[:, 2]))
    elif kind == "clipped":
        limit = rng.uniform(0.4, 0.6) * np.abs(samples[:, 1]).max()
        samples[:, 1] = np.clip(samples[:, 1], -limit, limit)
    elif kind == "swapped":
        first, second = ((2, 3), (1, 3), (1, 2))[number // 6 % 3]
        samples[:, [first, second]] = samples[:, [second, first]]
    else:
        samples[:, 3] *= (60 / (2 * np.pi), 180 / np.pi, 1e3)[number // 6 % 3]
    return replace(record, samples=samples, source=f"{kind}-{number}")


def coupled_record(number: int, seed: int) -> RigRecord:
    """Return a record of an axis that another one moves too: most of its input."""
    rng = np.random.default_rng([seed, number, 11])
    rig = RIGS[list(RIGS)[number % len(RIGS)]]
    record = make(rig, int(rng.integers(1 << 30)), {"coulomb_friction": 0.3})
    other = (trapezoids if number % 2 else motion_of)(rig, rng)
    load = rig.inertia * other.acceleration + 0.5 * rms(other.acceleration) * rig.inertia \
        * np.sign(other.speed)
    samples = record.samples.copy()
    samples[:, 1] += rng.uniform(0.6, 1.2) * rms(samples[:, 1]) / rms(load) * load
    return replace(record, samples=samples, source=f"coupled-{number}")
