"""The catalogue as candidates: every effect in the variants that can be named.

Each variant has the coordinates that the data must tell. A coordinate is a number that is zero
where the effect is absent and in which the features change nearly in proportion: a severity, or
the cosine and sine parts of an amplitude with a phase. What is no ratio is sized by the actuator's
own scales (`variants`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ema_record.actuator import Actuator, load_actuator
from ema_sim.effects import EFFECTS, Effects
from ema_sim.effects.base import Quantity

Settings = Mapping[str, float | int]
DIGITS = 2
"""Significant digits of a size."""
LARGEST_DELAY = 0.8
"""rad of the electrical turn at the highest speed; beyond, a delay turns the torque around."""

OF_THE_ROTOR = frozenset({
    "rotor_eccentricity", "cogging_torque", "gear_mesh_ripple", "speed_sensor_runout"})
"""Effects that know the mechanical angle, of which a record tells the part of a pole pair."""


def sizes(scale: float, *shares: float) -> tuple[float, ...]:
    """Return shares of a scale, rounded to `DIGITS` digits."""
    return tuple(float(f"{scale * share:.{DIGITS}g}") for share in shares)


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """One way in which an effect of the catalogue may be present.

    Attributes
    ----------
    name : unique, for example ``turn_short b physical``.
    effect : name in the catalogue.
    levels : for each coordinate the values at which the library simulates it.
    settings : parameters of the effect from the coordinates.
    low, high : bounds of each coordinate.
    """

    name: str
    effect: str
    levels: tuple[tuple[float, ...], ...]
    settings: Callable[[np.ndarray], Settings]
    low: tuple[float, ...]
    high: tuple[float, ...]
    condition: str = ""
    """Of a record: the effect is no candidate where the record measures it."""

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return len(self.levels)

    def effects(self, u: np.ndarray, base: Effects) -> Effects:
        """Return `base` with the effect at the coordinates `u`, shape (size,)."""
        kinds = {f.name: f.kind for f in EFFECTS[self.effect].fields}
        moved = {name: float(np.clip(value, kind.lower, kind.upper))
                 if isinstance(kind := kinds[name], Quantity) else int(value)
                 for name, value in self.settings(u).items()}
        return base._replace(**{self.effect: getattr(base, self.effect)._replace(**moved)})


@dataclass(frozen=True, slots=True, kw_only=True)
class Signature:
    """Features that a variant adds, along each of its coordinates, straight between levels.

    Attributes
    ----------
    variant : what it is.
    levels : for each coordinate, sorted, with 0 among them.
    values : for each coordinate, ndarray of shape (levels, d).
    """

    variant: Variant
    levels: tuple[np.ndarray, ...]
    values: tuple[np.ndarray, ...]

    def at(self, u: np.ndarray) -> np.ndarray:
        """Return the added features at coordinates `u`, shape (d,)."""
        total = np.zeros(self.values[0].shape[1])
        for x, levels, values in zip(u, self.levels, self.values):
            if len(levels) > 1:
                k = _interval(float(x), levels)
                part = (x - levels[k]) / (levels[k + 1] - levels[k])
                total += values[k] + part * (values[k + 1] - values[k])
        return total

    def slope(self, u: np.ndarray) -> np.ndarray:
        """Return the derivative to the coordinates, shape (d, size); zero where unknown."""
        found = np.zeros((self.values[0].shape[1], len(u)))
        for k, (x, levels, values) in enumerate(zip(u, self.levels, self.values)):
            if len(levels) > 1:
                place = _interval(float(x), levels)
                found[:, k] = (values[place + 1] - values[place]) / (
                    levels[place + 1] - levels[place])
        return found


def _interval(x: float, levels: np.ndarray) -> int:
    return int(np.clip(np.searchsorted(levels, x) - 1, 0, len(levels) - 2))


def _both(*levels: float) -> tuple[float, ...]:
    return (*(-x for x in reversed(levels)), *levels)


def _bounded(kind: Quantity, levels: Sequence[float], neutral: float = 0.0
             ) -> tuple[float, ...]:
    """Return coordinates (beside `neutral`) that an effect may have, others at its bounds."""
    low, high = kind.lower - neutral, kind.upper - neutral
    return tuple(x for x in dict.fromkeys(min(max(x, low), high) for x in levels) if x != 0.0)


def _one(
    effect: str, parameter: str, levels: Sequence[float], *, label: str = "", condition: str = "",
    neutral: float = 0.0, **others: float,
) -> Variant:
    """Return a variant with one severity."""
    kind = {f.name: f.kind for f in EFFECTS[effect].fields}[parameter]
    assert isinstance(kind, Quantity)
    return Variant(
        name=f"{effect} {label}".strip(), effect=effect,
        levels=(_bounded(kind, levels, neutral),),
        settings=lambda u: {parameter: neutral + float(u[0]), **others},
        low=(kind.lower - neutral,), high=(kind.upper - neutral,),
        condition=condition,
    )


def _many(effect: str, levels: Mapping[str, Sequence[float]]) -> Variant:
    """Return a variant with several severities."""
    kinds = {f.name: f.kind for f in EFFECTS[effect].fields if isinstance(f.kind, Quantity)}
    bounds = [kinds[name] for name in levels]
    return Variant(
        name=effect, effect=effect,
        levels=tuple(_bounded(kinds[n], levels[n]) for n in levels),
        settings=lambda u: dict(zip(levels, map(float, u))),
        low=tuple(b.lower for b in bounds), high=tuple(b.upper for b in bounds),
    )


def _vector(
    effect: str, amplitude: str, angle: str, levels: Sequence[float], *, label: str = "",
    quarter: float = 0.0, **others: float,
) -> Variant:
    """Return a variant with an amplitude and a phase, as its cosine and sine parts.

    `quarter` is the phase at which the parameter `angle` has a cosine (π/2 for laws in sine).
    """
    kind = {f.name: f.kind for f in EFFECTS[effect].fields}[amplitude]
    assert isinstance(kind, Quantity)
    return Variant(
        name=f"{effect} {label}".strip(), effect=effect,
        levels=(_both(*_bounded(kind, levels)),) * 2,
        settings=lambda u: {
            amplitude: math.hypot(u[0], u[1]), **others,
            angle: math.remainder(quarter + math.atan2(u[1], u[0]), 2.0 * math.pi)},
        low=(-kind.upper,) * 2, high=(kind.upper,) * 2,
    )


def ripple(effect: str, periods: float, *levels: float) -> Variant:
    """Return cogging or mesh ripple of `periods` a turn, of such amplitudes."""
    return _vector(effect, "amplitude", "phase", levels, label=f"{periods:g} a turn",
                   quarter=0.5 * math.pi, periods=periods)


def _stribeck(speed: float, slowest: float, fastest: float) -> Variant:
    return Variant(
        name=f"stribeck_friction at {speed:g} rad/s", effect="stribeck_friction",
        levels=((-0.4, -0.1, 0.1, 0.4, 1.2), ()),
        settings=lambda u: {"increase": float(u[0]), "speed": speed * math.exp(float(u[1]))},
        low=(-0.5, math.log(slowest / speed)), high=(3.0, math.log(fastest / speed)),
    )


def variants(actuator: Actuator | None = None) -> tuple[Variant, ...]:
    """Return all candidates for an actuator, default the present kit's."""
    a = load_actuator() if actuator is None else actuator
    torque = a.friction_torque  # dry, at the motor (N m)
    surface_torque = a.gear.ratio * torque
    speed = a.control.speed_limit  # of the motor (rad/s)
    turn = 1.0 / (a.motor.pole_pairs * speed)  # electrical radian at that speed (s)
    travel = a.wind_up / a.gear.ratio  # until a surface at rest starts, at the surface (rad)
    voltage = a.inverter.bus_voltage  # between a rail and the middle (V)
    current = a.inverter.current_limit  # (A)
    found: list[Variant] = []
    slowest, fastest = sizes(speed, 6.3e-4, 0.63)
    for k, phase in enumerate("abc"):
        for mode, text in ((1, "physical"), (0, "paper")):
            found.append(_one("turn_short", "fraction", (0.01, 0.04, 0.15, 0.4),
                              label=f"{phase} {text}", phase=k, mode=mode))
        found.append(_one("phase_resistance_imbalance", "increase",
                          (-0.3, -0.08, 0.08, 0.3, 1.0, 2.5), label=phase, phase=k))
        found.append(_vector("rotor_eccentricity", "zeta", "angle", (0.01, 0.05, 0.2),
                             label=f"paper {phase}", mode=0, phase=k))
    for mode, text in ((1, "common"), (2, "shifted"), (3, "static")):
        found.append(_vector("rotor_eccentricity", "zeta", "angle", (0.01, 0.05, 0.2), label=text,
                             mode=mode))
    found += [
        _one("back_emf_shape", "flat_top_change", _both(0.05, 0.2, 0.6), label="flat top"),
        _one("back_emf_shape", "fifth_harmonic", _both(0.01, 0.05, 0.2), label="5th harmonic"),
        _one("back_emf_shape", "sine_share", (0.05, 0.2, 0.5, 1.0), label="sine"),
        _one("torque_constant_drop", "drop", (-0.3, -0.1, 0.05, 0.15, 0.3)),
        _one("winding_temperature", "temperature", (-50.0, -20.0, 20.0, 60.0, 120.0),
             neutral=20.0, condition="temperature"),
        _one("magnetic_saturation", "inverse_current",
             sizes(1.0 / current, 0.22, 0.44, 0.88, 1.76)),
        _one("hall_misalignment", "angle", _both(0.02, 0.1, 0.3)),
        _one("control_delay", "delay", sizes(turn, 0.024, 0.079, 0.24, LARGEST_DELAY)),
        ripple("cogging_torque", 12.0, *sizes(torque, 0.012, 0.048, 0.19)),
        _one("motor_friction", "increase", (-0.4, -0.15, 0.15, 0.4, 1.0)),
        _one("surface_friction", "increase", (-0.4, -0.15, 0.15, 0.4, 1.0, 2.0)),
        _one("viscous_friction", "coefficient", (
            -a.motor.viscous_friction, *sizes(torque / speed, 0.094, 0.38, 0.94, 1.9))),
        *(_stribeck(x, slowest, fastest) for x in sizes(speed, 6.3e-3, 0.025, 0.126)),
        _one("load_dependent_friction", "coefficient", (0.03, 0.1, 0.3, 0.6)),
        _one("backlash", "increase", (
            -a.shaft.backlash, *sizes(travel, 0.1, 0.3, 1.0, 3.0, 8.0))),
        _one("shaft_compliance", "increase", (-0.5, -0.2, 0.2, 0.6, 2.0, 6.0)),
        ripple("gear_mesh_ripple", 17.0, *sizes(travel, 0.003, 0.015, 0.06)),
        _one("inverter_voltage_drop", "drop", sizes(voltage, 0.0104, 0.031, 0.083, 0.167)),
        _one("bus_voltage_sag", "resistance",
             sizes(2.0 * voltage / current, 0.0115, 0.046, 0.137, 0.344)),
        _one("bus_voltage_change", "change", _both(0.1, 0.3), condition="bus"),
        _many("current_sensor_offset", {
            f"phase_{p}": _both(*sizes(current, 0.00455, 0.0227, 0.091)) for p in "abc"}),
        _many("current_sensor_gain", {f"phase_{p}": _both(0.02, 0.08, 0.25) for p in "abc"}),
        _vector("speed_sensor_runout", "amplitude", "angle", (0.002, 0.01, 0.05)),
        _one("position_sensor_offset", "offset", _both(*sizes(travel, 0.5, 5.0, 50.0))),
        _one("quantisation", "position_bits_lost", (1.0, 2.0, 3.0, 5.0), label="position"),
        _one("quantisation", "speed_bits_lost", (1.0, 2.0, 3.0, 5.0), label="speed"),
        _one("inertia_change", "motor", (-0.4, -0.15, 0.15, 0.5, 1.5), label="motor"),
        _one("inertia_change", "surface", (-0.5, 0.5, 2.0, 6.0, 15.0), label="surface"),
        _many("surface_load", {
            "constant": _both(*sizes(surface_torque, 0.19, 0.57, 1.43)),
            "slope": _both(*sizes(surface_torque / a.surface.end_stop, 0.286, 1.14, 3.43))}),
    ]
    return tuple(found)
