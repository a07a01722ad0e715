"""Records in closed form: a rotor that turns as the test says, no simulation."""

import numpy as np

from ema_record.profile import load_profile
from ema_record.record import Record

TURN = 2 * np.pi


def slewing_record(
    *, speed=790.6, rate=20_000.0, duration=0.45, speed_lines=(), current=7.0,
    current_lines=(), direction=1, noise=0.0, seed=0,
):
    """Return a step record at constant speed; lines are (harmonic, amplitude, phase)."""
    n = round(duration * rate)
    time = (np.arange(n) + 0.5) / rate
    theta = direction * speed * time + 0.3
    samples = np.zeros((n, 10))
    samples[:, 0] = time
    omega = np.full(n, direction * speed)
    for h, amplitude, phase in speed_lines:
        omega += amplitude * np.cos(h * theta + phase)
    reference = np.full(n, current)
    for h, amplitude, phase in current_lines:
        reference += amplitude * np.cos(h * theta + phase)
    samples[:, 1] = omega
    sector = np.floor(np.mod(theta - TURN / 12, TURN) / (TURN / 6)).astype(int)
    signs = np.array(
        [[1, -1, 0], [1, 0, -1], [0, 1, -1], [-1, 1, 0], [-1, 0, 1], [0, -1, 1]]
    )[sector]
    samples[:, 5:8] = signs * reference[:, None] * direction
    samples[:, 2:5] = samples[:, 5:8] * (time > 0.020)[:, None]
    samples[:, 8] = np.mod(theta, TURN)
    samples[:, 9] = -0.4 + theta / 500
    samples[:, 1:5] += noise * np.random.default_rng(seed).normal(size=(n, 4))
    return Record(samples=samples, profile=load_profile("step"))
