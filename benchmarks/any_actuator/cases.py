"""The tests of a fleet: healthy units, faults, strangers and sensor faults, drawn by seed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.any_actuator.described import Damage
from benchmarks.any_actuator.physics import COPPER
from benchmarks.any_actuator.records import BenchTest
from benchmarks.any_actuator.units import draw_test
from ema_record.actuator import FOC, Actuator
from ema_record.kit import VALIDATION
from ema_record.spread import TypeSpread

CLASS = {"turn_short": "turn_short", "rotor_eccentricity": "rotor_eccentricity",
         "motor_friction": "friction", "surface_friction": "friction", "backlash": "backlash"}
"""Class of each group of faults."""
FRICTIONS = ("motor_friction", "surface_friction")
STRANGERS = ("cogging", "demagnetisation", "sag", "resistance", "hall", "mesh")
SENSOR_FAULTS = ("current_offset", "current_gain", "speed_gain", "slip")
ACCEPTANCE, TEST = 1, 2
"""Fleets: those that a kit is made from, and those that it is judged on."""
EVENT = 0.4
"""When a sensor fails, of the length of the test."""
LARGEST = 3.0
"""Severity of a fault, whatever a kit says."""
TORQUE = 0.9
"""Part of the motor's torque that a friction may need: what a machine cannot turn is no test."""


class Counts(NamedTuple):
    """Tests of a fleet."""

    units: int
    healthy: int
    each_fault: int
    strangers: int
    sensor_faults: int


class BenchCase(NamedTuple):
    """One test and what is true of it."""

    key: str
    group: str
    """healthy, a key of `CLASS`, stranger or sensor."""
    detail: str
    size: float
    phase: str | None
    test: BenchTest


def usual_sizes(a: Actuator) -> dict[str, float]:
    """Return severities that any kit should find with ease, where it does not say better."""
    return {"turn_short": 0.03, "rotor_eccentricity": 0.02, "motor_friction": 1.0,
            "surface_friction": 1.0, "backlash": 2.0 * a.shaft.backlash}


def sizes_of(a: Actuator, kit: Path | None, times: float = 2.0) -> dict[str, float]:
    """Return `times` the a90 of each fault that the kit itself gives, the usual where none."""
    sizes = usual_sizes(a)
    file = None if kit is None else kit / VALIDATION
    if file is None or not file.is_file():
        return sizes
    found = json.loads(file.read_text(encoding="utf-8"))
    views = found.get("held_out", {}).get(found.get("profile"), {}).get("fleet", {})
    for group, name in CLASS.items():
        value = (views.get(name) or {}).get("a90")
        if value is not None:
            sizes[group] = min(times * float(value), LARGEST)
    return sizes


def _damage(name: str, size: float, **more: Any) -> Damage:
    fields: dict[str, Any] = {name: size, **more}
    return Damage(**fields)


def _fault(group: str, size: float, rng: np.random.Generator) -> tuple[Damage, str, str | None]:
    """Return a fault, its mode and its phase."""
    if group == "turn_short":
        phase = int(rng.integers(3))
        return Damage(short=size, phase=phase), "", "abc"[phase]
    if group == "rotor_eccentricity":
        shifted = bool(rng.integers(2))
        return Damage(eccentricity=size, shifted=shifted, angle=float(rng.uniform(-3.1, 3.1))), (
            "shifted" if shifted else "common"), None
    return _damage(group, size), "", None


def _stranger(a: Actuator, name: str, rng: np.random.Generator) -> Damage:
    """Return something that is no fault of the catalogue, in proportion to the machine."""
    m, x = a.motor, a.surface
    speed, slew = a.control.speed_limit, a.slew_speed
    power = speed * (m.dynamic_friction + m.viscous_friction * speed) + slew * (
        x.dynamic_friction + x.viscous_friction * slew)
    size = {
        "cogging": 0.15 * m.dynamic_friction, "demagnetisation": 0.15,
        "sag": 0.05 * (2.0 * a.inverter.bus_voltage) ** 2 / power, "resistance": 0.5,
        "hall": 0.1, "mesh": 0.2 * x.dynamic_friction / a.shaft.stiffness,
    }[name]
    return _damage(name, size, phase=int(rng.integers(3)))


def turnable(test: BenchTest, group: str) -> float:
    """Return by how much dry friction of a group may grow before this unit no longer slews.

    What current limit and voltage give at full speed, the winding as warm as it is.
    """
    a, now = test.actuator, test.surroundings
    m, x, ratio, speed = a.motor, a.surface, a.gear.ratio, a.control.speed_limit
    resistance = m.phase_resistance * (1.0 + COPPER * (now.temperature - 20.0))
    left = a.inverter.bus_voltage * (1.0 + now.bus) - m.back_emf_constant * speed
    constant = (1.5 if a.drive.kind == FOC else 2.0) * m.back_emf_constant
    most = TORQUE * constant * min(a.inverter.current_limit, left / resistance)
    viscous = speed * (m.viscous_friction + x.viscous_friction / ratio**2)
    dry = {"motor_friction": m.static_friction, "surface_friction": x.static_friction / ratio}
    return (most - viscous - abs(now.load) / ratio - sum(dry.values())) / dry[group]


def _sensor_fault(a: Actuator, name: str, duration: float, rng: np.random.Generator) -> Damage:
    size = {"current_offset": 0.1 * a.inverter.current_limit, "current_gain": 0.1,
            "speed_gain": 0.05, "slip": 0.02 * a.surface.end_stop}[name]
    recorded = 3 if a.acquisition.phase_current_c else 2
    return _damage(name, size, phase=int(rng.integers(recorded)), event=EVENT * duration)


def draw_cases(
    a: Actuator, spread: TypeSpread, counts: Counts, sizes: Mapping[str, float], *,
    seed: int, fleet: int, duration: float, own: bool,
) -> list[BenchCase]:
    """Return the tests of a fleet in a fixed order; each is drawn from its own seed.

    Parameters
    ----------
    a, spread : the type.
    counts : how many of each.
    sizes : severity of each group of faults; of a friction at most what the unit can turn.
    seed, fleet : of everything; fleets share no unit.
    duration : of the test (s).
    own : whether units have effects that the product's simulator does not know.
    """
    plan = [("healthy", counts.healthy), *((group, counts.each_fault) for group in CLASS),
            ("stranger", counts.strangers), ("sensor", counts.sensor_faults)]
    cases = []
    for kind, (group, count) in enumerate(plan):
        for n in range(count):
            rng = np.random.default_rng([seed, fleet, kind, n])
            detail, phase, size, damage = "", None, 0.0, Damage()
            if group in CLASS:
                size = sizes[group]
                damage, detail, phase = _fault(group, size, rng)
            elif group == "stranger":
                detail = STRANGERS[n % len(STRANGERS)]
                damage = _stranger(a, detail, rng)
            elif group == "sensor":
                detail = SENSOR_FAULTS[n % len(SENSOR_FAULTS)]
                damage = _sensor_fault(a, detail, duration, rng)
            test = draw_test(a, spread.tolerances, spread.conditions,
                             (10 * seed + fleet, n % counts.units), 1000 * kind + n, damage,
                             own=own)
            if group in FRICTIONS:
                size = min(size, turnable(test, group))
                test = test._replace(damage=_damage(group, size))
            cases.append(BenchCase(f"{group}-{n:03d}", group, detail, size, phase, test))
    return cases
