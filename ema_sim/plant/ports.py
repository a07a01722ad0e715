"""Ports: where effects enter the equations, each a plain sum or product of its effects.

Those of sensors, commutation and controller are in `sensor_ports`.

An effect that is neutral returns at once, so its term is exactly absent.
"""

from __future__ import annotations

import math

from ema_record.actuator import FOC, HARMONICS, Actuator, Gear, Motor, Shaft, Surface
from ema_sim.effects import (
    back_emf_shape,
    backlash,
    bus_voltage_change,
    bus_voltage_sag,
    cogging_torque,
    gear_mesh_ripple,
    inertia_change,
    inverter_voltage_drop,
    load_dependent_friction,
    magnetic_saturation,
    motor_friction,
    phase_resistance_imbalance,
    rotor_eccentricity,
    shaft_compliance,
    stribeck_friction,
    surface_friction,
    surface_load,
    torque_constant_drop,
    turn_short,
    viscous_friction,
    winding_temperature,
)
from ema_sim.effects.base import AllEffects
from ema_sim.effects.compile import law
from ema_sim.machine import THIRD
from ema_sim.plant.electrical import harmonics, trapezoid

# --- winding -------------------------------------------------------------------------------


@law
def phase_resistance(e: AllEffects, motor: Motor, phase: int) -> float:
    """Resistance of a phase (Ω)."""
    return (
        motor.phase_resistance
        * turn_short.resistance_factor(e.turn_short, phase)
        * winding_temperature.resistance_factor(e.winding_temperature)
        * phase_resistance_imbalance.resistance_factor(e.phase_resistance_imbalance, phase)
    )


@law
def phase_inductance(e: AllEffects, motor: Motor, phase: int, current: float) -> float:
    """Inductance of a phase (H) at its current (A)."""
    return (
        motor.phase_inductance
        * turn_short.inductance_factor(e.turn_short, phase)
        * saturation(e, current)
    )


@law
def inductance_varies(e: AllEffects) -> bool:
    """Whether the inductances depend on the currents."""
    return e.magnetic_saturation.inverse_current != 0.0


@law
def flat_top(e: AllEffects, motor: Motor) -> float:
    """Width of the flat top of the back-EMF (rad)."""
    return back_emf_shape.width(e.back_emf_shape, motor.flat_top)


@law
def unit_factor(motor: Motor, phase: int) -> float:
    """Return the factor of the unit's own winding on k of a phase."""
    if phase == 0:
        return 1.0 + motor.back_emf_deviation_a
    if phase == 1:
        return 1.0 + motor.back_emf_deviation_b
    return 1.0 + motor.back_emf_deviation_c


@law
def winding_swings(e: AllEffects) -> bool:
    """Whether k of a phase depends on the mechanical angle."""
    return e.rotor_eccentricity.zeta != 0.0


@law
def needs_sine(e: AllEffects, motor: Motor) -> bool:
    """Whether the shape of the back-EMF is made of the sine of the electrical angle."""
    return motor.back_emf == HARMONICS or back_emf_shape.needs_sine(e.back_emf_shape)


@law
def phase_constant(e: AllEffects, motor: Motor, phase: int) -> float:
    """K of a phase (V s/rad) without what depends on an angle or a current."""
    return (
        motor.back_emf_constant
        * unit_factor(motor, phase)
        * turn_short.k_factor(e.turn_short, phase)
        * torque_constant_drop.k_factor(e.torque_constant_drop)
        * winding_temperature.k_factor(e.winding_temperature)
    )


@law
def unit_shape(
    e: AllEffects, motor: Motor, top: float, theta: float, sine: float, harmonic: bool
) -> float:
    """Shape of the back-EMF (1) at a phase's own electrical angle (rad), given its sine.

    `top` is that of `flat_top`, `harmonic` whether the motor's shape is of harmonics.
    """
    if harmonic:
        value = harmonics(sine, motor.harmonic_3, motor.harmonic_5, motor.harmonic_7)
        if top != motor.flat_top:
            value += trapezoid(theta, top) - trapezoid(theta, motor.flat_top)
    else:
        value = trapezoid(theta, top)
    return back_emf_shape.shape(e.back_emf_shape, value, sine)


@law
def swing(e: AllEffects, phase: int, theta_r: float) -> float:
    """Factor on k of a phase at mechanical rotor angle (rad)."""
    return rotor_eccentricity.k_factor(e.rotor_eccentricity, phase, theta_r)


@law
def saturation(e: AllEffects, current: float) -> float:
    """Factor on k and L of a phase at its current (A)."""
    return magnetic_saturation.factor(e.magnetic_saturation, current)


@law
def back_emf_constant(
    e: AllEffects, motor: Motor, top: float, phase: int, theta_e: float, theta_r: float,
    current: float,
) -> float:
    """k_k(θ) of a phase (V s/rad) at electrical and mechanical rotor angle (rad), current (A)."""
    theta = theta_e - phase * THIRD
    return (
        phase_constant(e, motor, phase)
        * unit_shape(e, motor, top, theta, math.sin(theta), motor.back_emf == HARMONICS)
        * swing(e, phase, theta_r)
        * saturation(e, current)
    )


# --- motor torque --------------------------------------------------------------------------


@law
def added_motor_torque(
    e: AllEffects, motor: Motor, k_a: float, k_b: float, k_c: float, omega: float, theta_r: float
) -> float:
    """What adds to the electromagnetic torque (N m)."""
    return cogging_torque.torque(e.cogging_torque, theta_r) - turn_short.drag_torque(
        e.turn_short, k_a, k_b, k_c, motor.phase_resistance, omega
    )


# --- friction ------------------------------------------------------------------------------


@law
def motor_dry_friction(
    e: AllEffects, motor: Motor, omega: float, transmitted: float
) -> tuple[float, float]:
    """Dynamic and static budget of the motor side (N m); `transmitted` torque at the motor."""
    added = load_dependent_friction.budget(e.load_dependent_friction, transmitted)
    dynamic = (
        motor.dynamic_friction
        + motor_friction.budget(e.motor_friction, motor.dynamic_friction)
        + stribeck_friction.budget(e.stribeck_friction, motor.dynamic_friction, omega)
        + added
    )
    static = (
        motor.static_friction
        + motor_friction.budget(e.motor_friction, motor.static_friction)
        + added
    )
    dynamic = max(0.0, dynamic)
    return dynamic, max(static, dynamic)


@law
def motor_viscous_friction(e: AllEffects, motor: Motor, omega: float) -> float:
    """Viscous torque of the motor side (N m)."""
    torque = motor.viscous_friction * omega + viscous_friction.torque(e.viscous_friction, omega)
    return torque if torque * omega > 0.0 else 0.0


@law
def surface_dry_friction(e: AllEffects, surface: Surface) -> tuple[float, float]:
    """Dynamic and static budget of the surface (N m)."""
    dynamic = surface.dynamic_friction + surface_friction.budget(
        e.surface_friction, surface.dynamic_friction
    )
    static = surface.static_friction + surface_friction.budget(
        e.surface_friction, surface.static_friction
    )
    dynamic = max(0.0, dynamic)
    return dynamic, max(static, dynamic)


# --- transmission --------------------------------------------------------------------------


@law
def lost_motion(e: AllEffects, shaft: Shaft) -> float:
    """Total backlash (rad at the surface)."""
    return backlash.lost_motion(e.backlash, shaft.backlash)


@law
def shaft_stiffness(e: AllEffects, shaft: Shaft) -> float:
    """Stiffness of the shaft (N m/rad)."""
    return shaft_compliance.stiffness(e.shaft_compliance, shaft.stiffness)


@law
def gear_output(e: AllEffects, gear: Gear, theta_m: float, theta_r: float) -> float:
    """Angle of the gear's output (rad) at motor travel and mechanical rotor angle (rad)."""
    return theta_m / gear.ratio + gear_mesh_ripple.error(e.gear_mesh_ripple, theta_r)


@law
def gear_slope(e: AllEffects, gear: Gear, theta_r: float) -> float:
    """Derivative of the gear's output to the motor angle."""
    return 1.0 / gear.ratio + gear_mesh_ripple.error_slope(e.gear_mesh_ripple, theta_r)


@law
def ripple_periods(e: AllEffects, a: Actuator) -> float:
    """Periods a mechanical turn of the finest active ripple; six sectors make 6 a pole pair."""
    motor, pure = a.motor, a.drive.kind == FOC and a.motor.back_emf == HARMONICS
    pure = pure and motor.harmonic_3 == 0.0 and motor.harmonic_5 == 0.0
    pure = pure and motor.harmonic_7 == 0.0 and e.back_emf_shape.fifth_harmonic == 0.0
    finest = motor.pole_pairs * (1.0 if pure else 6.0)
    if motor.back_emf == HARMONICS and motor.harmonic_7 != 0.0:
        finest = 7.0 * motor.pole_pairs
    if e.cogging_torque.amplitude != 0.0:
        finest = max(finest, e.cogging_torque.periods)
    if e.gear_mesh_ripple.amplitude != 0.0:
        finest = max(finest, e.gear_mesh_ripple.periods)
    return finest


# --- load ----------------------------------------------------------------------------------


@law
def motor_inertia(e: AllEffects, motor: Motor) -> float:
    """Inertia of the motor side (kg m²)."""
    return motor.inertia * inertia_change.factor(e.inertia_change.motor)


@law
def surface_inertia(e: AllEffects, surface: Surface) -> float:
    """Inertia of the surface (kg m²)."""
    return surface.inertia * inertia_change.factor(e.inertia_change.surface)


@law
def load_torque(e: AllEffects, position: float) -> float:
    """Torque on the surface (N m), against positive motion."""
    return surface_load.torque(e.surface_load, position)


# --- supply --------------------------------------------------------------------------------


@law
def leg_voltage(e: AllEffects, nominal: float) -> float:
    """Voltage of a leg without load (V)."""
    return nominal * bus_voltage_change.factor(e.bus_voltage_change)


@law
def rail_drop(e: AllEffects, current: float) -> float:
    """Fall of each rail (V) at the current of the source (A)."""
    return bus_voltage_sag.rail_drop(e.bus_voltage_sag, current)


@law
def supply(e: AllEffects, current: float, charge: float, h: float) -> tuple[float, float]:
    """Return current (A) and charge (A s) of the source once `charge` was drawn in `h` s."""
    return bus_voltage_sag.supply(e.bus_voltage_sag, current, charge, h)


@law
def switch_drop(e: AllEffects, current: float) -> float:
    """Fall of a leg's voltage in its switches (V) at its current (A)."""
    return inverter_voltage_drop.voltage(e.inverter_voltage_drop, current)


@law
def leg_voltages(
    e: AllEffects, rail: float, s_a: float, s_b: float, s_c: float,
    i_a: float, i_b: float, i_c: float, ideal: bool,
) -> tuple[float, float, float]:  # fmt: skip
    """Voltages of the legs (V) at their states ±1 and currents (A); `ideal`: without drops."""
    v_a, v_b, v_c = rail * s_a, rail * s_b, rail * s_c
    if ideal:
        return v_a, v_b, v_c
    return v_a - switch_drop(e, i_a), v_b - switch_drop(e, i_b), v_c - switch_drop(e, i_c)
