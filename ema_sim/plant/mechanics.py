"""Mechanical equations: dry friction, shaft with stiffness, damping and backlash; one step."""

from __future__ import annotations

import math

from ema_record.actuator import Actuator
from ema_sim.effects.base import AllEffects
from ema_sim.effects.compile import law
from ema_sim.plant import ports
from ema_sim.plant.parts import Bodies, Load, Masses


@law
def net_torque(omega: float, torque: float, dynamic: float, static: float) -> float:
    """Return the torque that accelerates a body with dry friction (N m).

    While it moves the dynamic torque opposes the speed `omega`; at standstill the active
    `torque` must exceed the static one to start it (Borello and Dalla Vedova).
    """
    if omega > 0.0:
        return torque - dynamic
    if omega < 0.0:
        return torque + dynamic
    if torque > static:
        return torque - dynamic
    if torque < -static:
        return torque + dynamic
    return 0.0


@law
def shaft_torque(
    twist: float, twist_rate: float, stiffness: float, damping: float, backlash: float
) -> float:
    """Return the torque of the shaft on the surface (N m).

    Parameters
    ----------
    twist : gear output minus surface position (rad).
    twist_rate : its rate (rad/s).
    stiffness, damping : of the shaft (N m/rad, N m s/rad).
    backlash : total lost motion (rad); inside it the torque is zero, and contact only pushes.
    """
    half = 0.5 * backlash
    if twist > half:
        return max(0.0, stiffness * (twist - half) + damping * twist_rate)
    if twist < -half:
        return min(0.0, stiffness * (twist + half) + damping * twist_rate)
    return 0.0


@law
def load_at(
    a: Actuator, e: AllEffects, m: Masses, q_m: float, q_r: float, q_s: float, w_m: float,
    w_s: float,
) -> Load:
    """Return the loads at motor travel, rotor angle, surface angle (rad), speeds (rad/s)."""
    output, slope = q_m * m.inverse_ratio, m.inverse_ratio
    if not m.smooth:
        output, slope = ports.gear_output(e, a.gear, q_m, q_r), ports.gear_slope(e, a.gear, q_r)
    shaft = shaft_torque(
        output - q_s, w_m * slope - w_s, m.stiffness, a.shaft.damping, m.backlash)
    driving = a.gear.efficiency if shaft * w_m < 0.0 else m.inverse_efficiency
    return Load(shaft, shaft * driving * slope, ports.load_torque(e, q_s), slope)


@law
def time_after_rest(h: float, omega: float, alpha: float) -> float:
    """Return what is left of a step of length h (s) when a body has come to rest in it.

    `omega` and `alpha` are its speed and acceleration at the begin. There dry friction turns, or
    holds the body; the rest of the step is not lost.
    """
    if (omega + h * alpha) * omega < 0.0:
        return h + omega / alpha
    return 0.0


@law
def move(
    a: Actuator, e: AllEffects, m: Masses, h: float, torque: float, torque1: float,
    w_m: float, w_p: float, w_s: float, ws_p: float, q_s: float, load: Load, load1: Load,
) -> Bodies:  # fmt: skip
    """Return the motion after a step by the trapezoidal rule.

    Parameters
    ----------
    a, e, m : parameters. h : length of the step (s).
    torque, torque1 : of the motor at begin and end (N m), the electromagnetic one its mean.
    w_m, w_p, w_s, ws_p : speeds of motor and surface at begin and, predicted, end (rad/s).
    q_s : surface angle at the end (rad).
    load, load1 : at begin and end.
    """
    motor, viscous = a.motor, a.surface.viscous_friction
    dynamic, static = m.dynamic_m, m.static_m
    if not m.steady:
        dynamic, static = ports.motor_dry_friction(e, motor, w_m, load.motor)
    al_m = m.inverse_j_m * net_torque(
        w_m, torque - load.motor - ports.motor_viscous_friction(e, motor, w_m), dynamic, static)
    if not m.steady:
        dynamic, static = ports.motor_dry_friction(e, motor, w_p, load1.motor)
    al_m1 = m.inverse_j_m * net_torque(
        w_p, torque1 - load1.motor - ports.motor_viscous_friction(e, motor, w_p), dynamic, static)
    al_s = m.inverse_j_s * net_torque(
        w_s, load.shaft - load.surface - viscous * w_s, m.dynamic_s, m.static_s)
    al_s1 = m.inverse_j_s * net_torque(
        ws_p, load1.shaft - load1.surface - viscous * ws_p, m.dynamic_s, m.static_s)
    w_m1, w_s1 = w_m + 0.5 * h * (al_m + al_m1), w_s + 0.5 * h * (al_s + al_s1)
    if (w_m + h * al_m) * w_m < 0.0 or w_m1 * w_m < 0.0:
        al_m1 = m.inverse_j_m * net_torque(0.0, torque1 - load1.motor, dynamic, static)
        w_m1 = al_m1 * time_after_rest(h, w_m, al_m)
    if (w_s + h * al_s) * w_s < 0.0 or w_s1 * w_s < 0.0:
        al_s1 = m.inverse_j_s * net_torque(
            0.0, load1.shaft - load1.surface, m.dynamic_s, m.static_s)
        w_s1 = al_s1 * time_after_rest(h, w_s, al_s)
    if abs(q_s) >= a.surface.end_stop and q_s * w_s1 > 0.0:
        q_s = math.copysign(a.surface.end_stop, q_s)
        w_s1 = al_s1 = 0.0
    return Bodies(w_m1, w_s1, al_m1, al_s1, q_s, dynamic)
