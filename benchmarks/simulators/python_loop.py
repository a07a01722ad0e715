"""The common drive as a plain Python loop with fixed steps: what anyone would write first."""

from __future__ import annotations

from math import floor, pi, sin

import numpy as np

from benchmarks.simulators import drive as d

SIGNS = ((1, -1, 0), (1, 0, -1), (0, 1, -1), (-1, 1, 0), (-1, 0, 1), (0, -1, 1))


def control(omega: float, integral: float) -> tuple[float, float]:
    """Return reference current (A) and integral (A) of the PI speed control."""
    error = d.OMEGA - omega
    grown = integral + d.KI * error * d.PERIOD
    current = d.KP * error + grown
    if abs(current) > d.I_MAX and current * error > 0.0:
        grown = integral
        current = d.KP * error + grown
    return max(-d.I_MAX, min(d.I_MAX, current)), grown


def references(theta: float, current: float) -> tuple[float, float, float]:
    """Return the reference currents of the phases (A) at an electrical angle (rad)."""
    a, b, c = SIGNS[floor((theta - pi / 6.0) / (pi / 3.0)) % 6]
    return a * current, b * current, c * current


def simulate(theta: float, dt: float, length: float) -> np.ndarray:
    """Return samples, shape (n, 4): torque (N m), phase currents (A)."""
    third = 2.0 * pi / 3.0
    steps = round(d.SAMPLE / dt)
    i_a = i_b = i_c = integral = 0.0
    s_a = s_b = s_c = 1.0
    omega = d.OMEGA
    out = []
    for _ in range(round(length / d.SAMPLE)):
        i_ref, integral = control(omega, integral)
        sum_t = sum_a = sum_b = sum_c = 0.0
        for _ in range(steps):
            r_a, r_b, r_c = references(theta, i_ref)
            if i_a >= r_a + d.BAND:
                s_a = -1.0
            elif i_a <= r_a - d.BAND:
                s_a = 1.0
            if i_b >= r_b + d.BAND:
                s_b = -1.0
            elif i_b <= r_b - d.BAND:
                s_b = 1.0
            if i_c >= r_c + d.BAND:
                s_c = -1.0
            elif i_c <= r_c - d.BAND:
                s_c = 1.0
            k_a = d.K * sin(theta)
            k_b = d.K * sin(theta - third)
            k_c = d.K * sin(theta + third)
            x_a = d.V_LEG * s_a - d.R * i_a - k_a * omega
            x_b = d.V_LEG * s_b - d.R * i_b - k_b * omega
            x_c = d.V_LEG * s_c - d.R * i_c - k_c * omega
            v_n = (x_a + x_b + x_c) / 3.0
            i_a += dt * (x_a - v_n) / d.L
            i_b += dt * (x_b - v_n) / d.L
            i_c += dt * (x_c - v_n) / d.L
            torque = k_a * i_a + k_b * i_b + k_c * i_c
            omega += dt * (torque - d.DRY - d.VISCOUS * omega) / d.J
            theta += dt * omega
            sum_t += torque
            sum_a += i_a
            sum_b += i_b
            sum_c += i_c
        out.append((sum_t / steps, sum_a / steps, sum_b / steps, sum_c / steps))
    return np.array(out)
