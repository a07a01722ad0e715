"""Drives with a carrier: PI control of the currents, modulation, the carrier's edges.

The currents are sampled, and the legs' mean states set, once a period of the carrier, where it
begins (all legs at the negative rail, the middle of the ripple); they act at once. (Symmetrical
regular sampling with one update a period: Holmes and Lipo, Pulse Width Modulation for Power
Converters, 2003.) The legs are centred between the rails, which no current answers to and which
lets the whole voltage be used, but for a sine's modulation and for controls that know their own
phase alone. The control measures its bus. Integrals stop while the voltage is limited and the
errors drive it further.
"""

from __future__ import annotations

import math

from ema_record.actuator import CIRCLE, SINE, Drive
from ema_sim.effects.compile import law
from ema_sim.plant.electrical import of_phases

TWO_THIRDS = 2.0 / 3.0
SAME_TIME = 1e-12
"""Events that are less apart are one (s)."""


@law
def modulated(
    u_a: float, u_b: float, u_c: float, rail: float, modulation: int
) -> tuple[float, float, float, bool]:
    """Return mean states of the legs, -1 to 1, and whether the voltages were limited.

    Parameters
    ----------
    u_a, u_b, u_c : phase voltages asked for (V), of sum 0; shortened alike if they cannot be had.
    rail : voltage of a leg, + and - (V).
    modulation : of `MODULATIONS`: legs that are centred reach the hexagon, and the circle of
        radius 2 rail / √3 in it; others, for every direction, the circle of radius rail.
    """
    top = max(u_b, u_a)
    top = max(top, u_c)
    bottom = min(u_b, u_a)
    bottom = min(bottom, u_c)
    middle, reach = 0.5 * (top + bottom), 0.5 * (top - bottom)
    if modulation == CIRCLE:
        reach = math.sqrt(0.5 * (u_a * u_a + u_b * u_b + u_c * u_c))
    elif modulation == SINE:
        middle, reach = 0.0, math.sqrt(TWO_THIRDS * (u_a * u_a + u_b * u_b + u_c * u_c))
    limited = reach > rail
    share = 1.0 / rail
    if limited:
        share = 1.0 / reach
    return (u_a - middle) * share, (u_b - middle) * share, (u_c - middle) * share, limited


@law
def phase_control(
    d: Drive, rail: float, error_a: float, error_b: float, error_c: float,
    x_a: float, x_b: float, x_c: float,
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """Return the legs' mean states and the new integrals (V): a PI control a phase.

    Parameters
    ----------
    d : gains and frequency.
    rail : as in `modulated`.
    error_a, error_b, error_c : of the currents (A); their mean, which only an offset of the
        sensors makes, is left out: in a star it cannot be controlled.
    x_a, x_b, x_c : integrals (V).
    """
    mean = (error_a + error_b + error_c) * (1.0 / 3.0)
    error_a, error_b, error_c = error_a - mean, error_b - mean, error_c - mean
    step = d.integral_gain / d.pwm_frequency
    n_a, n_b, n_c = x_a + step * error_a, x_b + step * error_b, x_c + step * error_c
    u_a = d.proportional_gain * error_a + n_a
    u_b = d.proportional_gain * error_b + n_b
    u_c = d.proportional_gain * error_c + n_c
    m_a, m_b, m_c, limited = modulated(u_a, u_b, u_c, rail, d.modulation)
    if limited and error_a * u_a + error_b * u_b + error_c * u_c > 0.0:
        return m_a, m_b, m_c, x_a, x_b, x_c
    return m_a, m_b, m_c, n_a, n_b, n_c


@law
def leg_control(d: Drive, rail: float, error: float, x: float) -> tuple[float, float]:
    """Return the mean state of a leg and the new integral (V): a PI control of its phase alone."""
    new = x + d.integral_gain / d.pwm_frequency * error
    asked = d.proportional_gain * error + new
    if abs(asked) <= rail:
        return asked / rail, new
    if error * asked > 0.0:
        new = x
    return math.copysign(1.0, asked), new


@law
def independent_control(
    d: Drive, rail: float, error_a: float, error_b: float, error_c: float,
    x_a: float, x_b: float, x_c: float,
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """Return what `phase_control` does, of three controls each of which knows its phase alone.

    To what the sensors' offsets have in common no current answers: the integrals run away with
    K_i times it, and the middle of the voltages with them, until a leg stays at its rail.
    """
    m_a, n_a = leg_control(d, rail, error_a, x_a)
    m_b, n_b = leg_control(d, rail, error_b, x_b)
    m_c, n_c = leg_control(d, rail, error_c, x_c)
    return m_a, m_b, m_c, n_a, n_b, n_c


@law
def control_phases(
    alone: bool, d: Drive, rail: float, error_a: float, error_b: float, error_c: float,
    x_a: float, x_b: float, x_c: float,
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """Return `independent_control`, or `phase_control` unless each phase is `alone`."""
    if alone:
        return independent_control(d, rail, error_a, error_b, error_c, x_a, x_b, x_c)
    return phase_control(d, rail, error_a, error_b, error_c, x_a, x_b, x_c)


@law
def rotor_currents(
    sine: float, cosine: float, i_a: float, i_b: float, i_c: float
) -> tuple[float, float]:
    """Return the currents along d and q (A), amplitudes of the phases, q along the back-EMF.

    i_d = 2/3 Σ i_k cos(θ - φ_k), i_q = 2/3 Σ i_k sin(θ - φ_k): the back-EMF is zero at θ = 0,
    where the magnets are along -d.
    """
    s_a, s_b, s_c = of_phases(sine, cosine)
    c_a, c_b, c_c = of_phases(cosine, -sine)
    return (
        TWO_THIRDS * (i_a * c_a + i_b * c_b + i_c * c_c),
        TWO_THIRDS * (i_a * s_a + i_b * s_b + i_c * s_c),
    )


@law
def field_control(
    d: Drive, rail: float, sine: float, cosine: float, lag: float, wanted: float,
    i_a: float, i_b: float, i_c: float, x_d: float, x_q: float,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Return the legs' mean states and the new integrals (V): a PI control along d and q.

    Parameters
    ----------
    d, rail : as in `phase_control`.
    sine, cosine : of the angle of the commutation sensor.
    lag : angle (rad) that the rotor has turned since the control knew it.
    wanted : current along q (A), the amplitude of the phases'; along d it is 0.
    i_a, i_b, i_c : currents read (A).
    x_d, x_q : integrals (V).
    """
    sine_lag, cosine_lag = math.sin(lag), math.cos(lag)
    sine, cosine = (sine * cosine_lag - cosine * sine_lag,
                    cosine * cosine_lag + sine * sine_lag)
    i_d, i_q = rotor_currents(sine, cosine, i_a, i_b, i_c)
    error_d, error_q = -i_d, wanted - i_q
    step = d.integral_gain / d.pwm_frequency
    n_d, n_q = x_d + step * error_d, x_q + step * error_q
    u_d, u_q = d.proportional_gain * error_d + n_d, d.proportional_gain * error_q + n_q
    u_a, u_b, u_c = of_phases(u_q * sine + u_d * cosine, u_q * cosine - u_d * sine)
    m_a, m_b, m_c, limited = modulated(u_a, u_b, u_c, rail, d.modulation)
    if limited and error_d * u_d + error_q * u_q > 0.0:
        return m_a, m_b, m_c, x_d, x_q
    return m_a, m_b, m_c, n_d, n_q


@law
def leg_now(mean: float, begin: float, period: float, now: float) -> tuple[float, float]:
    """Return the state ±1 of a leg and the time to its next edge (s), a period or more if none.

    The pulse at the positive rail lies in the middle of the period.

    Parameters
    ----------
    mean : state in the mean of this period, -1 to 1.
    begin, period : of the carrier's period (s).
    now : time (s); on an edge (to 1e-12 s) it is behind it.
    """
    width = 0.5 * (1.0 + mean) * period
    rise = begin + 0.5 * (period - width)
    fall = rise + width
    if now < rise - SAME_TIME:
        return -1.0, rise - now
    if now < fall - SAME_TIME:
        return 1.0, fall - now
    return -1.0, period
