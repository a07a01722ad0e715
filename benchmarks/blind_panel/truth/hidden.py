"""What is hidden: effects of the catalogue, their sizes, which of them look alike."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

Setting = dict[str, float | str]
JITTER = 1.25
"""A size is multiplied by a factor between 1/JITTER and JITTER, even in the logarithm."""


def _angle(rng: np.random.Generator) -> float:
    return float(rng.uniform(-math.pi, math.pi))


def _phase(rng: np.random.Generator) -> str:
    return "abc"[rng.integers(3)]


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.uniform() < 0.5 else -1.0


def _turn_short(x: float, rng: np.random.Generator) -> Setting:
    return {"turn_short.fraction": x, "turn_short.phase": _phase(rng)}


def _eccentricity(x: float, rng: np.random.Generator) -> Setting:
    mode = ("paper", "common", "shifted", "static")[rng.integers(4)]
    return {"rotor_eccentricity.zeta": x * _sign(rng), "rotor_eccentricity.mode": mode,
            "rotor_eccentricity.angle": _angle(rng), "rotor_eccentricity.phase": _phase(rng)}


def _back_emf_shape(x: float, rng: np.random.Generator) -> Setting:
    if rng.uniform() < 0.5:
        return {"back_emf_shape.fifth_harmonic": x * _sign(rng)}
    return {"back_emf_shape.flat_top_change": -4.0 * x}


def _cogging(x: float, rng: np.random.Generator) -> Setting:
    return {"cogging_torque.amplitude": x, "cogging_torque.phase": _angle(rng),
            "cogging_torque.periods": float(rng.choice([4, 6, 9, 12, 18, 24]))}


def _mesh(x: float, rng: np.random.Generator) -> Setting:
    return {"gear_mesh_ripple.amplitude": x, "gear_mesh_ripple.phase": _angle(rng),
            "gear_mesh_ripple.periods": float(rng.choice([13, 17, 23]))}


def _resistance(x: float, rng: np.random.Generator) -> Setting:
    return {"phase_resistance_imbalance.increase": x,
            "phase_resistance_imbalance.phase": _phase(rng)}


def _inertia(x: float, rng: np.random.Generator) -> Setting:
    if rng.uniform() < 0.5:
        return {"inertia_change.motor": x}
    return {"inertia_change.surface": 5.0 * x}


def _load(x: float, rng: np.random.Generator) -> Setting:
    if rng.uniform() < 0.5:
        return {"surface_load.constant": x * _sign(rng)}
    return {"surface_load.slope": 3.0 * x * _sign(rng)}


def _run_out(x: float, rng: np.random.Generator) -> Setting:
    return {"speed_sensor_runout.amplitude": x, "speed_sensor_runout.angle": _angle(rng)}


def _stribeck(x: float, rng: np.random.Generator) -> Setting:
    return {"stribeck_friction.increase": x, "stribeck_friction.speed": float(
        math.exp(rng.uniform(math.log(10.0), math.log(60.0))))}


def _plain(name: str, *, signed: bool = False) -> Callable[[float, np.random.Generator], Setting]:
    def setting(x: float, rng: np.random.Generator) -> Setting:
        return {name: x * _sign(rng) if signed else x}
    return setting


@dataclass(frozen=True, slots=True)
class Hideable:
    """One effect of the catalogue: its sizes (unit of its severity), how it is drawn."""

    sizes: tuple[float, float, float]
    """Small, medium, large; units have the last two."""
    draw: Callable[[float, np.random.Generator], Setting]
    without: tuple[str, ...] | None = None
    """Entries to hide so that it is outside the catalogue; None: not used as a stranger."""


HIDEABLE: dict[str, Hideable] = {
    "turn_short": Hideable(
        (0.01, 0.03, 0.1), _turn_short,
        ("turn_short", "rotor_eccentricity", "phase_resistance_imbalance")),
    "rotor_eccentricity": Hideable(
        (0.01, 0.03, 0.1), _eccentricity,
        ("rotor_eccentricity", "turn_short", "speed_sensor_runout")),
    "back_emf_shape": Hideable((0.02, 0.05, 0.12), _back_emf_shape, ("back_emf_shape",)),
    "torque_constant_drop": Hideable((0.08, 0.15, 0.3), _plain("torque_constant_drop.drop")),
    "phase_resistance_imbalance": Hideable((0.15, 0.4, 1.0), _resistance),
    "magnetic_saturation": Hideable(
        (0.01, 0.02, 0.05), _plain("magnetic_saturation.inverse_current"),
        ("magnetic_saturation", "torque_constant_drop")),
    "hall_misalignment": Hideable(
        (0.04, 0.08, 0.15), _plain("hall_misalignment.angle", signed=True),
        ("hall_misalignment",)),
    "control_delay": Hideable((1e-4, 3e-4, 6e-4), _plain("control_delay.delay"),
                              ("control_delay",)),
    "cogging_torque": Hideable((0.01, 0.03, 0.1), _cogging,
                               ("cogging_torque", "gear_mesh_ripple")),
    "motor_friction": Hideable((0.3, 0.6, 1.2), _plain("motor_friction.increase")),
    "surface_friction": Hideable((0.3, 0.6, 1.2), _plain("surface_friction.increase")),
    "viscous_friction": Hideable((5e-5, 1.5e-4, 4e-4), _plain("viscous_friction.coefficient")),
    "stribeck_friction": Hideable((0.2, 0.4, 0.8), _stribeck, ("stribeck_friction",)),
    "load_dependent_friction": Hideable((0.1, 0.25, 0.5),
                                        _plain("load_dependent_friction.coefficient")),
    "backlash": Hideable((3e-4, 1e-3, 3e-3), _plain("backlash.increase"),
                         ("backlash", "shaft_compliance")),
    "shaft_compliance": Hideable((0.5, 1.0, 3.0), _plain("shaft_compliance.increase"),
                                 ("shaft_compliance", "backlash")),
    "gear_mesh_ripple": Hideable((5e-6, 1e-5, 3e-5), _mesh,
                                 ("gear_mesh_ripple", "cogging_torque")),
    "inverter_voltage_drop": Hideable((1.5, 3.0, 6.0), _plain("inverter_voltage_drop.drop")),
    "speed_sensor_runout": Hideable((0.002, 0.005, 0.02), _run_out,
                                    ("speed_sensor_runout", "rotor_eccentricity")),
    "inertia_change": Hideable((0.2, 0.5, 1.2), _inertia),
    "surface_load": Hideable((35.0, 70.0, 150.0), _load),
}
"""Not among them: what the aircraft measures (bus voltage, sag, temperature), lost bits, and
three sensor errors that a glance at the current sum or at standstill gives away."""


def draw_effect(name: str, size: int, rng: np.random.Generator) -> Setting:
    """Return settings of an effect; `size`: place in its three sizes."""
    factor = math.exp(rng.uniform(-math.log(JITTER), math.log(JITTER)))
    return HIDEABLE[name].draw(HIDEABLE[name].sizes[size] * factor, rng)


HARD_TO_TELL = (
    {"viscous_friction", "surface_friction", "motor_friction", "torque_constant_drop",
     "load_dependent_friction", "stribeck_friction", "surface_load", "inverter_voltage_drop"},
    {"rotor_eccentricity", "speed_sensor_runout", "turn_short", "phase_resistance_imbalance"},
    {"shaft_compliance", "backlash"}, {"cogging_torque", "gear_mesh_ripple"},
)
"""Families whose members look alike: no pair of two effects is drawn from within one."""


def draw_pair(
    rng: np.random.Generator, names: Sequence[str] = tuple(HIDEABLE)
) -> tuple[str, str]:
    """Return two effects that are not of one family."""
    while True:
        first, second = (names[i] for i in rng.choice(len(names), 2, replace=False))
        if not any({first, second} <= family for family in HARD_TO_TELL):
            return first, second
