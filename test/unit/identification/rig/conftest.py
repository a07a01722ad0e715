"""Small rigs with a known answer."""

import numpy as np
import pytest

from ema_rig.record import Axis, RigRecord

RATE = 250.0


def motion(duration=16.0, stroke=1.0, seed=0):
    """Return time, position, speed, acceleration of a multi-sine."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(duration * RATE)) / RATE
    q, v, a = np.zeros((3, len(t)))
    for k, f in enumerate((0.4, 0.65, 1.1, 1.9)):
        w, phase, size = 2 * np.pi * f, rng.uniform(0, 6.28), stroke / (k + 1) ** 1.5
        q += size * np.sin(w * t + phase)
        v += size * w * np.cos(w * t + phase)
        a -= size * w**2 * np.sin(w * t + phase)
    return t, q, v, a


def rig_record(t, u, axis, *, noise=0.02, seed=1, source="bench", **outputs):
    """Return a record with white noise on the input."""
    rng = np.random.default_rng(seed)
    u = u + noise * rng.standard_normal(len(t))
    columns = {"time": t, axis.input_channel.name: u, **outputs}
    channels = tuple(c for c in axis.channels if c.name in columns)
    return RigRecord(samples=np.column_stack([columns[c.name] for c in channels]),
                     channels=channels, axis=axis, source=source)


@pytest.fixture
def moving():
    """Return a function that gives time, position, speed and acceleration of a multi-sine."""
    return motion


@pytest.fixture
def recorded():
    """Return a function that makes a record of time, input and outputs."""
    return rig_record


@pytest.fixture
def axis():
    """Return a rotary axis driven by a torque."""
    return Axis(name="bench", motion="rotary", input="torque")


@pytest.fixture
def bench(axis):
    """Return a function that makes a record; `extra` is added to inertia and viscous friction."""
    def make(extra=lambda t, q, v, a: 0.0, *, seed=1, duration=16.0, keep=("position",),
             own_axis=None, **options):
        t, q, v, a = motion(duration, seed=seed)
        u = 0.05 * a + 0.4 * v + extra(t, q, v, a)
        values = {"position": q + 2e-6 * np.random.default_rng(seed).standard_normal(len(t)),
                  "speed": v + 1e-3 * np.random.default_rng(seed + 9).standard_normal(len(t))}
        return rig_record(t, u, own_axis or axis, seed=seed,
                          **{k: values[k] for k in keep}, **options)
    return make
