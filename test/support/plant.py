"""The plant by itself: the kernel from a state of our choice, its ports, lines of its output."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit

from ema_record.actuator import Actuator, load_actuator
from ema_record.channels import N_CHANNELS
from ema_record.sources import source_hash
from ema_sim.effects import Effects
from ema_sim.plant import kernel as k
from ema_sim.plant import ports, sensor_ports
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
    switching: bool = False,
) -> Run:
    """Run the kernel with a constant command and no noise; `state` is not changed."""
    n = round(duration * rate)
    periods = round(duration / a.control.period) + 2
    out, trace, after = np.empty((n, N_CHANNELS)), np.empty((n, 3)), state.copy()
    commanded = np.full(periods, command)
    commanded.flags.writeable = False  # the type that a session passes: compiled only once
    status = k.kernel(a.drive.kind, switching)(
        a, effects if effects is not None else Effects(), after, commanded,
        np.zeros((periods, 2)), inverter_on, rate, max_step, out, trace, np.empty(1), n,
    )
    assert status == k.OK
    return Run(out, trace, after)


def convergence(
    final_state: Callable[[float], np.ndarray], smallest: float
) -> tuple[float, np.ndarray]:
    """Return the order of the kernel, and the relative errors at steps of 20, 10, 5 and 2.5 µs.

    Parameters
    ----------
    final_state : gives the state after a run, by the longest step (s).
    smallest : step of the run that counts as exact (s).
    """
    exact = final_state(smallest)
    steps = np.array([20e-6, 10e-6, 5e-6, 2.5e-6])
    error = np.array([np.max(np.abs(final_state(h) / exact - 1.0)) for h in steps])
    return float(np.polyfit(np.log(steps), np.log(error), 1)[0]), error


def lines(signal: np.ndarray, theta: np.ndarray, highest: int = 8) -> np.ndarray:
    """Return the amplitudes at 0..`highest` times the angle `theta`, by least squares."""
    drift = np.linspace(-1.0, 1.0, len(theta))
    columns = [np.ones_like(theta), drift, drift**2]
    for h in range(1, highest + 1):
        columns += [np.cos(h * theta), np.sin(h * theta)]
    c = np.linalg.lstsq(np.stack(columns, axis=1), signal, rcond=None)[0]
    return np.append(abs(c[0]), np.hypot(c[3::2], c[4::2]))


# Rows of `evaluate`: port and what is read there.
ROWS = [
    *(("winding", f"{name} {phase}") for phase in "abc" for name in ("R", "L", "k")),
    ("motor torque", "added torque"),
    ("friction", "dry dynamic, motor"), ("friction", "dry static, motor"),
    ("friction", "viscous, motor"),
    ("friction", "dry dynamic, surface"), ("friction", "dry static, surface"),
    ("transmission", "lost motion"), ("transmission", "stiffness"),
    ("transmission", "gear output"), ("transmission", "gear slope"),
    ("load", "inertia, motor"), ("load", "inertia, surface"), ("load", "torque"),
    ("supply", "leg"), ("supply", "rail drop"), ("supply", "switch drop"),
    *(("sensor", f"current {name} {p}") for p in "abc" for name in ("gain", "offset")),
    ("sensor", "speed factor"), ("sensor", "position offset"), ("sensor", "position step"),
    ("sensor", "speed step"),
    ("commutation", "angle"), ("controller", "delay"),
]


@cache
def evaluate():
    return _build(source_hash("ema_sim.plant.ports"))


def _build(sources: str):
    @njit(cache=True, error_model="numpy")
    def values(a: Actuator, e: Effects, points: np.ndarray, out: np.ndarray) -> None:
        """Fill `out`, shape (rows, n), at `points`, shape (n, 4): angle, speed, current, twist."""
        _ = sources
        top = ports.flat_top(e, a.motor)
        for n in range(len(points)):
            angle, omega, current, position = points[n]
            row = 0
            for p in range(3):
                out[row, n] = ports.phase_resistance(e, a.motor, p)
                out[row + 1, n] = ports.phase_inductance(e, a.motor, p, current)
                out[row + 2, n] = ports.back_emf_constant(
                    e, a.motor, top, p, angle, angle, current
                )
                row += 3
            out[row, n] = ports.added_motor_torque(e, a.motor, 0.03, -0.01, -0.02, omega, angle)
            moving = ports.motor_dry_friction(e, a.motor, omega, 0.05 * current)
            out[row + 1, n], out[row + 2, n] = moving
            out[row + 3, n] = ports.motor_viscous_friction(e, a.motor, omega)
            out[row + 4, n], out[row + 5, n] = ports.surface_dry_friction(e, a.surface)
            out[row + 6, n] = ports.lost_motion(e, a.shaft)
            out[row + 7, n] = ports.shaft_stiffness(e, a.shaft)
            out[row + 8, n] = ports.gear_output(e, a.gear, angle, angle)
            out[row + 9, n] = ports.gear_slope(e, a.gear, angle)
            out[row + 10, n] = ports.motor_inertia(e, a.motor)
            out[row + 11, n] = ports.surface_inertia(e, a.surface)
            out[row + 12, n] = ports.load_torque(e, position)
            out[row + 13, n] = ports.leg_voltage(e, a.inverter.bus_voltage)
            out[row + 14, n] = ports.rail_drop(e, current)
            out[row + 15, n] = ports.switch_drop(e, current)
            row += 16
            for p in range(3):
                out[row, n] = sensor_ports.current_gain(e, p)
                out[row + 1, n] = sensor_ports.current_offset(e, p)
                row += 2
            out[row, n] = sensor_ports.speed_factor(e, angle)
            out[row + 1, n] = sensor_ports.position_offset(e)
            out[row + 2, n] = sensor_ports.position_step(e, a.converters)
            out[row + 3, n] = sensor_ports.speed_step(e, a.converters)
            out[row + 4, n] = sensor_ports.commutation_angle(e)
            out[row + 5, n] = sensor_ports.delay_periods(e, a)

    return values


def port_values(effects: Effects, actuator: Actuator | None = None) -> np.ndarray:
    """Return all ports' values, shape (len(ROWS), 60), at states drawn once for all."""
    rng = np.random.default_rng(5)
    points = np.column_stack([
        rng.uniform(0.0, 2.0 * np.pi, 60), rng.uniform(-800.0, 800.0, 60),
        rng.uniform(-20.0, 20.0, 60), rng.uniform(-0.5, 0.5, 60),
    ])
    out = np.full((len(ROWS), 60), np.nan)
    evaluate()(actuator if actuator is not None else load_actuator(), effects, points, out)
    return out
