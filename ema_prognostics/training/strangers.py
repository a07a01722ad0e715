"""What is no fault of the cascade's classes, for training: drawn as plain data.

Effects of the catalogue that a maintainer may meet, each between a size that nobody sees and one
that nobody misses. What is in no list at all is the guard's.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ema_prognostics.training.faults import InjectedFault
from ema_record.actuator import Actuator, load_actuator

Settings = list[str]


def _size(rng: np.random.Generator, least: float, most: float) -> float:
    """Return a size, even in its logarithm."""
    return math.exp(rng.uniform(math.log(least), math.log(most)))


def _sign(rng: np.random.Generator) -> float:
    return (-1.0, 1.0)[int(rng.integers(2))]


def _phase(rng: np.random.Generator) -> str:
    return "abc"[int(rng.integers(3))]


def _angle(rng: np.random.Generator) -> float:
    return float(rng.uniform(-math.pi, math.pi))


def _weak_magnets(_: Actuator, rng: np.random.Generator) -> Settings:
    return [f"torque_constant_drop.drop={_size(rng, 0.03, 0.4)!r}"]


def _resistance(_: Actuator, rng: np.random.Generator) -> Settings:
    return [f"phase_resistance_imbalance.increase={_size(rng, 0.05, 2.0)!r}",
            f"phase_resistance_imbalance.phase={_phase(rng)}"]


def _commutation(_: Actuator, rng: np.random.Generator) -> Settings:
    return [f"hall_misalignment.angle={_sign(rng) * _size(rng, 0.02, 0.4)!r}"]


def _cogging(a: Actuator, rng: np.random.Generator) -> Settings:
    """Return a torque of teeth: its periods a turn are a multiple of the poles'."""
    periods = 2 * a.motor.pole_pairs * int(rng.choice([1, 2, 3, 6]))
    return [f"cogging_torque.amplitude={_size(rng, 0.03, 1.0) * a.motor.dynamic_friction!r}",
            f"cogging_torque.periods={periods}", f"cogging_torque.phase={_angle(rng)!r}"]


def _mesh(a: Actuator, rng: np.random.Generator) -> Settings:
    wind_up = a.wind_up / a.gear.ratio
    return [f"gear_mesh_ripple.amplitude={min(_size(rng, 0.02, 1.0) * wind_up, 1e-3)!r}",
            f"gear_mesh_ripple.periods={int(rng.integers(5, 60))}",
            f"gear_mesh_ripple.phase={_angle(rng)!r}"]


def _sag(a: Actuator, rng: np.random.Generator) -> Settings:
    """Return a source whose voltage falls by a part at the largest current."""
    most = 2.0 * a.inverter.bus_voltage / a.inverter.current_limit
    return [f"bus_voltage_sag.resistance={min(_size(rng, 0.005, 0.2) * most, 2.0)!r}"]


def _shape(_: Actuator, rng: np.random.Generator) -> Settings:
    return [f"back_emf_shape.fifth_harmonic={_sign(rng) * _size(rng, 0.02, 0.3)!r}"]


def _compliance(_: Actuator, rng: np.random.Generator) -> Settings:
    return [f"shaft_compliance.increase={_size(rng, 0.3, 5.0)!r}"]


def _run_out(_: Actuator, rng: np.random.Generator) -> Settings:
    return [f"speed_sensor_runout.amplitude={_size(rng, 0.005, 0.1)!r}",
            f"speed_sensor_runout.angle={_angle(rng)!r}"]


def _gain(_: Actuator, rng: np.random.Generator) -> Settings:
    return [f"current_sensor_gain.phase_{_phase(rng)}={_sign(rng) * _size(rng, 0.05, 0.4)!r}"]


def _offset(a: Actuator, rng: np.random.Generator) -> Settings:
    size = _sign(rng) * min(_size(rng, 0.03, 0.4) * a.inverter.current_limit, 5.0)
    return [f"current_sensor_offset.phase_{_phase(rng)}={size!r}"]


KINDS: dict[str, Callable[[Actuator, np.random.Generator], Settings]] = {
    "weak_magnets": _weak_magnets, "phase_resistance": _resistance,
    "commutation": _commutation, "cogging": _cogging, "mesh": _mesh, "sag": _sag,
    "back_emf": _shape, "compliance": _compliance, "speed_sensor": _run_out,
    "current_gain": _gain, "current_offset": _offset,
}
"""Strangers that the networks are taught."""


def draw_stranger(rng: np.random.Generator) -> InjectedFault:
    """Return a stranger; its kind is the first of its settings."""
    kind = list(KINDS)[int(rng.integers(len(KINDS)))]
    return InjectedFault(settings=tuple(KINDS[kind](load_actuator(), rng)))
