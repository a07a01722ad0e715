"""What the drive of an actuator can do: torque, speed, time to accelerate and to settle.

One rigid body at the motor, inertia and friction of the surface reflected by the gear::

    J dω/dt = T(ω) − F(ω),   T(ω) = min(torque limit, k_T min(I limit, I_V(ω)))

I_V is the current that the bus drives against the back-EMF. Six-step currents flow through two
phases in series, V = ½ k_T ω + R I with legs at ±V, and dip after each commutation
(`six_step_current`); sinusoidal ones meet the reactance too,
(2 V / √3)² = (⅔ k_T ω + R I)² + (p ω L I)² with centred legs (Krishnan, Permanent Magnet
Synchronous and Brushless DC Motor Drives, 2010, chapters 3 and 9).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ema_record.actuator import FOC, PWM, SINE, TRAPEZOID, Actuator
from ema_record.errors import UsageError

SPEEDS = 400
"""Points of the integral over the speed."""
RESERVE = 1.2
"""Torque at the speed limit over friction: hot windings, low bus and stiff grease need it."""
CENTRED = 2.0 / math.sqrt(3.0)
"""Amplitude of the phases' voltages over that of a leg, legs centred between the rails."""
SAMPLES_A_TURN = 24
"""Fewest samples an electrical turn: the sixth line and a trimmed portion are resolved."""


class Capability(NamedTuple):
    """Times of an actuator's movements (s) and its reflected load."""

    inertia: float
    """Of motor, gear and surface, at the motor (kg m²)."""
    friction: float
    """At the motor and the speed limit (N m)."""
    acceleration: float
    """Time from rest to the speed limit at full torque."""
    speed_loop: float
    """Slowest time constant of the speed control."""
    position_loop: float
    """Time constant of the position control: it brakes this long before the surface arrives."""


def trapezoid(angle: np.ndarray, flat_top: float) -> np.ndarray:
    """Return a trapezoid of height 1 with tops of `flat_top` (rad) at angles, shape (n,) (rad)."""
    half = np.mod(angle, np.pi)
    value = np.minimum(np.minimum(half, np.pi - half) / (0.5 * (np.pi - flat_top)), 1.0)
    return np.where(np.sin(angle) >= 0.0, value, -value)


def back_emf_shape(actuator: Actuator, angle: np.ndarray) -> np.ndarray:
    """Return k(θ) of a phase over its constant at electrical angles, shape (n,) (rad)."""
    motor = actuator.motor
    if motor.back_emf == TRAPEZOID:
        return trapezoid(angle, motor.flat_top)
    return (np.sin(angle) + motor.harmonic_3 * np.sin(3.0 * angle)
            + motor.harmonic_5 * np.sin(5.0 * angle) + motor.harmonic_7 * np.sin(7.0 * angle))


def torque_constant(actuator: Actuator) -> float:
    """Return the mean torque a reference current of 1 A makes (N m/A).

    2 k with six-step currents on a trapezoid with a top of 120 degrees or more, 3 √3 / π k on a
    sine; 3/2 of the fundamental of k with sinusoidal currents.
    """
    angle = (np.arange(7200) + 0.5) * (2.0 * np.pi / 7200)
    if actuator.drive.kind == FOC:
        current = np.sin(angle)
    else:
        flows = np.abs(np.sin(angle)) > 0.5
        current = np.where(flows, np.sign(np.sin(angle)), 0.0)
    k = actuator.motor.back_emf_constant
    return 3.0 * k * float(np.mean(back_emf_shape(actuator, angle) * current))


def friction_at(actuator: Actuator, speed: np.ndarray) -> np.ndarray:
    """Return the friction at the motor (N m) at motor speeds, shape (n,), >= 0 (rad/s)."""
    motor, surface, gear = actuator.motor, actuator.surface, actuator.gear
    load = surface.dynamic_friction + surface.viscous_friction * speed / gear.ratio
    return (motor.dynamic_friction + motor.viscous_friction * speed
            + load / (gear.ratio * gear.efficiency))


def torque_at(actuator: Actuator, speed: np.ndarray, *, dips: bool = True) -> np.ndarray:
    """Return the largest torque (N m) at motor speeds, shape (n,), >= 0 (rad/s).

    Without `dips` of six-step currents: by it the default tests were timed.
    """
    motor, limit = actuator.motor, actuator.inverter
    k, r, v = torque_constant(actuator), motor.phase_resistance, voltage_reach(actuator)
    if actuator.drive.kind == FOC:
        e = k * speed / 1.5
        x = motor.pole_pairs * speed * motor.phase_inductance
        z = r * r + x * x
        root = np.sqrt(np.maximum((r * e) ** 2 + z * (v * v - e * e), 0.0))
        current = np.where(v > e, (root - r * e) / z, 0.0)
    elif dips:
        current = np.array([six_step_current(actuator, float(w), 0.5 * k * float(w), v)
                            for w in speed])
    else:
        current = np.maximum(v - 0.5 * k * speed, 0.0) / r
    return np.minimum(motor.torque_limit, k * np.minimum(current, limit.current_limit))


def six_step_current(actuator: Actuator, speed: float, e: float, v: float) -> float:
    """Return the mean current (A) of six steps at a motor speed (rad/s), legs at ±v at most (V).

    In a sector of length T = π / 3pω one phase goes on, one gives its current to the third
    (Carlson, Lajoie-Mazenc and Fagundes 1992, IEEE Trans. Ind. Appl. 28(3)). While it does, the
    current tends to a = ⅔ (V − 2 E) / R and what is left of the other to b = ⅔ (V + E) / R, then
    to c = (V − E) / R. It begins and ends a sector at I, the limit or, where that is not reached,
    c (1 − q) / (1 − q / 2) with q = exp(−R T / L); so its mean is that of what it tends to, and
    of I while it is held. A `PWM` drive lags and reaches less.
    """
    motor, limit = actuator.motor, actuator.inverter.current_limit
    r, c = motor.phase_resistance, (v - e) / motor.phase_resistance
    if c <= 0.0 or speed <= 0.0:
        return min(max(c, 0.0), limit)
    a, b = 2.0 * (v - 2.0 * e) / (3.0 * r), 2.0 * (v + e) / (3.0 * r)
    constant, sector = motor.phase_inductance / r, math.pi / (3.0 * motor.pole_pairs * speed)
    kept = math.exp(-sector / constant)
    current = min(limit, c * (1.0 - kept) / (1.0 - 0.5 * kept))
    given = min(constant * math.log1p(current / b), sector)
    least = a + (current - a) * b / (b + current)
    if least >= current:
        return current
    back = sector - given
    if current < c:
        back = min(back, constant * math.log((c - least) / (c - current)))
    return (a * given + c * back + current * (sector - given - back)) / sector


def voltage_reach(actuator: Actuator) -> float:
    """Return the most that a phase gets of six steps, or the amplitude of sinusoidal ones (V)."""
    drive, v = actuator.drive, actuator.inverter.bus_voltage
    if drive.modulation == SINE and drive.kind in (PWM, FOC):
        v /= CENTRED
    return v * CENTRED if drive.kind == FOC else v


def turnable(actuator: Actuator) -> dict[str, float]:
    """Return by which part dry friction of motor or surface may grow until it is not turned.

    From rest, and at the speed limit, each with `RESERVE`; below 0: it is not turned at all.
    """
    motor, surface = actuator.motor, actuator.surface
    reflected = actuator.gear.ratio * actuator.gear.efficiency
    speed = np.array([0.0, actuator.control.speed_limit])
    static = motor.static_friction + surface.static_friction / reflected
    friction = np.array([static, friction_at(actuator, speed)[1]])
    left = torque_at(actuator, speed) / RESERVE - friction
    own = {"motor_friction": (motor.static_friction, motor.dynamic_friction),
           "surface_friction": (surface.static_friction / reflected,
                                surface.dynamic_friction / reflected)}
    return {name: min((float(rest / part) for rest, part in zip(left, parts) if part > 0.0),
                      default=math.inf) for name, parts in own.items()}


def free_speed(actuator: Actuator) -> float:
    """Return the motor's speed (rad/s) at which its back-EMF takes the whole bus."""
    k, v = torque_constant(actuator), voltage_reach(actuator)
    return (1.5 if actuator.drive.kind == FOC else 2.0) * v / k


def motion(actuator: Actuator) -> Capability:
    """Return the times of the movements of `actuator`.

    Raises
    ------
    UsageError
        It cannot start or reach its speed limit, its position is not controlled, or its rate of
        recording is too low for its speed.
    """
    motor, gear, surface, control = (
        actuator.motor, actuator.gear, actuator.surface, actuator.control)
    speed = np.linspace(0.0, control.speed_limit, SPEEDS + 1)
    torque, friction = torque_at(actuator, speed), friction_at(actuator, speed)
    static = motor.static_friction + surface.static_friction / (gear.ratio * gear.efficiency)
    if torque[0] <= static:
        raise UsageError(
            f"the motor's torque, {torque[0]:.3g} N m at standstill, does not exceed static "
            f"friction, {static:.3g} N m at the motor: raise inverter.current_limit and "
            "motor.torque_limit, or correct the friction")
    short = torque < RESERVE * friction
    if short.any():
        reached = speed[max(int(np.argmax(short)) - 1, 0)]
        raise UsageError(
            f"the bus of +-{actuator.inverter.bus_voltage:g} V and the torque do not carry the "
            f"motor to control.speed_limit {control.speed_limit:g} rad/s: {reached:.3g} rad/s at "
            f"most with {RESERVE:g} times the friction: lower the limit or raise the bus")
    if control.position_gain <= 0.0 or control.proportional_gain <= 0.0:
        raise UsageError("control.position_gain and control.proportional_gain must be above 0: "
                         "without them no command is followed")
    turns = motor.pole_pairs * control.speed_limit / (2.0 * math.pi)
    if actuator.acquisition.rate < SAMPLES_A_TURN * turns:
        raise UsageError(
            f"acquisition.rate {actuator.acquisition.rate:g} samples a second are "
            f"{actuator.acquisition.rate / turns:.1f} an electrical turn at the speed limit, at "
            f"least {SAMPLES_A_TURN}: record at {SAMPLES_A_TURN * turns:.0f} or more, or lower "
            "control.speed_limit")
    inertia = motor.inertia + surface.inertia / (gear.ratio**2 * gear.efficiency)
    slowness = inertia / (torque_at(actuator, speed, dips=False) - friction)
    step = speed[1] - speed[0]
    return Capability(
        inertia=inertia, friction=float(friction[-1]),
        acceleration=float(step * 0.5 * (slowness[1:] + slowness[:-1]).sum()),
        speed_loop=_slowest(
            inertia, control.proportional_gain * torque_constant(actuator)
            + motor.viscous_friction + surface.viscous_friction / gear.ratio**2,
            control.integral_gain * torque_constant(actuator)),
        position_loop=gear.ratio / control.position_gain,
    )


def _slowest(a: float, b: float, c: float) -> float:
    """Return the slowest time constant of a s² + b s + c, or of a s + b where c is 0."""
    if c <= 0.0:
        return a / b
    inside = b * b - 4.0 * a * c
    return 2.0 * a / b if inside <= 0.0 else (b + math.sqrt(inside)) / (2.0 * c)
