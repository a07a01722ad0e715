"""Faults for training, and what is no fault of a class: drawn from one seed, as plain data.

Strangers are effects of the catalogue that a maintainer may meet, each between a size that nobody
sees and one that nobody misses. What is in no list at all is the guard's. The shape of the
back-EMF and the compliance of the shaft are in none: units differ in them and are sound. The
benchmark has a generator of its own and imports nothing from here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ema_prognostics.cascade.classes import FAULTS, OUTPUTS, scale_of
from ema_record.actuator import Actuator, load_actuator

SEVERITY: dict[str, tuple[float, float]] = {
    "turn_short": (1e-3, 0.4), "rotor_eccentricity": (5e-4, 0.2), "friction": (0.01, 4.0),
    "backlash": (0.2, 40.0),
}
"""Least and largest severity, drawn evenly in its logarithm, in `classes.scale_of`: friction up to
more than most machines can turn, which then give no record."""
MODES = ("paper", "common", "shifted")


class Stranger(NamedTuple):
    """What an example of no class is of."""

    kind: str
    sign: float = 1.0
    """-1 where the quantity is off to the other side."""
    phase: int = 0
    """0 to 2, of a kind that is of one phase."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InjectedFault:
    """What is wrong: severities of the outputs, and the settings that inject it."""

    severity: Mapping[str, float] = field(default_factory=dict)
    settings: tuple[str, ...] = ()
    stranger: Stranger | None = None
    """None: it is of a class, or nothing is wrong."""


HEALTHY = InjectedFault()


def _severity(rng: np.random.Generator, fault: str) -> float:
    low, high = SEVERITY[fault]
    return scale_of(fault) * float(np.exp(rng.uniform(math.log(low), math.log(high))))


def draw_fault(rng: np.random.Generator, fault: str) -> InjectedFault:
    """Return a fault of the class `fault`; `static` is eccentricity fixed in the stator."""
    if fault == "healthy":
        return HEALTHY
    phase = int(rng.integers(3))
    if fault == "turn_short":
        x = _severity(rng, fault)
        mode = ("paper", "physical", "physical")[int(rng.integers(3))]
        return InjectedFault(severity={OUTPUTS[phase]: x}, settings=(
            f"turn_short.fraction={x!r}", f"turn_short.phase={'abc'[phase]}",
            f"turn_short.mode={mode}",
        ))
    if fault == "static":
        z = _severity(rng, "rotor_eccentricity")
        return InjectedFault(severity={"static_eccentricity": z}, settings=(
            f"rotor_eccentricity.zeta={z!r}", "rotor_eccentricity.mode=static",
            f"rotor_eccentricity.angle={float(rng.uniform(-math.pi, math.pi))!r}",
        ))
    if fault == "rotor_eccentricity":
        z = _severity(rng, fault)
        mode = MODES[int(rng.integers(3))]
        sign = (-1.0, 1.0)[int(rng.integers(2))]
        return InjectedFault(severity={"eccentricity": z}, settings=(
            f"rotor_eccentricity.zeta={sign * z!r}", f"rotor_eccentricity.mode={mode}",
            f"rotor_eccentricity.angle={float(rng.uniform(-math.pi, math.pi))!r}",
            f"rotor_eccentricity.phase={'abc'[phase]}",
        ))
    if fault == "friction":
        name = ("motor_friction", "surface_friction")[int(rng.integers(2))]
        x = _severity(rng, fault)
        return InjectedFault(severity={name: x}, settings=(f"{name}.increase={x!r}",))
    x = _severity(rng, "backlash")
    return InjectedFault(severity={"backlash": x}, settings=(f"backlash.increase={x!r}",))


def draw_pair(rng: np.random.Generator) -> InjectedFault:
    """Return two faults of different classes at once."""
    first, second = rng.choice(4, size=2, replace=False)
    a, b = draw_fault(rng, FAULTS[first]), draw_fault(rng, FAULTS[second])
    return InjectedFault(severity={**a.severity, **b.severity}, settings=a.settings + b.settings)


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
