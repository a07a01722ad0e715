"""What is no fault of the cascade's classes, for training: drawn as plain data.

Effects of the catalogue that a maintainer may meet, each between a size that nobody sees and one
that nobody misses. What is in no list at all is the guard's. The shape of the back-EMF and the
compliance of the shaft are in none: units differ in them and are sound.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ema_prognostics.training.faults import InjectedFault, Stranger
from ema_record.actuator import Actuator, load_actuator


class Kind(NamedTuple):
    """A kind of stranger."""

    setting: str
    """Effect and parameter of its size; ``{}`` stands for the phase."""
    least: float
    most: float
    """Sizes, drawn evenly in the logarithm."""
    both: bool = False
    """Whether the size may be negative."""
    more: str = ""
    """Other parameters: `phase`, `angle` at any angle, `periods` a turn."""


def kinds_of(a: Actuator) -> dict[str, Kind]:
    """Return the kinds of strangers of an actuator."""
    friction, limit = a.motor.dynamic_friction, a.inverter.current_limit
    wind_up = a.wind_up / a.gear.ratio
    bus = a.inverter.bus_voltage
    sag = 2.0 * bus / limit
    return {
        "weak_magnets": Kind("torque_constant_drop.drop", 0.03, 0.4),
        "phase_resistance": Kind("phase_resistance_imbalance.increase", 0.05, 2.0, more="phase"),
        "commutation": Kind("hall_misalignment.angle", 0.02, 0.4, both=True),
        "cogging": Kind("cogging_torque.amplitude", 0.03 * friction, friction, more="periods"),
        "mesh": Kind("gear_mesh_ripple.amplitude", min(0.02 * wind_up, 2e-5),
                     min(wind_up, 1e-3), more="periods"),
        "load_friction": Kind("load_dependent_friction.coefficient", 0.01, 0.5),
        "sag": Kind("bus_voltage_sag.resistance", min(0.005 * sag, 0.05), min(0.2 * sag, 2.0)),
        "switches": Kind("inverter_voltage_drop.drop", 0.002 * bus, min(0.05 * bus, 10.0)),
        "speed_sensor": Kind("speed_sensor_runout.amplitude", 0.005, 0.1, more="angle"),
        "current_gain": Kind("current_sensor_gain.phase_{}", 0.05, 0.4, both=True),
        "current_offset": Kind("current_sensor_offset.phase_{}", min(0.03 * limit, 0.4),
                               min(0.4 * limit, 5.0), both=True),
    }


def draw_stranger(rng: np.random.Generator) -> InjectedFault:
    """Return a stranger."""
    a = load_actuator()
    kinds = kinds_of(a)
    name = list(kinds)[int(rng.integers(len(kinds)))]
    kind = kinds[name]
    size = math.exp(rng.uniform(math.log(kind.least), math.log(kind.most)))
    sign = (-1.0, 1.0)[int(rng.integers(2))] if kind.both else 1.0
    phase, angle = int(rng.integers(3)), float(rng.uniform(-math.pi, math.pi))
    effect = kind.setting.partition(".")[0]
    settings = [f"{kind.setting.format('abc'[phase])}={sign * size!r}"]
    if kind.more == "phase":
        settings.append(f"{effect}.phase={'abc'[phase]}")
    elif kind.more == "angle":
        settings.append(f"{effect}.angle={angle!r}")
    elif kind.more == "periods":
        settings += [f"{effect}.periods={_periods(name, a, rng)}", f"{effect}.phase={angle!r}"]
    of_phase = kind.more == "phase" or "{}" in kind.setting
    return InjectedFault(settings=tuple(settings),
                         stranger=Stranger(name, sign, phase if of_phase else 0))


def _periods(name: str, a: Actuator, rng: np.random.Generator) -> int:
    """Return periods a turn: of teeth a multiple of the poles, of a mesh any number."""
    if name == "cogging":
        return 2 * a.motor.pole_pairs * int(rng.choice([1, 2, 3, 6]))
    return int(rng.integers(5, 60))
