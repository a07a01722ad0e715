"""Units, conditions and faults for training: drawn from one seed, as plain data.

The spreads are those of the fleet (issue of the robust cascade, item 2). The benchmark has a
generator of its own and imports nothing from here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ema_prognostics.cascade.classes import FAULTS, OUTPUTS
from ema_record.actuator import Actuator
from ema_sim.effects import Effects, parse_effects

SEVERITY: dict[str, tuple[float, float]] = {
    "turn_short": (1e-3, 0.4), "rotor_eccentricity": (5e-4, 0.2), "friction": (0.01, 2.0),
    "backlash": (2e-5, 4e-3),
}
"""Least and largest severity, drawn evenly in its logarithm (1, 1, 1, rad)."""
MODES = ("paper", "common", "shifted")


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """Relative deviations of an actuator from nominal, each uniform in its band."""

    resistance: float
    inductance: float
    motor_friction: float
    surface_friction: float
    back_emf: float
    back_emf_phase: tuple[float, float, float]
    inertia: float
    stiffness: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConditions:
    """Conditions of one test."""

    temperature: float
    """Winding (degC)."""
    bus: float
    """Relative change of the bus voltage."""
    load: float
    """Torque on the surface (N m)."""
    noise: float
    """Factor on the sensor noise."""
    gain: tuple[float, float, float]
    """Relative gain errors of the current sensors."""
    offset: tuple[float, float, float]
    """Offsets of the current sensors (A)."""
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class InjectedFault:
    """What is wrong: severities of the outputs, and the settings that inject it."""

    severity: Mapping[str, float] = field(default_factory=dict)
    settings: tuple[str, ...] = ()


HEALTHY = InjectedFault()


def _three(rng: np.random.Generator, bound: float) -> tuple[float, float, float]:
    a, b, c = rng.uniform(-bound, bound, 3)
    return float(a), float(b), float(c)


def draw_unit(rng: np.random.Generator) -> Unit:
    """Return a unit of the fleet."""
    r, i, m, s, j, k = rng.uniform(-0.1, 0.1, 6)
    return Unit(
        resistance=r, inductance=i, motor_friction=m, surface_friction=s, inertia=j, stiffness=k,
        back_emf=float(rng.uniform(-0.03, 0.03)), back_emf_phase=_three(rng, 0.005),
    )


def draw_conditions(rng: np.random.Generator) -> RunConditions:
    """Return conditions of one test."""
    return RunConditions(
        temperature=float(rng.uniform(-40.0, 70.0)), bus=float(rng.uniform(-0.1, 0.1)),
        load=float(rng.uniform(-19.0, 19.0)),
        noise=float(np.exp(rng.uniform(math.log(0.5), math.log(2.0)))),
        gain=_three(rng, 0.01), offset=_three(rng, 0.05), seed=int(rng.integers(2**31)),
    )


def _severity(rng: np.random.Generator, fault: str) -> float:
    low, high = SEVERITY[fault]
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


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


def actuator_of(nominal: Actuator, unit: Unit) -> Actuator:
    """Return the actuator of a unit."""
    motor, surface, shaft = nominal.motor, nominal.surface, nominal.shaft
    f_m, f_s = 1.0 + unit.motor_friction, 1.0 + unit.surface_friction
    k = motor.back_emf_constant * (1.0 + unit.back_emf)
    return nominal._replace(
        motor=motor._replace(
            back_emf_constant=k,
            back_emf_deviation_a=unit.back_emf_phase[0],
            back_emf_deviation_b=unit.back_emf_phase[1],
            back_emf_deviation_c=unit.back_emf_phase[2],
            phase_resistance=motor.phase_resistance * (1.0 + unit.resistance),
            phase_inductance=motor.phase_inductance * (1.0 + unit.inductance),
            inertia=motor.inertia * (1.0 + unit.inertia),
            dynamic_friction=motor.dynamic_friction * f_m,
            static_friction=motor.static_friction * f_m,
        ),
        surface=surface._replace(
            dynamic_friction=surface.dynamic_friction * f_s,
            static_friction=surface.static_friction * f_s,
        ),
        shaft=shaft._replace(stiffness=shaft.stiffness * (1.0 + unit.stiffness)),
    )


def effects_of(
    conditions: RunConditions, fault: InjectedFault, own: Effects | None = None
) -> Effects:
    """Return the effects of one test: those of the model, if it has any, conditions, fault."""
    c = conditions
    settings = [
        f"winding_temperature.temperature={c.temperature!r}",
        f"bus_voltage_change.change={c.bus!r}", f"surface_load.constant={c.load!r}",
        *(f"current_sensor_gain.phase_{p}={v!r}" for p, v in zip("abc", c.gain)),
        *(f"current_sensor_offset.phase_{p}={v!r}" for p, v in zip("abc", c.offset)),
        *fault.settings,
    ]
    return parse_effects(settings, own)
