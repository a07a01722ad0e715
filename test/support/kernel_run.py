"""Run the kernel from a state of our choice, and lines of what comes out."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ema_record.actuator import Actuator
from ema_record.channels import N_CHANNELS
from ema_sim.effects import Effects
from ema_sim.plant import kernel as k
from ema_sim.plant import state as st

NEVER = math.inf


class Run(NamedTuple):
    out: np.ndarray
    trace: np.ndarray
    state: np.ndarray


def state_of(a: Actuator, *, angle: float = 0.3, **values: float) -> np.ndarray:
    """Return the state at rest at 0 with values set by name, e.g. ``omega_m=100``."""
    state = st.initial_state(a, 0.0, angle)
    for name, value in values.items():
        state[getattr(st, name.upper())] = value
    return state


def run(
    a: Actuator,
    state: np.ndarray,
    duration: float,
    *,
    effects: Effects | None = None,
    inverter_on: float = NEVER,
    command: float = 0.0,
    rate: float = 20_000.0,
    max_step: float = k.MAX_STEP,
) -> Run:
    """Run the kernel with a constant command and no noise; `state` is not changed."""
    n = round(duration * rate)
    periods = round(duration / a.control.period) + 2
    out, trace, after = np.empty((n, N_CHANNELS)), np.empty((n, 3)), state.copy()
    status = k.kernel()(
        a, effects if effects is not None else Effects(), after, np.full(periods, command),
        np.zeros((periods, 2)), inverter_on, rate, max_step, out, trace,
    )
    assert status == k.OK
    return Run(out, trace, after)


def lines(signal: np.ndarray, theta: np.ndarray, highest: int = 8) -> np.ndarray:
    """Return the amplitudes at 0..`highest` times the angle `theta`, by least squares."""
    drift = np.linspace(-1.0, 1.0, len(theta))
    columns = [np.ones_like(theta), drift, drift**2]
    for h in range(1, highest + 1):
        columns += [np.cos(h * theta), np.sin(h * theta)]
    c = np.linalg.lstsq(np.stack(columns, axis=1), signal, rcond=None)[0]
    return np.append(abs(c[0]), np.hypot(c[3::2], c[4::2]))
