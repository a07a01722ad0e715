"""The event-driven kernel: second-order steps from event to event.

Events of the mechanics are control periods, sample edges, commutation edges and periods of a
carrier; between them a step is at most `MAX_STEP` long. It is the trapezoidal rule with the end
derivative taken at a second-order prediction. In it the currents go from switch to switch of the
legs (`currents`): crossings of the relays, edges of the carrier where they are simulated. A
kernel is compiled for each drive by itself, so that none pays for another.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
from numba import njit

from ema_record.actuator import FOC, PWM_INDEPENDENT, RELAY, Actuator
from ema_record.sources import source_hash
from ema_sim.effects.registry import Effects
from ema_sim.plant import ports, sensor_ports
from ema_sim.plant import state as st
from ema_sim.plant.control import NEVER, arriving, quantise, reference_current
from ema_sim.plant.currents import MOST_SWITCHES, SAME_TIME, advance_currents, circuit_of
from ema_sim.plant.electrical import TURN, of_phases, reference_signs, sectors_ahead
from ema_sim.plant.mechanics import load_at, move
from ema_sim.plant.modulation import control_phases, field_control
from ema_sim.plant.parts import Legs, Load
from ema_sim.plant.prepared import (
    constants_of_phases,
    largest_angle,
    longest_step,
    masses_of,
    sensors_of,
    winding_of,
)

MAX_STEP = 50e-6
"""Longest step (s); the 2 f_e line moves by 0.2 % or less from here to 5 µs."""
OK, NOT_FINITE, TOO_MANY_STEPS = 0, 1, 2
MAX_STEPS_A_SAMPLE = 20_000
TRACE_NAMES = ("motor_torque[N m]", "shaft_torque[N m]", "surface_speed[rad/s]")
ON_EDGE = 5e-10
"""Angle (rad) from which on a commutation edge counts as reached."""


def kernel(kind: int = RELAY, switching: bool = False) -> Callable[..., int]:
    """Return the compiled kernel of a kind of drive, of the present sources (see `compile`).

    `switching` simulates the edges of the carrier; otherwise the voltages are means over its
    period. A relay always switches.
    """
    return _build(source_hash("ema_sim.plant.kernel"), kind, switching and kind != RELAY)


@cache
def _build(sources: str, kind: int, switching: bool) -> Callable[..., int]:
    relays, field, alone = kind == RELAY, kind == FOC, kind == PWM_INDEPENDENT

    @njit(cache=True, error_model="numpy", nogil=True)
    def advance(
        a: Actuator, e: Effects, state: np.ndarray, command: np.ndarray, noise: np.ndarray,
        inverter_on: float, rate: float, max_step: float, out: np.ndarray, trace: np.ndarray,
        bus: np.ndarray, block: int,
    ) -> int:  # fmt: skip
        """Advance `state` by ``len(out)`` samples.

        Parameters
        ----------
        a, e : parameters of the actuator and of the effects.
        state : ndarray, shape (N_STATE,), in and out.
        command : ndarray, shape (m,), surface positions (rad) at this and the next periods.
        noise : ndarray, shape (m, 2), added to measured speed (rad/s) and position (rad).
        inverter_on : from when the inverter drives (s). rate : 1/s. max_step : longest step (s).
        out : ndarray, shape (n, 10), filled: means over each sample, or instants in it, without
            converters and without the current noise.
        trace : ndarray, shape (n, 3) or (0, 3), filled: means of `TRACE_NAMES`.
        bus : ndarray, shape (k,), filled: bus current (A), a mean over `block` samples each.
        """
        _ = sources
        w, m, x = winding_of(a, e), masses_of(a, e), sensors_of(a, e)
        max_step = min(max_step, longest_step(a, w, m))
        fixed = circuit_of(w.r_a, w.r_b, w.r_c, w.g_a, w.g_b, w.g_c)
        max_angle = largest_angle(a, e)
        motor, control, drive = a.motor, a.control, a.drive
        pairs, keep_trace = w.pairs, len(trace) > 0
        band = a.inverter.hysteresis
        band_a, band_b, band_c = band / x.gain_a, band / x.gain_b, band / x.gain_c
        late = x.delay + a.acquisition.reference_latency
        set_periods, set_part = int(x.delay), x.delay % 1.0 * control.period
        act_periods, act_part = int(late), late % 1.0 * control.period
        lag = pairs * a.acquisition.commutation_latency * control.period
        carrier_period, time_at = 1.0 / drive.pwm_frequency, a.acquisition.time_at

        t = state[st.TIME]
        i_a, i_b, i_c = state[st.I_A], state[st.I_B], state[st.I_C]
        w_m, q_m = state[st.OMEGA_M], state[st.THETA_M]
        w_s, q_s = state[st.OMEGA_S], state[st.THETA_S]
        q_e, q_0 = state[st.THETA_E], state[st.THETA_0]
        s_a, s_b, s_c = state[st.LEG_A], state[st.LEG_B], state[st.LEG_C]
        al_m, al_s = state[st.ALPHA_M], state[st.ALPHA_S]
        i_set, i_act, drawn = state[st.I_SET], state[st.I_ACT], state[st.I_BUS]
        x_a, x_b, x_c = state[st.U_A], state[st.U_B], state[st.U_C]
        set_next, set_at = state[st.SET_NEXT], state[st.SET_AT]
        act_next, act_at = state[st.ACT_NEXT], state[st.ACT_AT]
        history = state[st.HISTORY:]
        n_w, n_q = state[st.SPEED_NOISE], state[st.POSITION_NOISE]
        tick, sample, carrier = int(state[st.TICK]), int(state[st.SAMPLE]), int(state[st.CARRIER])
        sector, acting = int(state[st.SECTOR]), int(state[st.ACTING])
        gap, direction = state[st.EDGE], state[st.DIRECTION]
        t_tick, t_carrier = tick * control.period, carrier * carrier_period
        first_tick, steps, reading, before, begun, charge = tick, 0, 0, 0.0, 0, 0.0
        rail = w.rail - ports.rail_drop(e, drawn)
        e_terminal = e_copper = e_motor = e_friction_m = e_friction_s = e_shaft = e_load = 0.0

        sine = cosine = sine1 = cosine1 = 0.0
        if w.sines:
            sine, cosine = math.sin(q_e), math.cos(q_e)
        k_a, k_b, k_c = constants_of_phases(w, a, e, q_e, sine, cosine, q_m + q_0)
        load = load_at(a, e, m, q_m, q_m + q_0, q_s, w_m, w_s)
        if not math.isnan(state[st.SHAFT_TORQUE]):
            load = Load(
                state[st.SHAFT_TORQUE], state[st.MOTOR_LOAD], load.surface, load.slope)
        aim_a = aim_b = aim_c = next_a = next_b = next_c = ref_a = ref_b = ref_a1 = ref_b1 = 0.0
        changed = True

        for row in range(len(out)):
            t_edge, t_at = (sample + 1) / rate, (sample + time_at) / rate
            m_w = m_n = m_a = m_b = m_ra = m_rb = m_e = m_s = m_t = m_sh = m_ws = 0.0
            steps_here = 0
            while True:
                # Events that are due: control period, commutation, carrier.
                on = t >= inverter_on - SAME_TIME
                if t >= set_at - SAME_TIME:
                    i_set, set_at, changed = set_next, NEVER, True
                if t >= act_at - SAME_TIME:
                    i_act, act_at, changed = act_next, NEVER, True
                if t >= t_tick - SAME_TIME:
                    index = min(tick - first_tick, len(command) - 1)
                    n_w, n_q = noise[index, 0], noise[index, 1]
                    tick += 1
                    t_tick = tick * control.period
                    i_ref, integral = 0.0, 0.0
                    if on:
                        factor = sensor_ports.speed_factor(e, q_m + q_0)
                        speed = quantise(
                            w_m * factor + n_w, x.speed_step, a.converters.speed_range)
                        position = quantise(
                            q_s + x.position_offset + n_q, x.position_step,
                            a.converters.position_range)
                        i_ref, integral = reference_current(
                            control, a.inverter.current_limit, command[index], position, speed,
                            state[st.INTEGRAL],
                        )
                    state[st.INTEGRAL] = integral
                    history[tick % len(history)] = i_ref
                    i_set, set_next, set_at = arriving(
                        history, tick, set_periods, set_part, t, i_set)
                    i_act, act_next, act_at = arriving(
                        history, tick, act_periods, act_part, t, i_act)
                    changed = True
                if field:
                    wave = sine * x.cosine + cosine * x.sine
                    quadrature = cosine * x.cosine - sine * x.sine
                    ref_a, ref_b, _ = of_phases(i_set * wave, i_set * quadrature)
                else:
                    if gap < ON_EDGE or direction * w_m < 0.0:
                        direction = 1.0 if w_m >= 0.0 else -1.0
                        sector, acting, gap = sectors_ahead(q_e + x.angle, lag * w_m, direction)
                        changed = True
                    if changed:
                        sign_a, sign_b, _ = reference_signs(sector)
                        late_a, late_b, _ = reference_signs(acting)
                        ref_a, ref_b = sign_a * i_set, sign_b * i_set
                        aim_a, aim_b, aim_c = sensor_ports.read_as(x, late_a, late_b, i_act)
                        next_a, next_b, next_c = sensor_ports.read_as(x, late_a, late_b, act_next)
                        changed = False
                if not relays and t >= t_carrier - SAME_TIME:
                    if not on:
                        s_a = s_b = s_c = x_a = x_b = x_c = 0.0
                    elif field:
                        s_a, s_b, s_c, x_a, x_b = field_control(
                            drive, rail, wave, quadrature, lag * w_m, i_act,
                            i_a * x.gain_a + x.offset_a, i_b * x.gain_b + x.offset_b,
                            i_c * x.gain_c + x.offset_c, x_a, x_b,
                        )
                    else:
                        s_a, s_b, s_c, x_a, x_b, x_c = control_phases(
                            alone, drive, rail, (aim_a - i_a) * x.gain_a,
                            (aim_b - i_b) * x.gain_b, (aim_c - i_c) * x.gain_c, x_a, x_b, x_c,
                        )
                    carrier += 1
                    t_carrier = carrier * carrier_period

                # Length of the step, to the next event.
                h = min(max_step, t_edge - t, t_tick - t)
                if not relays:  # a relay's step goes on while the currents it aims at change
                    h = min(h, t_carrier - t, set_at - t if field else NEVER)
                if not on:
                    h = min(h, inverter_on - t)
                turning = abs(w_m)
                if not field and gap < pairs * turning * h:
                    h = gap / (pairs * turning)
                if max_angle < turning * h:
                    h = max_angle / turning
                if x.instant:
                    if t_at - SAME_TIME <= t <= t_at + SAME_TIME:
                        m_w, m_n, m_e, m_s = w_m, n_w, q_m, q_s + n_q
                        m_a, m_b, m_ra, m_rb = i_a, i_b, ref_a, ref_b
                    elif t < t_at < t + h:
                        h = t_at - t
                h = max(SAME_TIME, h)

                # Prediction of the mechanics; the currents; the laws at the end of the step.
                w_p, ws_p = w_m + al_m * h, w_s + al_s * h
                w_p = 0.0 if w_p * w_m < 0.0 else w_p
                ws_p = 0.0 if ws_p * w_s < 0.0 else ws_p
                dq = 0.5 * h * (w_m + w_p)
                q_m1, q_s1 = q_m + dq, q_s + 0.5 * h * (w_s + ws_p)
                q_r1 = q_m1 + q_0
                q_e1 = q_e + pairs * dq
                q_e1 = q_e1 - TURN if q_e1 >= TURN else q_e1
                q_e1 = q_e1 + TURN if q_e1 < 0.0 else q_e1
                gap -= pairs * abs(dq)
                if w.sines:
                    sine1, cosine1 = math.sin(q_e1), math.cos(q_e1)
                k_a1, k_b1, k_c1 = constants_of_phases(w, a, e, q_e1, sine1, cosine1, q_r1)
                per = 1.0 / h
                f = advance_currents(
                    relays, switching, keep_trace, on, e, w, rail, motor.torque_limit, fixed,
                    Legs(s_a, s_b, s_c, aim_a, aim_b, aim_c, band_a, band_b, band_c, act_at,
                         next_a, next_b, next_c, t_carrier - carrier_period, carrier_period),
                    t, h, per, i_a, i_b, k_a, k_b, k_c, w_m, k_a1, k_b1, k_c1, w_p,
                )
                if f.switches > MOST_SWITCHES:
                    return TOO_MANY_STEPS
                added = added1 = 0.0
                if not m.smooth:
                    added = ports.added_motor_torque(e, motor, k_a, k_b, k_c, w_m, q_m + q_0)
                    added1 = ports.added_motor_torque(e, motor, k_a1, k_b1, k_c1, w_p, q_r1)
                load1 = load_at(a, e, m, q_m1, q_r1, q_s1, w_p, ws_p)
                n = move(
                    a, e, m, h, f.impulse * per + added, f.impulse * per + added1,
                    w_m, w_p, w_s, ws_p, q_s1, load, load1,
                )

                # Means over the sample (of the mechanics: twice the integral); energies.
                if field:
                    wave = sine1 * x.cosine + cosine1 * x.sine
                    quadrature = cosine1 * x.cosine - sine1 * x.sine
                    ref_a1, ref_b1, _ = of_phases(i_set * wave, i_set * quadrature)
                    asked_a, asked_b = h * (ref_a + ref_a1), h * (ref_b + ref_b1)
                else:
                    since = max(0.0, t + h - set_at)
                    i_end = set_next if since > 0.0 else i_set
                    asked = 2.0 * (h * i_set + since * (i_end - i_set))
                    ref_a1, ref_b1 = sign_a * i_end, sign_b * i_end
                    asked_a, asked_b = sign_a * asked, sign_b * asked
                if not x.instant:
                    m_w += h * (w_m + n.w_m)
                    m_n += h * n_w
                    m_a, m_b = m_a + f.charge_a, m_b + f.charge_b
                    m_ra, m_rb = m_ra + asked_a, m_rb + asked_b
                    m_e += h * (q_m + q_m1)
                    m_s += h * (q_s + n.q_s + 2.0 * n_q)
                drawn, supplied = ports.supply(e, drawn, f.bus_charge, h)
                charge += supplied
                rail = w.rail - ports.rail_drop(e, drawn)
                if keep_trace:
                    moving_m, moving_s = 0.5 * (w_m + n.w_m), 0.5 * (w_s + n.w_s)
                    m_t += f.impulse + 0.5 * h * (added + added1)
                    m_sh += 0.5 * h * (load.shaft + load1.shaft)
                    m_ws += h * moving_s
                    e_terminal += f.terminal
                    e_copper += f.copper
                    e_motor += (f.impulse + 0.5 * h * (added + added1)) * moving_m
                    e_friction_m += h * moving_m * (
                        math.copysign(n.dry, moving_m)
                        + ports.motor_viscous_friction(e, motor, moving_m)
                    )
                    e_friction_s += h * moving_s * (
                        math.copysign(m.dynamic_s, moving_s)
                        + a.surface.viscous_friction * moving_s)
                    e_shaft += 0.5 * h * moving_m * (
                        load.shaft * load.slope + load1.shaft * load1.slope)
                    e_shaft -= 0.5 * h * (load.shaft + load1.shaft) * moving_s
                    e_load += 0.5 * h * (load.surface + load1.surface) * moving_s

                t += h
                i_a, i_b, i_c = f.i_a, f.i_b, -f.i_a - f.i_b
                w_m, q_m, w_s, q_s, q_e = n.w_m, q_m1, n.w_s, n.q_s, q_e1
                al_m, al_s, load = n.al_m, n.al_s, load1
                k_a, k_b, k_c, sine, cosine = k_a1, k_b1, k_c1, sine1, cosine1
                if relays:
                    s_a, s_b, s_c = f.s_a, f.s_b, f.s_c
                steps_here += f.switches
                if t >= t_edge - SAME_TIME:
                    break
                if steps_here > MAX_STEPS_A_SAMPLE:
                    return TOO_MANY_STEPS

            if x.instant and t_at >= t - SAME_TIME:
                m_w, m_n, m_e, m_s = w_m, n_w, q_m, q_s + n_q
                m_a, m_b, m_ra, m_rb = i_a, i_b, ref_a1, ref_b1
            sample, steps = sample + 1, steps + steps_here
            whole, half = (1.0, 1.0) if x.instant else (rate, 0.5 * rate)
            theta_r = m_e * half + q_0
            out[row, 0] = t_at
            out[row, 1] = m_w * half * sensor_ports.speed_factor(e, theta_r) + m_n * whole
            out[row, 2] = m_a * whole * x.gain_a + x.offset_a
            out[row, 3] = m_b * whole * x.gain_b + x.offset_b
            out[row, 4] = (-m_a - m_b) * whole * x.gain_c + x.offset_c
            out[row, 5], out[row, 6], out[row, 7] = m_ra * half, m_rb * half, (-m_ra - m_rb) * half
            out[row, 8] = theta_r * pairs + x.angle
            out[row, 9] = m_s * half + x.position_offset
            if row + 1 - begun == block or row + 1 == len(out):
                bus[reading] = (charge - before) * rate / (row + 1 - begun)
                reading, before, begun = reading + 1, charge, row + 1
            if keep_trace:
                trace[row, 0], trace[row, 1], trace[row, 2] = m_t * rate, m_sh * rate, m_ws * rate
            if not math.isfinite(m_w + m_a + m_s):
                return NOT_FINITE

        state[st.I_A], state[st.I_B], state[st.I_C] = i_a, i_b, i_c
        state[st.OMEGA_M], state[st.THETA_M], state[st.THETA_E] = w_m, q_m, q_e
        state[st.TIME], state[st.OMEGA_S], state[st.THETA_S] = t, w_s, q_s
        state[st.LEG_A], state[st.LEG_B], state[st.LEG_C] = s_a, s_b, s_c
        state[st.ALPHA_M], state[st.ALPHA_S] = al_m, al_s
        state[st.I_SET], state[st.I_ACT], state[st.I_BUS] = i_set, i_act, drawn
        state[st.SET_NEXT], state[st.SET_AT] = set_next, set_at
        state[st.ACT_NEXT], state[st.ACT_AT] = act_next, act_at
        state[st.U_A], state[st.U_B], state[st.U_C] = x_a, x_b, x_c
        state[st.SECTOR], state[st.ACTING] = sector, acting
        state[st.EDGE], state[st.DIRECTION] = gap, direction
        state[st.SHAFT_TORQUE], state[st.MOTOR_LOAD] = load.shaft, load.motor
        state[st.SPEED_NOISE], state[st.POSITION_NOISE] = n_w, n_q
        state[st.TICK], state[st.SAMPLE], state[st.CARRIER] = tick, sample, carrier
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
