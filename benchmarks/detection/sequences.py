"""Flights of units that degrade: irregular growth, wandering conditions, one seed a unit.

After the paper's test bench. Growth is a Markov chain of plateaus, slow growth and bursts with
gamma increments; conditions, sensor errors and start angle walk at random between reflecting
bounds. Nothing of the training's generator is imported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.units import UNIT_SPREAD, actuator_of
from ema_record.actuator import Actuator
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_sim.effects.settings import effects_from_mapping
from ema_sim.simulate import simulate

SEED = 31_337_001
VERSION = 1
"""Of what is drawn; another version, other flights."""
HEALTHY = "healthy"
FINAL = {
    "turn_short": (0.01, 0.15), "rotor_eccentricity": (0.01, 0.06), "motor_friction": (0.3, 1.2),
    "surface_friction": (0.4, 1.6), "backlash": (3e-4, 3e-3),
}
"""Severity that growth ends at, evenly in its logarithm."""
KINDS = (HEALTHY, *FINAL)
ONSET = (4, 26)
"""Flights between which the growth begins."""
REPAIRED = 0.2
"""Part of the units that are repaired near the end."""
STAY = (0.80, 0.85, 0.55)
"""Probability of staying on a plateau, in slow growth, in a burst from flight to flight."""
INCREMENT = (0.0, 1.0, 8.0)
"""Mean growth of a flight in each regime, in arbitrary units."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """One unit over its flights.

    Attributes
    ----------
    unit : its number; everything follows from it.
    kind : healthy, or what grows.
    detail : phase of a short, mode of an eccentricity, else empty.
    severity : ndarray, shape (n,). At each flight, 0 before the onset and after a repair.
    repair : index of the first flight after a repair, or None.
    actuator : its parameters.
    tests : settings of the effects, noise factor, seed and start angle of each flight; the
        first one is the acceptance test.
    """

    unit: int
    kind: str
    detail: str
    severity: np.ndarray
    repair: int | None
    actuator: Actuator
    tests: tuple[tuple[dict[str, float | str], float, int, float], ...]


def growth_path(rng: np.random.Generator, flights: int) -> np.ndarray:
    """Return irregular growth from 0 to 1 over `flights`, shape (flights,)."""
    onset = int(rng.integers(*ONSET)) * flights // 60
    regime = 1
    steps = np.zeros(flights)
    for flight in range(onset, flights):
        if rng.uniform() > STAY[regime]:
            regime = (regime + int(rng.integers(1, 3))) % 3
        if INCREMENT[regime] > 0.0:
            steps[flight] = INCREMENT[regime] * rng.gamma(2.0, 0.5)
    steps[onset] = max(steps[onset], 0.1)
    path = np.cumsum(steps)
    return path / path[-1]


def walk(rng: np.random.Generator, flights: int, low: float, high: float, part: float
         ) -> np.ndarray:
    """Return a random walk between reflecting bounds, shape (flights,).

    Parameters
    ----------
    rng, flights : source of the steps, their number.
    low, high : bounds.
    part : deviation of a step, as a part of the span.
    """
    start = rng.uniform(0.0, 1.0)
    free = start + np.cumsum(part * rng.standard_normal(flights))
    folded = np.abs(np.mod(free, 2.0) - 1.0)
    return low + (high - low) * folded


def draw_unit(rng: np.random.Generator) -> Actuator:
    """Return a unit of the fleet: each parameter uniform within its tolerance."""

    def near(name: str) -> float:
        return float(rng.uniform(-UNIT_SPREAD[name], UNIT_SPREAD[name]))

    # In this order: the flights of a unit follow from it.
    return actuator_of({name: near(name) for name in (
        "motor_friction", "surface_friction", "back_emf_a", "back_emf_b", "back_emf_c",
        "phase_resistance", "phase_inductance", "back_emf_constant", "motor_inertia",
        "stiffness")})


def fault_settings(rng: np.random.Generator, kind: str) -> tuple[dict[str, float | str], str]:
    """Return the settings of a fault, `x` for its severity, and its phase or mode."""
    if kind == "turn_short":
        phase = "abc"[rng.integers(3)]
        mode = ("paper", "physical")[rng.integers(2)]
        return {"turn_short.fraction": "x", "turn_short.phase": phase,
                "turn_short.mode": mode}, phase
    if kind == "rotor_eccentricity":
        mode = ("paper", "common", "shifted")[rng.integers(3)]
        return {"rotor_eccentricity.zeta": "x", "rotor_eccentricity.mode": mode,
                "rotor_eccentricity.angle": float(rng.uniform(-math.pi, math.pi)),
                "rotor_eccentricity.phase": "abc"[rng.integers(3)]}, mode
    return ({} if kind == HEALTHY else {f"{kind}.increase": "x"}), ""


def draw_course(unit: int, flights: int = 60) -> Course:
    """Return the course of a unit; kinds take turns."""
    rng = np.random.default_rng([SEED, VERSION, unit, flights])
    kind = KINDS[unit % len(KINDS)]
    actuator = draw_unit(rng)
    settings, detail = fault_settings(rng, kind)
    severity, repair = np.zeros(flights), None
    if kind != HEALTHY:
        low, high = np.log(FINAL[kind])
        if rng.uniform() < REPAIRED:
            repair = int(rng.integers(round(0.75 * flights), round(0.92 * flights)))
        final = float(np.exp(rng.uniform(low, high)))
        severity[:repair] = final * growth_path(rng, flights)[:repair]
        severity *= final / severity.max()
    tests = _tests(rng, settings, np.concatenate([[0.0], severity]))
    return Course(unit=unit, kind=kind, detail=detail, severity=severity, repair=repair,
                  actuator=actuator, tests=tests)


def _tests(
    rng: np.random.Generator, settings: dict[str, float | str], severity: np.ndarray
) -> tuple[tuple[dict[str, float | str], float, int, float], ...]:
    n = len(severity)
    wandering = {
        "winding_temperature.temperature": walk(rng, n, -40.0, 70.0, 0.08),
        "bus_voltage_change.change": walk(rng, n, -0.1, 0.1, 0.10),
        "surface_load.constant": walk(rng, n, -19.0, 19.0, 0.15),
        **{f"current_sensor_gain.phase_{p}": walk(rng, n, -0.01, 0.01, 0.03) for p in "abc"},
        **{f"current_sensor_offset.phase_{p}": walk(rng, n, -0.05, 0.05, 0.05) for p in "abc"},
    }
    noise = np.exp2(walk(rng, n, -1.0, 1.0, 0.10))
    angle = np.mod(rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(rng.normal(0.0, 0.8, n)),
                   2.0 * np.pi)
    sign = -1.0 if "rotor_eccentricity.zeta" in settings and rng.uniform() < 0.5 else 1.0
    tests = []
    for k in range(n):
        effects: dict[str, float | str] = {
            name: float(values[k]) for name, values in wandering.items()
        }
        if severity[k] > 0.0:
            x = sign * float(severity[k])
            effects |= {name: x if value == "x" else value for name, value in settings.items()}
        tests.append((effects, float(noise[k]), int(rng.integers(1 << 31)), float(angle[k])))
    return tuple(tests)


def record_of(course: Course, test: int, *, start_time: int = 0) -> Record:
    """Simulate a test of a unit; 0 is the acceptance test, then the flights from 1."""
    effects, noise, seed, angle = course.tests[test]
    return simulate(
        load_profile("extended"), actuator=course.actuator, effects=effects_from_mapping(effects),
        seed=seed, noise=noise, start_angle=angle, serial_number=f"UNIT-{course.unit:04d}",
        start_time=start_time,
    )
