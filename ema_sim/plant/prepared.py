"""What no step of the kernel changes: effects and parameters put together, once a call.

Groups of effects that are absent are noted: a neutral effect adds 0 or multiplies by 1, and
leaving it out gives the same bits in less time.
"""

from __future__ import annotations

import math

from ema_record.actuator import FOC, HARMONICS, INSTANT, Actuator
from ema_sim.effects.base import AllEffects
from ema_sim.effects.compile import law
from ema_sim.machine import THIRD, TURN
from ema_sim.plant import ports, sensor_ports
from ema_sim.plant.electrical import of_phases
from ema_sim.plant.parts import Masses, Sensors, Winding

PERIODS_A_STEP = 0.05
"""Longest step in periods of the finest ripple (cogging, mesh, harmonics)."""
SHARE_OF_SHAFT = 0.25
"""Longest step over the radian of the shaft's oscillation, and over its damping's time."""
SHARE_OF_WINDING = 0.25
"""Longest step over the time constant of the winding."""
SATURATED_STEP = 10e-6
"""Longest step (s) with saturation, which a step takes from its begin."""


@law
def friction_is_steady(e: AllEffects) -> bool:
    """Whether the dry friction of the motor depends on neither speed nor load."""
    return e.stribeck_friction.increase == 0.0 and e.load_dependent_friction.coefficient == 0.0


@law
def rotation_is_smooth(e: AllEffects) -> bool:
    """Whether rotor and gear turn without cogging, ripple and the drag of a short."""
    return (
        e.gear_mesh_ripple.amplitude == 0.0
        and e.cogging_torque.amplitude == 0.0
        and e.turn_short.fraction == 0.0
    )


@law
def inverter_is_ideal(e: AllEffects) -> bool:
    """Whether the switches drop no voltage."""
    return e.inverter_voltage_drop.drop == 0.0


@law
def winding_of(a: Actuator, e: AllEffects) -> Winding:
    """Return the constants of the winding."""
    motor = a.motor
    g_a = 1.0 / ports.phase_inductance(e, motor, 0, 0.0)
    g_b = 1.0 / ports.phase_inductance(e, motor, 1, 0.0)
    g_c = 1.0 / ports.phase_inductance(e, motor, 2, 0.0)
    sines = ports.needs_sine(e, motor) or a.drive.kind == FOC
    return Winding(
        float(motor.pole_pairs),
        ports.leg_voltage(e, a.inverter.bus_voltage),
        ports.phase_resistance(e, motor, 0),
        ports.phase_resistance(e, motor, 1),
        ports.phase_resistance(e, motor, 2),
        g_a, g_b, g_c,
        ports.phase_constant(e, motor, 0),
        ports.phase_constant(e, motor, 1),
        ports.phase_constant(e, motor, 2),
        ports.flat_top(e, motor),
        motor.back_emf == HARMONICS,
        sines,
        ports.winding_swings(e),
        ports.inductance_varies(e),
        inverter_is_ideal(e),
    )


@law
def masses_of(a: Actuator, e: AllEffects) -> Masses:
    """Return the constants of the mechanics."""
    dynamic_m, static_m = ports.motor_dry_friction(e, a.motor, 0.0, 0.0)
    dynamic_s, static_s = ports.surface_dry_friction(e, a.surface)
    return Masses(
        rotation_is_smooth(e),
        friction_is_steady(e),
        dynamic_m, static_m, dynamic_s, static_s,
        ports.shaft_stiffness(e, a.shaft),
        ports.lost_motion(e, a.shaft),
        1.0 / a.gear.ratio,
        1.0 / a.gear.efficiency,
        1.0 / ports.motor_inertia(e, a.motor),
        1.0 / ports.surface_inertia(e, a.surface),
    )


@law
def sensors_of(a: Actuator, e: AllEffects) -> Sensors:
    """Return the constants of the sensors."""
    angle = sensor_ports.commutation_angle(e)
    return Sensors(
        a.acquisition.sampling == INSTANT,
        sensor_ports.current_gain(e, 0),
        sensor_ports.current_gain(e, 1),
        sensor_ports.current_gain(e, 2),
        sensor_ports.current_offset(e, 0),
        sensor_ports.current_offset(e, 1),
        sensor_ports.current_offset(e, 2),
        angle, math.sin(angle), math.cos(angle),
        sensor_ports.position_offset(e),
        sensor_ports.position_step(e, a.converters),
        sensor_ports.speed_step(e, a.converters),
        sensor_ports.delay_periods(e, a),
    )


@law
def longest_step(a: Actuator, w: Winding, m: Masses) -> float:
    """Return the longest step (s) that the fastest part of the actuator allows."""
    lightness = m.inverse_j_s + m.inverse_j_m * m.inverse_ratio**2
    return min(
        SATURATED_STEP if w.varies else 1.0,
        SHARE_OF_SHAFT / math.sqrt(m.stiffness * lightness),
        SHARE_OF_SHAFT / (a.shaft.damping * lightness + 1.0),
        SHARE_OF_WINDING / max(w.r_a * w.g_a, w.r_b * w.g_b, w.r_c * w.g_c),
    )


@law
def largest_angle(a: Actuator, e: AllEffects) -> float:
    """Return the longest step in motor angle (rad)."""
    return PERIODS_A_STEP * TURN / ports.ripple_periods(e, a)


@law
def constants_of_phases(
    w: Winding, a: Actuator, e: AllEffects, theta: float, sine: float, cosine: float,
    theta_r: float,
) -> tuple[float, float, float]:
    """Return k(θ) of the phases (V s/rad) without saturation; see `ports.back_emf_constant`.

    Parameters
    ----------
    w, a, e : constants, parameters and effects.
    theta, sine, cosine : electrical angle in [0, 2π) (rad); its sine and cosine if `w.sines`.
    theta_r : mechanical rotor angle (rad).
    """
    s_a, s_b, s_c = of_phases(sine, cosine)
    k_a = w.k_a * ports.unit_shape(e, a.motor, w.top, theta, s_a, w.harmonic)
    k_b = w.k_b * ports.unit_shape(e, a.motor, w.top, theta - THIRD, s_b, w.harmonic)
    k_c = w.k_c * ports.unit_shape(e, a.motor, w.top, theta - 2.0 * THIRD, s_c, w.harmonic)
    if w.swings:
        k_a *= ports.swing(e, 0, theta_r)
        k_b *= ports.swing(e, 1, theta_r)
        k_c *= ports.swing(e, 2, theta_r)
    return k_a, k_b, k_c
