"""The currents over one step of the mechanics: from switch to switch of the legs.

The neutral's voltage is eliminated and with it the third current (`parts.Circuit`). Back-EMF and
torque constants go linearly in time from begin to end of the step. Between two switches the
currents follow their second-order series, i + h di/dt + h²/2 d²i/dt², of the linear circuit; a
relay's crossing is found on the same series.
"""

from __future__ import annotations

from ema_sim.effects.base import AllEffects
from ema_sim.effects.compile import law
from ema_sim.plant import ports
from ema_sim.plant.control import NEVER, clip
from ema_sim.plant.electrical import relay, time_to_switch
from ema_sim.plant.modulation import SAME_TIME, leg_now
from ema_sim.plant.parts import Circuit, Flow, Legs, Winding

THIRD_PART = 1.0 / 3.0
MOST_SWITCHES = 10_000
"""In one step; more are a fault of the parameters."""


@law
def circuit_of(
    r_a: float, r_b: float, r_c: float, g_a: float, g_b: float, g_c: float
) -> Circuit:
    """Return the circuit of phases with resistances r (Ω) and inverse inductances g (1/H).

    From L_k di_k/dt = v_k - v_n - r_k i_k - e_k and Σ i_k = 0: see `electrical`.
    """
    g_n = 1.0 / (g_a + g_b + g_c)
    a_a, a_b, a_c = g_a * (1.0 - g_a * g_n), -g_a * g_b * g_n, -g_a * g_c * g_n
    b_a, b_b, b_c = -g_b * g_a * g_n, g_b * (1.0 - g_b * g_n), -g_b * g_c * g_n
    return Circuit(
        a_a, a_b, a_c, b_a, b_b, b_c,
        a_a * r_a - a_c * r_c, a_b * r_b - a_c * r_c,
        b_a * r_a - b_c * r_c, b_b * r_b - b_c * r_c,
    )


@law
def advance_currents(
    relays: bool, switching: bool, traced: bool, on: bool, e: AllEffects, w: Winding,
    rail: float, limit: float, fixed: Circuit, legs: Legs, now: float, length: float, per: float,
    i_a: float, i_b: float,
    k_a: float, k_b: float, k_c: float, omega: float,
    k_a1: float, k_b1: float, k_c1: float, omega1: float,
) -> Flow:  # fmt: skip
    """Return the currents after a step.

    Parameters
    ----------
    relays, switching : kind of drive: hysteresis; edges of a carrier (else mean voltages).
    traced : whether energies are counted.
    on : whether the inverter drives; the currents stand still where it does not.
    e, w, legs : parameters. rail : voltage of a leg (V). limit : of the torque (N m).
    fixed : the circuit without saturation.
    now, length, per : begin of the step, its length (s) and the inverse of that.
    i_a, i_b : currents at its begin (A).
    k_a, k_b, k_c, omega : torque constants (V s/rad) and motor speed (rad/s) at its begin.
    k_a1, k_b1, k_c1, omega1 : the same at its end, predicted.
    """
    s_a, s_b, s_c = legs.s_a, legs.s_b, legs.s_c
    q_a = q_b = impulse = bus = terminal = copper = 0.0
    left, switches, c, change = length, 0, fixed, legs.change
    aim_a, aim_b, aim_c = legs.aim_a, legs.aim_b, legs.aim_c
    f_a = f_b = f_c = 1.0
    if w.varies:
        f_a, f_b = ports.saturation(e, i_a), ports.saturation(e, i_b)
        f_c = ports.saturation(e, -i_a - i_b)
        k_a, k_b, k_c = k_a * f_a, k_b * f_b, k_c * f_c
        k_a1, k_b1, k_c1 = k_a1 * f_a, k_b1 * f_b, k_c1 * f_c
        c = circuit_of(w.r_a, w.r_b, w.r_c, w.g_a / f_a, w.g_b / f_b, w.g_c / f_c)
    # Back-EMF as it moves the currents (A/s), torque a current (N m/A), with their rates.
    e_a, e_b, e_c = k_a * omega, k_b * omega, k_c * omega
    n_a = c.a_a * e_a + c.a_b * e_b + c.a_c * e_c
    n_b = c.b_a * e_a + c.b_b * e_b + c.b_c * e_c
    e_a, e_b, e_c = k_a1 * omega1 - e_a, k_b1 * omega1 - e_b, k_c1 * omega1 - e_c
    dn_a = (c.a_a * e_a + c.a_b * e_b + c.a_c * e_c) * per
    dn_b = (c.b_a * e_a + c.b_b * e_b + c.b_c * e_c) * per
    t_a, t_b = k_a - k_c, k_b - k_c
    dt_a, dt_b = (k_a1 - k_c1 - t_a) * per, (k_b1 - k_c1 - t_b) * per
    v_a = v_b = v_c = 0.0
    d_a = d_b = c_a = c_b = 0.0
    while True:
        h = left
        turn_a = turn_b = turn_c = 1.0
        if on:
            if relays:
                if now >= change - SAME_TIME:
                    change, aim_a, aim_b, aim_c = NEVER, legs.next_a, legs.next_b, legs.next_c
                over_a, over_b, over_c = i_a - aim_a, i_b - aim_b, -i_a - i_b - aim_c
                s_a = relay(s_a, over_a, legs.band_a)
                s_b = relay(s_b, over_b, legs.band_b)
                s_c = relay(s_c, over_c, legs.band_c)
            elif switching:
                s_a, to_a = leg_now(legs.s_a, legs.begin, legs.period, now)
                s_b, to_b = leg_now(legs.s_b, legs.begin, legs.period, now)
                s_c, to_c = leg_now(legs.s_c, legs.begin, legs.period, now)
                h = min(h, to_a, to_b, to_c)
            v_a, v_b, v_c = ports.leg_voltages(
                e, rail, s_a, s_b, s_c, i_a, i_b, -i_a - i_b, w.ideal)
            d_a = c.a_a * v_a + c.a_b * v_b + c.a_c * v_c - n_a - (c.a_0 * i_a + c.a_1 * i_b)
            d_b = c.b_a * v_a + c.b_b * v_b + c.b_c * v_c - n_b - (c.b_0 * i_a + c.b_1 * i_b)
            c_a = -dn_a - (c.a_0 * d_a + c.a_1 * d_b)
            c_b = -dn_b - (c.b_0 * d_a + c.b_1 * d_b)
            if relays:
                to_a = time_to_switch(s_a, over_a, d_a, c_a, legs.band_a)
                to_b = time_to_switch(s_b, over_b, d_b, c_b, legs.band_b)
                to_c = time_to_switch(s_c, over_c, -d_a - d_b, -c_a - c_b, legs.band_c)
                h = min(h, to_a, to_b, to_c, change - now)
                turn_a = -1.0 if to_a <= h else 1.0
                turn_b = -1.0 if to_b <= h else 1.0
                turn_c = -1.0 if to_c <= h else 1.0
        h = max(SAME_TIME, h)
        h = left if left - h < SAME_TIME else h

        half, third = 0.5 * h, THIRD_PART * h
        i_a1, i_b1 = i_a + h * (d_a + half * c_a), i_b + h * (d_b + half * c_b)
        m_a = h * (i_a + half * (d_a + third * c_a))
        m_b = h * (i_b + half * (d_b + third * c_b))
        q_a, q_b = q_a + m_a, q_b + m_b
        impulse += clip((t_a + half * dt_a) * m_a + (t_b + half * dt_b) * m_b, h * limit)
        n_a, n_b, t_a, t_b = n_a + h * dn_a, n_b + h * dn_b, t_a + h * dt_a, t_b + h * dt_b
        bus += (s_a - s_c) * m_a + (s_b - s_c) * m_b
        if traced:
            terminal += (v_a - v_c) * m_a + (v_b - v_c) * m_b
            i_c, i_c1 = i_a + i_b, i_a1 + i_b1
            copper += h * THIRD_PART * (
                w.r_a * (i_a * (i_a + i_a1) + i_a1 * i_a1)
                + w.r_b * (i_b * (i_b + i_b1) + i_b1 * i_b1)
                + w.r_c * (i_c * (i_c + i_c1) + i_c1 * i_c1)
            )
        i_a, i_b = i_a1, i_b1
        if relays:
            s_a, s_b, s_c = s_a * turn_a, s_b * turn_b, s_c * turn_c
        switches += 1
        left -= h
        now += h
        if left <= 0.0 or switches > MOST_SWITCHES:
            return Flow(
                i_a, i_b, s_a, s_b, s_c, q_a, q_b, impulse, 0.5 * bus, terminal, copper, switches)
