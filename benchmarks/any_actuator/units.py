"""Units of a type and their tests: every parameter drawn, also those that no file lists.

Two seeds never share a number; nothing of the training's generator is imported.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.any_actuator.described import Damage, Own, Surroundings
from benchmarks.any_actuator.records import BenchTest
from ema_record.actuator import RELAY, TRAPEZOID, Actuator
from ema_record.spread import Conditions, UnitTolerances

SURFACE_INERTIA, CURRENT_GAIN, HARMONIC = 0.10, 0.10, 0.01
"""Half widths that no file states: relative, of the gains of the current control too; absolute
for the harmonics."""
ROUNDING, DEAD_TIME, DRIFT = 0.10, (0.2e-6, 1.0e-6), 2e-3
"""Largest blur of the back-EMF's edges (rad), dead time (s), drift of a current sensor (of the
current limit in ten seconds)."""

DRY, VISCOUS = 1.3, 1.5
"""Factors by which a type's dry and viscous friction are other than described: no data sheet of a
motor gives that of the gear and the bearings."""
STIFFNESS, DAMPING, LOST_MOTION = 0.20, 0.30, 0.30
CONSTANT, RESISTANCE, INDUCTANCE, INERTIA = 0.03, 0.05, 0.10, 0.05
"""Half widths of what a type is off its description beside these, relative."""


class _Draw:
    """Draws of one type, unit or test."""

    def __init__(self, *seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def even(self, low: float, high: float) -> float:
        return float(self._rng.uniform(low, high))

    def near(self, half: float) -> float:
        """Return a factor within 1 ± half."""
        return 1.0 + self.even(-half, half)

    def factor(self, most: float) -> float:
        """Return a factor from 1 / most to most, even in its logarithm."""
        return math.exp(self.even(-math.log(most), math.log(most)))

    def three(self, half: float) -> tuple[float, float, float]:
        return self.even(-half, half), self.even(-half, half), self.even(-half, half)


def draw_type(a: Actuator, seed: tuple[int, ...]) -> Actuator:
    """Return the type as it is built, which its description misses by what such papers do."""
    d = _Draw(*seed, 4)
    m, x = a.motor, a.surface
    dry, dry_x = d.factor(DRY), d.factor(DRY)
    motor = m._replace(
        phase_resistance=m.phase_resistance * d.near(RESISTANCE),
        phase_inductance=m.phase_inductance * d.near(INDUCTANCE),
        back_emf_constant=m.back_emf_constant * d.near(CONSTANT),
        inertia=m.inertia * d.near(INERTIA),
        viscous_friction=m.viscous_friction * d.factor(VISCOUS),
        dynamic_friction=m.dynamic_friction * dry, static_friction=m.static_friction * dry)
    surface = x._replace(
        viscous_friction=x.viscous_friction * d.factor(VISCOUS),
        dynamic_friction=x.dynamic_friction * dry_x, static_friction=x.static_friction * dry_x)
    shaft = a.shaft._replace(
        stiffness=a.shaft.stiffness * d.near(STIFFNESS),
        damping=a.shaft.damping * d.near(DAMPING),
        backlash=a.shaft.backlash * d.near(LOST_MOTION))
    return a._replace(motor=motor, surface=surface, shaft=shaft)


def draw_unit(a: Actuator, t: UnitTolerances, seed: tuple[int, ...]) -> Actuator:
    """Return a unit of the type: every parameter within the band of real ones."""
    d = _Draw(*seed, 0)
    m, x, c = a.motor, a.surface, a.control
    dry, dry_x = d.near(t.motor_friction), d.near(t.surface_friction)
    own_k = d.three(t.back_emf_phase)
    if m.back_emf == TRAPEZOID:
        m = m._replace(flat_top=m.flat_top + d.even(-t.flat_top, t.flat_top))
    else:
        m = m._replace(harmonic_3=m.harmonic_3 + d.even(-HARMONIC, HARMONIC),
                       harmonic_5=m.harmonic_5 + d.even(-HARMONIC, HARMONIC),
                       harmonic_7=m.harmonic_7 + d.even(-HARMONIC, HARMONIC))
    motor = m._replace(
        phase_resistance=m.phase_resistance * d.near(t.resistance),
        phase_inductance=m.phase_inductance * d.near(t.inductance),
        back_emf_constant=m.back_emf_constant * d.near(t.back_emf),
        back_emf_deviation_a=own_k[0], back_emf_deviation_b=own_k[1],
        back_emf_deviation_c=own_k[2], inertia=m.inertia * d.near(t.inertia),
        viscous_friction=m.viscous_friction * d.factor(t.viscous_factor),
        dynamic_friction=m.dynamic_friction * dry,
        static_friction=max(m.static_friction * dry * d.near(t.static_ratio),
                            m.dynamic_friction * dry))
    surface = x._replace(
        inertia=x.inertia * d.near(SURFACE_INERTIA),
        viscous_friction=x.viscous_friction * d.factor(t.viscous_factor),
        dynamic_friction=x.dynamic_friction * dry_x,
        static_friction=max(x.static_friction * dry_x * d.near(t.static_ratio),
                            x.dynamic_friction * dry_x))
    shaft = a.shaft._replace(
        stiffness=a.shaft.stiffness * d.near(t.stiffness),
        damping=a.shaft.damping * d.near(t.damping),
        backlash=a.shaft.backlash * d.near(t.backlash))
    control = c._replace(
        position_gain=c.position_gain * d.near(t.control_gain),
        proportional_gain=c.proportional_gain * d.near(t.control_gain),
        integral_gain=c.integral_gain * d.near(t.control_gain))
    drive = a.drive._replace(
        proportional_gain=a.drive.proportional_gain * d.near(CURRENT_GAIN),
        integral_gain=a.drive.integral_gain * d.near(CURRENT_GAIN))
    return a._replace(
        motor=motor, surface=surface, shaft=shaft, control=control, drive=drive,
        inverter=a.inverter._replace(hysteresis=a.inverter.hysteresis * d.near(t.hysteresis)),
        acquisition=a.acquisition._replace(
            command_latency=a.acquisition.command_latency + d.even(0.0, t.latency),
            reference_latency=a.acquisition.reference_latency + d.even(0.0, t.latency)))


def draw_own(a: Actuator, seed: tuple[int, ...]) -> Own:
    """Return what the unit has and no description knows."""
    d = _Draw(*seed, 1)
    drift = 0.1 * DRIFT * a.inverter.current_limit
    return Own(rounding=d.even(0.0, ROUNDING), offset_drift=d.three(drift),
               dead_time=0.0 if a.drive.kind == RELAY else d.even(*DEAD_TIME))


def draw_surroundings(c: Conditions, seed: tuple[int, ...]) -> Surroundings:
    """Return conditions of one test."""
    d = _Draw(*seed, 2)
    low, high = math.log(max(c.noise_least, 1e-3)), math.log(max(c.noise_most, 1e-3))
    return Surroundings(
        temperature=d.even(c.temperature_least, c.temperature_most), bus=d.even(-c.bus, c.bus),
        load=d.even(-c.load, c.load),
        noise=(math.exp(d.even(low, high)), math.exp(d.even(low, high)),
               math.exp(d.even(low, high))),
        gain=d.three(c.current_gain), offset=d.three(c.current_offset),
        start_angle=d.even(0.0, 2.0 * math.pi))


def draw_test(a: Actuator, t: UnitTolerances, c: Conditions, unit: tuple[int, int], number: int,
              damage: Damage, *, own: bool) -> BenchTest:
    """Return test `number` of a unit, which (fleet, place) names."""
    return BenchTest(
        actuator=draw_unit(a, t, unit), own=draw_own(a, unit) if own else Own(),
        surroundings=draw_surroundings(c, (*unit, 1 + number)), damage=damage,
        seed=int(np.random.default_rng([*unit, 1 + number, 3]).integers(1 << 31)),
        unit=f"B{unit[0]}-{unit[1]:04d}")
