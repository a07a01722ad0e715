"""The event-driven kernel: second-order steps from event to event.

Events are relay crossings, commutation edges, control periods and sample edges; between
them a step is at most `MAX_STEP` long. A step is the trapezoidal rule with the end
derivative taken at a second-order prediction and kept for the next step, so every law is
evaluated once a step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
from numba import njit

from ema_record.actuator import Actuator
from ema_record.sources import source_hash
from ema_sim.effects.registry import Effects
from ema_sim.plant import neutral, ports
from ema_sim.plant import state as st
from ema_sim.plant.control import clip, delayed, quantise, reference_current
from ema_sim.plant.electrical import (
    TURN,
    current_slopes,
    reference_signs,
    relay,
    sector_ahead,
    time_to_switch,
)
from ema_sim.plant.mechanics import net_torque, shaft_torque

MAX_STEP = 20e-6
"""Longest step (s); the 2 f_e line moves by less than 0.2 % from here to 1 µs."""
PERIODS_A_STEP = 0.05
"""Longest step in periods of the finest ripple (cogging, mesh, harmonics)."""
OK, NOT_FINITE, TOO_MANY_STEPS = 0, 1, 2
MAX_STEPS_A_SAMPLE = 20_000
TRACE_NAMES = ("motor_torque[N m]", "shaft_torque[N m]", "surface_speed[rad/s]")
SIMULTANEOUS = 1e-12


@cache
def kernel() -> Callable[..., int]:
    """Return the compiled kernel of the present sources (see `compile`)."""
    return _build(source_hash("ema_sim.plant.kernel"))


def _build(sources: str) -> Callable[..., int]:
    @njit(cache=True, error_model="numpy", nogil=True)
    def advance(
        a: Actuator,
        e: Effects,
        state: np.ndarray,
        command: np.ndarray,
        noise: np.ndarray,
        inverter_on: float,
        rate: float,
        max_step: float,
        out: np.ndarray,
        trace: np.ndarray,
    ) -> int:
        """Advance `state` by ``len(out)`` samples.

        Parameters
        ----------
        a, e : parameters of the actuator and of the effects.
        state : ndarray, shape (N_STATE,), in and out.
        command : ndarray, shape (m,), surface position commanded at each control period (rad),
            the first one at the present period.
        noise : ndarray, shape (m, 2), added to measured speed (rad/s) and position (rad).
        inverter_on : time from which the inverter drives (s).
        rate : samples a second. max_step : longest step (s).
        out : ndarray, shape (n, 10), filled: means over each sample, without converters and
            without the current noise.
        trace : ndarray, shape (n, 3) or (0, 3), filled: means of `TRACE_NAMES`.
        """
        _ = sources
        motor, shaft, gear, control = a.motor, a.shaft, a.gear, a.control
        pairs = float(motor.pole_pairs)
        v_leg, band = ports.leg_voltage(e, a.inverter.bus_voltage), a.inverter.hysteresis
        stop = a.surface.end_stop
        keep_trace = len(trace) > 0

        r_a = ports.phase_resistance(e, motor, 0)
        r_b = ports.phase_resistance(e, motor, 1)
        r_c = ports.phase_resistance(e, motor, 2)
        g_a = 1.0 / ports.phase_inductance(e, motor, 0, 0.0)
        g_b = 1.0 / ports.phase_inductance(e, motor, 1, 0.0)
        g_c = 1.0 / ports.phase_inductance(e, motor, 2, 0.0)
        g_n = 1.0 / (g_a + g_b + g_c)
        varies = ports.inductance_varies(e)
        curvature = 0.5 * motor.phase_resistance / motor.phase_inductance
        top = ports.flat_top(e, motor)
        plain, steady = neutral.winding_is_plain(e), neutral.friction_is_steady(e)
        smooth, ideal = neutral.rotation_is_smooth(e), neutral.inverter_is_ideal(e)
        dyn_0, sta_0 = ports.motor_dry_friction(e, motor, 0.0, 0.0)
        stiffness, backlash = ports.shaft_stiffness(e, shaft), ports.lost_motion(e, shaft)
        j_m, j_s = 1.0 / ports.motor_inertia(e, motor), 1.0 / ports.surface_inertia(e, a.surface)
        dyn_s, sta_s = ports.surface_dry_friction(e, a.surface)
        gain_a, off_a = ports.current_gain(e, 0), ports.current_offset(e, 0)
        gain_b, off_b = ports.current_gain(e, 1), ports.current_offset(e, 1)
        gain_c, off_c = ports.current_gain(e, 2), ports.current_offset(e, 2)
        inv_a, inv_b, inv_c = 1.0 / gain_a, 1.0 / gain_b, 1.0 / gain_c
        band_a, band_b, band_c = band * inv_a, band * inv_b, band * inv_c
        off_q, off_e = ports.position_offset(e), ports.commutation_angle(e)
        step_q, step_w = ports.position_step(e, a.converters), ports.speed_step(e, a.converters)
        delay = ports.delay_periods(e, a)
        max_angle = PERIODS_A_STEP * TURN / ports.ripple_periods(e, motor)

        t = state[st.TIME]
        i_a, i_b, i_c = state[st.I_A], state[st.I_B], state[st.I_C]
        w_m, q_m = state[st.OMEGA_M], state[st.THETA_M]
        w_s, q_s = state[st.OMEGA_S], state[st.THETA_S]
        q_e, q_0 = state[st.THETA_E], state[st.THETA_0]
        s_a, s_b, s_c = state[st.LEG_A], state[st.LEG_B], state[st.LEG_C]
        al_m, al_s = state[st.ALPHA_M], state[st.ALPHA_S]
        i_set = state[st.I_SET]
        history = state[st.HISTORY:]
        n_w, n_q = state[st.SPEED_NOISE], state[st.POSITION_NOISE]
        tick, sample = int(state[st.TICK]), int(state[st.SAMPLE])
        first_tick, steps = tick, 0
        charge, e_terminal, e_copper, e_motor = 0.0, 0.0, 0.0, 0.0
        e_friction_m, e_friction_s, e_shaft, e_load = 0.0, 0.0, 0.0, 0.0

        k_a, k_b, k_c = ports.back_emf_constants(
            e, motor, top, q_e, q_m + q_0, i_a, i_b, i_c, plain)
        t_m = clip(k_a * i_a + k_b * i_b + k_c * i_c, motor.torque_limit)
        t_m += ports.added_motor_torque(e, motor, k_a, k_b, k_c, w_m, q_m + q_0)
        slope = ports.gear_slope(e, gear, q_m + q_0)
        t_sh = shaft_torque(
            ports.gear_output(e, gear, q_m, q_m + q_0) - q_s, w_m * slope - w_s,
            stiffness, shaft.damping, backlash,
        )

        for row in range(len(out)):
            t_edge = (sample + 1) / rate
            m_w = m_n = m_a = m_b = m_c = m_ra = m_rb = m_rc = m_e = m_s = m_t = m_sh = m_ws = 0.0
            steps_here = 0
            while True:
                # Events that are due: control period, commutation, relays.
                if t >= tick * control.period - SIMULTANEOUS:
                    index = min(tick - first_tick, len(command) - 1)
                    n_w, n_q = noise[index, 0], noise[index, 1]
                    speed = quantise(
                        w_m * ports.speed_factor(e, q_m + q_0) + n_w, step_w,
                        a.converters.speed_range,
                    )
                    position = quantise(q_s + off_q + n_q, step_q, a.converters.position_range)
                    tick += 1
                    i_ref, integral = 0.0, 0.0
                    if t >= inverter_on - SIMULTANEOUS:
                        i_ref, integral = reference_current(
                            control, a.inverter.current_limit, command[index], position, speed,
                            state[st.INTEGRAL],
                        )
                    state[st.INTEGRAL] = integral
                    i_set = delayed(history, tick, i_ref, delay)
                on = t >= inverter_on - SIMULTANEOUS
                sector, gap = sector_ahead(q_e + off_e, 1.0 if w_m >= 0.0 else -1.0)
                sign_a, sign_b, sign_c = reference_signs(sector)
                ref_a, ref_b, ref_c = sign_a * i_set, sign_b * i_set, sign_c * i_set
                # The relays compare what the sensors read: i gain + offset, against ref ± band.
                aim_a, aim_b = (ref_a - off_a) * inv_a, (ref_b - off_b) * inv_b
                aim_c = (ref_c - off_c) * inv_c
                s_a = relay(s_a, i_a - aim_a, band_a)
                s_b = relay(s_b, i_b - aim_b, band_b)
                s_c = relay(s_c, i_c - aim_c, band_c)

                # Derivatives of the currents now.
                if on:
                    if varies:
                        g_a = 1.0 / ports.phase_inductance(e, motor, 0, i_a)
                        g_b = 1.0 / ports.phase_inductance(e, motor, 1, i_b)
                        g_c = 1.0 / ports.phase_inductance(e, motor, 2, i_c)
                        g_n = 1.0 / (g_a + g_b + g_c)
                    v_a, v_b, v_c = ports.leg_voltages(
                        e, v_leg, s_a, s_b, s_c, i_a, i_b, i_c, ideal)
                    d_a, d_b, d_c = current_slopes(
                        v_a, v_b, v_c, r_a, r_b, r_c, i_a, i_b, i_c,
                        k_a * w_m, k_b * w_m, k_c * w_m, g_a, g_b, g_c, g_n,
                    )
                else:
                    v_a = v_b = v_c = d_a = d_b = d_c = 0.0

                # Length of the step: to the next event.
                h = min(max_step, t_edge - t, tick * control.period - t)
                if not on:
                    h = min(h, inverter_on - t)
                if w_m != 0.0:
                    h = min(h, gap / (pairs * abs(w_m)), max_angle / abs(w_m))
                flip = 0
                if on:
                    reach = time_to_switch(s_a, i_a - aim_a, d_a, band_a, curvature)
                    if reach < h:
                        h, flip = reach, 1
                    reach = time_to_switch(s_b, i_b - aim_b, d_b, band_b, curvature)
                    if reach < h:
                        h, flip = reach, 2
                    reach = time_to_switch(s_c, i_c - aim_c, d_c, band_c, curvature)
                    if reach < h:
                        h, flip = reach, 3
                h = max(h, SIMULTANEOUS)

                # Prediction of the mechanics, then the laws at the end of the step.
                w_p, ws_p = w_m + al_m * h, w_s + al_s * h
                w_p = 0.0 if w_p * w_m < 0.0 else w_p
                ws_p = 0.0 if ws_p * w_s < 0.0 else ws_p
                dq = 0.5 * h * (w_m + w_p)
                q_m1, q_s1 = q_m + dq, q_s + 0.5 * h * (w_s + ws_p)
                q_r1 = q_m1 + q_0
                q_e1 = q_e + pairs * dq
                if q_e1 >= TURN:
                    q_e1 -= TURN
                elif q_e1 < 0.0:
                    q_e1 += TURN
                k_a1, k_b1, k_c1 = ports.back_emf_constants(
                    e, motor, top, q_e1, q_r1, i_a + h * d_a, i_b + h * d_b, i_c + h * d_c, plain)
                if on:
                    d_a1, d_b1, d_c1 = current_slopes(
                        v_a, v_b, v_c, r_a, r_b, r_c,
                        i_a + h * d_a, i_b + h * d_b, i_c + h * d_c,
                        k_a1 * w_p, k_b1 * w_p, k_c1 * w_p, g_a, g_b, g_c, g_n,
                    )
                    i_a1 = i_a + 0.5 * h * (d_a + d_a1)
                    i_b1 = i_b + 0.5 * h * (d_b + d_b1)
                    i_c1 = i_c + 0.5 * h * (d_c + d_c1)
                else:
                    i_a1, i_b1, i_c1 = i_a, i_b, i_c
                t_m1 = clip(k_a1 * i_a1 + k_b1 * i_b1 + k_c1 * i_c1, motor.torque_limit)
                if smooth:
                    q_out, slope1 = q_m1 / gear.ratio, slope
                else:
                    t_m1 += ports.added_motor_torque(e, motor, k_a1, k_b1, k_c1, w_p, q_r1)
                    q_out = ports.gear_output(e, gear, q_m1, q_r1)
                    slope1 = ports.gear_slope(e, gear, q_r1)
                t_sh1 = shaft_torque(
                    q_out - q_s1, w_p * slope1 - ws_p, stiffness, shaft.damping, backlash)
                driving = gear.efficiency if t_sh1 * w_p < 0.0 else 1.0 / gear.efficiency
                load_m = t_sh1 * driving * slope1
                load_s = ports.load_torque(e, q_s1)
                dyn_m, sta_m = dyn_0, sta_0
                if not steady:
                    dyn_m, sta_m = ports.motor_dry_friction(e, motor, w_p, load_m)
                visc_m = ports.motor_viscous_friction(e, motor, w_p)
                visc_s = a.surface.viscous_friction * ws_p
                al_m1 = net_torque(w_p, t_m1 - load_m - visc_m, dyn_m, sta_m) * j_m
                al_s1 = net_torque(ws_p, t_sh1 - load_s - visc_s, dyn_s, sta_s) * j_s
                w_m1, w_s1 = w_m + 0.5 * h * (al_m + al_m1), w_s + 0.5 * h * (al_s + al_s1)
                if w_m1 * w_m < 0.0:
                    w_m1 = 0.0
                    al_m1 = net_torque(0.0, t_m1 - load_m, dyn_m, sta_m) * j_m
                if w_s1 * w_s < 0.0:
                    w_s1 = 0.0
                    al_s1 = net_torque(0.0, t_sh1 - load_s, dyn_s, sta_s) * j_s
                if abs(q_s1) >= stop and q_s1 * w_s1 > 0.0:
                    q_s1 = math.copysign(stop, q_s1)
                    w_s1 = al_s1 = 0.0

                # Means over the sample, energies.
                m_w += 0.5 * h * (w_m + w_m1)
                m_n += h * n_w
                m_a += 0.5 * h * (i_a + i_a1)
                m_b += 0.5 * h * (i_b + i_b1)
                m_c += 0.5 * h * (i_c + i_c1)
                m_ra, m_rb, m_rc = m_ra + h * ref_a, m_rb + h * ref_b, m_rc + h * ref_c
                m_e += 0.5 * h * (q_m + q_m1)
                m_s += 0.5 * h * (q_s + q_s1) + h * n_q
                mid_a, mid_b, mid_c = i_a + i_a1, i_b + i_b1, i_c + i_c1
                charge += 0.25 * h * (s_a * mid_a + s_b * mid_b + s_c * mid_c)
                if keep_trace:
                    m_t += 0.5 * h * (t_m + t_m1)
                    m_sh += 0.5 * h * (t_sh + t_sh1)
                    m_ws += 0.5 * h * (w_s + w_s1)
                    e_terminal += 0.5 * h * (v_a * mid_a + v_b * mid_b + v_c * mid_c)
                    e_copper += 0.25 * h * (
                        r_a * mid_a * mid_a + r_b * mid_b * mid_b + r_c * mid_c * mid_c
                    )
                    e_motor += 0.25 * h * (t_m + t_m1) * (w_m + w_m1)
                    moving_m, moving_s = 0.5 * (w_m + w_m1), 0.5 * (w_s + w_s1)
                    e_friction_m += h * (
                        dyn_m * abs(moving_m)
                        + ports.motor_viscous_friction(e, motor, moving_m) * moving_m
                    )
                    e_friction_s += h * (
                        dyn_s * abs(moving_s) + a.surface.viscous_friction * moving_s**2
                    )
                    e_shaft += 0.5 * h * (t_sh * slope + t_sh1 * slope1) * moving_m
                    e_shaft -= 0.5 * h * (t_sh + t_sh1) * moving_s
                    e_load += h * load_s * moving_s

                t += h
                i_a, i_b, i_c = i_a1, i_b1, i_c1
                w_m, q_m, w_s, q_s, q_e = w_m1, q_m1, w_s1, q_s1, q_e1
                k_a, k_b, k_c, al_m, al_s = k_a1, k_b1, k_c1, al_m1, al_s1
                t_m, t_sh, slope = t_m1, t_sh1, slope1
                s_a = -s_a if flip == 1 else s_a
                s_b = -s_b if flip == 2 else s_b
                s_c = -s_c if flip == 3 else s_c
                steps_here += 1
                if t >= t_edge - SIMULTANEOUS:
                    break
                if steps_here > MAX_STEPS_A_SAMPLE:
                    return TOO_MANY_STEPS

            sample += 1
            steps += steps_here
            out[row, 0] = (sample - 0.5) / rate
            theta_r = m_e * rate + q_0
            out[row, 1] = m_w * rate * ports.speed_factor(e, theta_r) + m_n * rate
            out[row, 2] = m_a * rate * gain_a + off_a
            out[row, 3] = m_b * rate * gain_b + off_b
            out[row, 4] = m_c * rate * gain_c + off_c
            out[row, 5] = m_ra * rate
            out[row, 6] = m_rb * rate
            out[row, 7] = m_rc * rate
            out[row, 8] = theta_r * pairs + off_e
            out[row, 9] = m_s * rate + off_q
            if keep_trace:
                trace[row, 0] = m_t * rate
                trace[row, 1] = m_sh * rate
                trace[row, 2] = m_ws * rate
            if not math.isfinite(m_w + m_a + m_s):
                return NOT_FINITE

        state[st.TIME] = t
        state[st.I_A], state[st.I_B], state[st.I_C] = i_a, i_b, i_c
        state[st.OMEGA_M], state[st.THETA_M], state[st.THETA_E] = w_m, q_m, q_e
        state[st.OMEGA_S], state[st.THETA_S] = w_s, q_s
        state[st.LEG_A], state[st.LEG_B], state[st.LEG_C] = s_a, s_b, s_c
        state[st.ALPHA_M], state[st.ALPHA_S] = al_m, al_s
        state[st.I_SET] = i_set
        state[st.SPEED_NOISE], state[st.POSITION_NOISE] = n_w, n_q
        state[st.TICK], state[st.SAMPLE] = tick, sample
        state[st.STEPS] += steps
        state[st.CHARGE] += charge
        state[st.E_TERMINAL] += e_terminal
        state[st.E_COPPER] += e_copper
        state[st.E_MOTOR] += e_motor
        state[st.E_FRICTION_M] += e_friction_m
        state[st.E_FRICTION_S] += e_friction_s
        state[st.E_SHAFT] += e_shaft
        state[st.E_LOAD] += e_load
        return OK

    return advance
