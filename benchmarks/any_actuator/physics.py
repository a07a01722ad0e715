"""The second simulator: equations of a servo drive, written from the physics alone.

It shares no law, integrator, controller or acquisition with `ema_sim`. The angle θ is of the
rotor, mechanical; p θ electrical; φ = 0, 120°, 240°::

    L_k di_k/dt = v_k − v_n − R_k i_k − k_k(θ) ω          Σ i_k = 0 gives v_n; trapezoidal rule
    J dω/dt  = Σ k_k(θ) i_k + cogging − B ω − T_s/N − dry  ω, then θ: semi-implicit Euler
    Jx dv/dt = T_s + load − Bx v − dry
    T_s = K z + C dz/dt,  z: twist θ/N + mesh(θ) − x beyond half the lost motion, never pulling

Dry friction is an impulse that a step can take up at most, of a level that falls from static to
dynamic within a small speed (Stribeck); what cannot overcome it stands still (Moreau 1988).
A relay switches where its current crosses the band, also inside a step; a pulse width modulator
likewise where the triangular carrier crosses the demand. Dead time takes 2 t_d f of the rail.
Commutation by sectors of 60° from 30° on; with `foc` sinusoidal references q, d = 0.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from numba import njit

from benchmarks.any_actuator.described import Damage, Own, Surroundings
from ema_record.actuator import FOC, HARMONICS, NOISE_RATE, RELAY, Actuator, Drive
from ema_record.channels import ROTOR_ANGLE
from ema_record.profile import Profile

COPPER, MAGNET = 0.00393, -0.0011
"""Change of R and of k a degree from 20 degC (IEC 60028; NdFeB)."""
GRID = 2048
"""Points of the rotor's table an electrical turn."""
SIGNS = np.array([[1, -1, 0], [1, 0, -1], [0, 1, -1], [-1, 1, 0], [-1, 0, 1], [0, -1, 1]], float)
"""Of the reference currents, sectors from 30° electrical."""
LONGEST_STEP = 1e-6
"""s."""
PHI = 2.0 * math.pi / 3.0
SAME, USUAL, SOUND = Own(), Surroundings(), Damage()


def shape(a: Actuator, rounding: float, angle: np.ndarray) -> np.ndarray:
    """Return k(θ)/k of a phase at electrical angles over whole turns, evenly spaced."""
    m = a.motor
    if m.back_emf == HARMONICS:
        odd = ((3, m.harmonic_3), (5, m.harmonic_5), (7, m.harmonic_7))
        return np.asarray(np.sin(angle) + sum(h * np.sin(n * angle) for n, h in odd))
    edge = 0.5 * (math.pi - m.flat_top)
    sharp = np.clip(np.arcsin(np.clip(np.sin(angle), -1.0, 1.0)) / edge, -1.0, 1.0)
    line = np.fft.rfftfreq(len(angle), 1.0 / len(angle)) / m.pole_pairs
    return np.fft.irfft(np.fft.rfft(sharp) * np.exp(-0.5 * (line * rounding) ** 2), len(angle))


def rotor_table(a: Actuator, own: Own, d: Damage, temperature: float) -> np.ndarray:
    """Return k of the three phases, cogging torque and gear error over a turn of the rotor.

    Shape (n + 1, 5), the last row is the first.
    """
    theta = np.linspace(0.0, 2.0 * np.pi, GRID * a.motor.pole_pairs, endpoint=False)
    electrical, table = a.motor.pole_pairs * theta, np.empty((len(theta) + 1, 5))
    k = a.motor.back_emf_constant * (1.0 + MAGNET * (temperature - 20.0))
    unit = shape(a, own.rounding, electrical)
    for n, own_part in enumerate((a.motor.back_emf_deviation_a, a.motor.back_emf_deviation_b,
                                  a.motor.back_emf_deviation_c)):
        lag = 2.0 * np.pi * n / 3.0
        gap = 1.0 + d.eccentricity * np.cos(theta - d.angle - (lag if d.shifted else 0.0))
        turns = 1.0 - d.short if n == d.phase else 1.0
        late = np.interp(electrical - lag, electrical[:GRID], unit[:GRID], period=2.0 * np.pi)
        table[:-1, n] = k * (1.0 + own_part) * (1.0 - d.demagnetisation) * turns * gap * late
    table[:-1, 3] = d.cogging * np.sin(6.0 * electrical)
    table[:-1, 4] = d.mesh * np.sin(17.0 * theta)
    table[-1] = table[0]
    return table


@njit(cache=True)
def _slide(speed: float, force: float, inertia: float, dry: float, stuck: float, knee: float,
           dt: float) -> float:
    """Return the speed after a step under a force and dry friction."""
    level = dry
    if abs(speed) < 4.0 * knee:
        level = dry + (stuck - dry) * math.exp(-((speed / knee) ** 2))
    free, most = speed + dt * force / inertia, dt * level / inertia
    return free - most if free > most else free + most if free < -most else 0.0


@njit(cache=True)
def _rounded(value: float, bit: float) -> float:
    return bit * math.floor(value / bit + 0.5) if bit > 0.0 else value


@njit(cache=True)
def _six_step(drive: Drive, rail: float, wanted: np.ndarray, read: np.ndarray,
              integral: np.ndarray, leg: np.ndarray) -> None:
    """Set the legs' demands, in rails, by a PI control a phase; once a carrier period."""
    for n in range(3):
        error = wanted[n] - read[n]
        raw = drive.proportional_gain * error + integral[n]
        leg[n] = min(max(raw / rail, -1.0), 1.0)
        if abs(raw) <= rail or raw * error < 0.0:
            integral[n] += drive.integral_gain * error / drive.pwm_frequency


@njit(cache=True)
def _field_oriented(drive: Drive, rail: float, wanted: np.ndarray, read: np.ndarray,
                    angle: float, integral: np.ndarray, leg: np.ndarray) -> None:
    """Set the legs' demands by PI controls of the currents along q (sine) and d (cosine)."""
    error, raw = np.zeros(2), np.zeros(2)
    for n in range(3):
        share = 2.0 / 3.0 * (wanted[n] - read[n])
        error[0] += share * math.sin(angle - PHI * n)
        error[1] += share * math.cos(angle - PHI * n)
    for axis in range(2):
        raw[axis] = drive.proportional_gain * error[axis] + integral[axis]
    size = math.hypot(raw[0], raw[1])
    for axis in range(2):
        if size <= rail or raw[axis] * error[axis] < 0.0:
            integral[axis] += drive.integral_gain * error[axis] / drive.pwm_frequency
    for n in range(3):
        volts = raw[0] * math.sin(angle - PHI * n) + raw[1] * math.cos(angle - PHI * n)
        leg[n] = volts / max(size, rail)


@njit(cache=True)
def _on_share(demand: float, phase: float, step: float) -> float:
    """Return the mean of a leg, in rails, over a step of the carrier's period."""
    after = phase + step
    one = 1.0 - 4.0 * abs(phase - 0.5)
    two = 1.0 - 4.0 * abs((after if after < 1.0 else 2.0 - after) - 0.5)
    low, high = min(one, two), max(one, two)
    return 2.0 * min(max((demand - low) / (high - low + 1e-12), 0.0), 1.0) - 1.0


@njit(cache=True)
def _windings(i: np.ndarray, v: np.ndarray, k: np.ndarray, omega: float, loss: np.ndarray,
              gains: np.ndarray, part: float, new: np.ndarray) -> None:
    """Set the currents after a part of a step; the neutral's voltage keeps their sum at zero."""
    neutral = 0.0
    for n in range(3):
        new[n] = i[n] + part * (gains[n] * (v[n] - k[n] * omega) - loss[n] * i[n])
        neutral += new[n]
    neutral /= gains.sum()
    for n in range(3):
        new[n] -= gains[n] * neutral


@njit(cache=True)
def _relays(band: float, rail: float, wanted: np.ndarray, gain: np.ndarray, shift: np.ndarray,
            leg: np.ndarray, k: np.ndarray, omega: float, loss: np.ndarray, gains: np.ndarray,
            now: np.ndarray, v: np.ndarray, new: np.ndarray) -> None:
    """Set the currents after a step; a relay switches where its current crosses the band.

    From crossing to crossing; `now` begins as the currents, `v` becomes the legs' means.
    """
    left, mean = 1.0, np.zeros(3)
    for _ in range(12):
        for n in range(3):
            v[n] = rail * leg[n]
        _windings(now, v, k, omega, loss, gains, left, new)
        first, who = 1.0, -1
        for n in range(3):
            room = band + leg[n] * (wanted[n] - gain[n] * now[n] - shift[n])
            closer = leg[n] * gain[n] * (new[n] - now[n])
            if room < max(closer, 0.0) and max(room, 0.0) <= first * abs(closer):
                first, who = max(room, 0.0) / max(closer, 1e-12), n
        for n in range(3):
            mean[n] += first * left * v[n]
            now[n] += first * (new[n] - now[n])
        if who < 0:
            break
        leg[who] = -leg[who]
        left *= 1.0 - first
    v[:] = mean


@njit(cache=True)
def _run(a: Actuator, own: Own, s: Surroundings, d: Damage, averaged: bool, table: np.ndarray,
         command: np.ndarray, noise: np.ndarray, start: float, off: float, per_period: int,
         per_sample: int, n_out: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return samples (n_out, 10), bus current (n_out,), energies (6,): the equations in time."""
    out, bus, energy, total = np.zeros((n_out, 10)), np.zeros(n_out), np.zeros(6), np.zeros(9)
    motor, surface, shaft, control, q = a.motor, a.surface, a.shaft, a.control, a.acquisition
    relay, foc, f = a.drive.kind == RELAY, a.drive.kind == FOC, a.drive.pwm_frequency
    dt, turn, grid = control.period / per_period, 2.0 * math.pi, len(table) - 1
    ratio, limit = a.gear.ratio, a.inverter.current_limit
    i, new, read, ref, wanted = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    leg, v, k, integral, shift = np.ones(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    R, gain, loss, gains, now = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for n in range(3):
        mine = 1.0 if n == d.phase else 0.0
        R[n] = motor.phase_resistance * (1.0 + COPPER * (s.temperature - 20.0))
        R[n] *= (1.0 + mine * d.resistance) * (1.0 - mine * d.short)
        L = motor.phase_inductance * (1.0 - mine * d.short) ** 2
        loss[n] = dt * R[n] / L / (1.0 + 0.5 * dt * R[n] / L)
        gains[n] = dt / L / (1.0 + 0.5 * dt * R[n] / L)
        gain[n] = 1.0 + s.gain[n] + mine * d.current_gain
    more, more_x = 1.0 + d.motor_friction, 1.0 + d.surface_friction
    dry, stuck = more * motor.dynamic_friction, more * motor.static_friction
    dry_x, stuck_x = more_x * surface.dynamic_friction, more_x * surface.static_friction
    knee, half = own.stribeck * control.speed_limit, 0.5 * (shaft.backlash + d.backlash)
    speed_bit = a.converters.speed_range / 2.0**a.converters.speed_bits * q.converters
    position_bit = a.converters.position_range / 2.0**a.converters.position_bits * q.converters
    late = np.zeros(256)  # reference currents of the last control periods
    angles = np.zeros(1 + int(q.commutation_latency * per_period + 0.5))  # of the last steps
    turned, omega, x, speed_x, i_z, amplitude, drawn = 0.0, 0.0, start, 0.0, 0.0, 0.0, 0.0
    valley, at = -1, int(q.time_at * (per_sample - 1) + 0.5)
    for step in range(n_out * per_sample):
        t, tick, failed = step * dt, step // per_period, step * dt >= d.event
        on, slip = t >= off - 0.5 * dt, d.slip if failed else 0.0
        if step % per_period == 0:  # position P and speed PI with conditional integration
            seen = _rounded(x + noise[tick, 1] + slip, position_bit)
            seen_speed = _rounded((1.0 + d.speed_gain) * omega + noise[tick, 0], speed_bit)
            goal = control.position_gain * (command[tick] - seen)
            lack = min(max(goal, -control.speed_limit), control.speed_limit) - seen_speed
            raw = control.proportional_gain * lack + control.integral_gain * i_z
            amplitude = min(max(raw, -limit), limit)
            if raw == amplitude or raw * lack < 0.0:
                i_z += lack * control.period
            if not on:
                amplitude = i_z = 0.0
            late[tick % len(late)] = amplitude
        past = math.floor(step / per_period - q.reference_latency + 1e-9)
        acting = late[past % len(late)] if past >= 0 else 0.0
        theta = (s.start_angle + turned) % turn
        row = min(int(theta / turn * grid), grid - 1)
        part = theta / turn * grid - row
        sensed = motor.pole_pairs * theta + d.hall
        angles[step % len(angles)] = sensed
        known = angles[(step + 1) % len(angles)]  # to the drive
        sector = math.floor(sensed / turn * 6.0 - 0.5) % 6
        driven = math.floor(known / turn * 6.0 - 0.5) % 6
        for n in range(3):
            k[n] = table[row, n] + part * (table[row + 1, n] - table[row, n])
            wave = math.sin(sensed - PHI * n) if foc else SIGNS[sector, n]
            old_wave = math.sin(known - PHI * n) if foc else SIGNS[driven, n]
            ref[n], wanted[n] = amplitude * wave, acting * old_wave
            shift[n] = s.offset[n] + own.offset_drift[n] * t
            if failed and n == d.phase:
                shift[n] += d.current_offset
            read[n] = gain[n] * i[n] + shift[n]
        rail = a.inverter.bus_voltage * (1.0 + s.bus) - 0.5 * d.sag * drawn
        torque, source = 0.0, 0.0
        if on:
            if not relay and math.floor(t * f + 1e-9) != valley:
                valley = math.floor(t * f + 1e-9)
                if foc:
                    _field_oriented(a.drive, rail, wanted, read, known, integral, leg)
                else:
                    _six_step(a.drive, rail, wanted, read, integral, leg)
            if relay:
                now[:] = i
                _relays(a.inverter.hysteresis, rail, wanted, gain, shift, leg, k, omega, loss,
                        gains, now, v, new)
            else:
                for n in range(3):
                    late_edge = min(max(i[n] / (0.01 * limit), -1.0), 1.0)
                    share = leg[n] - 2.0 * own.dead_time * f * late_edge
                    v[n] = rail * (share if averaged else _on_share(share, t * f - valley, dt * f))
                _windings(i, v, k, omega, loss, gains, 1.0, new)
            for n in range(3):
                middle = 0.5 * (i[n] + new[n])
                torque += k[n] * middle
                source += 0.5 * v[n] * middle / rail
                energy[1] += R[n] * middle * middle * dt
                i[n] = new[n]
        energy[0] += 2.0 * rail * source * dt
        drawn += dt / 1e-3 * (source - drawn)  # through the supply's capacitor, 1 ms
        torque = min(max(torque, -motor.torque_limit), motor.torque_limit)
        cog = table[row, 3] + part * (table[row + 1, 3] - table[row, 3])
        mesh = table[row, 4] + part * (table[row + 1, 4] - table[row, 4])
        twist = turned / ratio + start + mesh - x
        z = twist - min(max(twist, -half), half)
        pull = shaft.stiffness * z + shaft.damping * (omega / ratio - speed_x)
        pull = pull if pull * z > 0.0 else 0.0
        back = pull / ratio
        back *= 1.0 / a.gear.efficiency if back * omega > 0.0 else a.gear.efficiency
        before, before_x = omega, speed_x
        omega = _slide(omega, torque + cog - back - motor.viscous_friction * omega,
                       motor.inertia, dry, stuck, knee, dt)
        speed_x = _slide(speed_x, pull + s.load - surface.viscous_friction * speed_x,
                         surface.inertia, dry_x, stuck_x, knee / ratio, dt)
        turned, x = turned + dt * omega, x + dt * speed_x
        if abs(x) > surface.end_stop:
            x, speed_x = math.copysign(surface.end_stop, x), 0.0
        energy[2] += torque * 0.5 * (before + omega) * dt
        energy[3] += dt * (motor.viscous_friction * omega**2 + dry * abs(omega)
                           + surface.viscous_friction * speed_x**2 + dry_x * abs(speed_x))
        if pull != 0.0:
            energy[4] += dt * shaft.damping * (before / ratio - before_x) ** 2
        energy[5] = 0.5 * (motor.inertia * omega**2 + surface.inertia * speed_x**2
                           + shaft.stiffness * z**2)
        for n in range(3):
            total[n], total[3 + n] = total[n] + read[n], total[3 + n] + ref[n]
        total[6] += (1.0 + d.speed_gain) * before + noise[tick, 0]
        total[7] += x + noise[tick, 1] + slip
        total[8] += turned
        sample, inside = step // per_sample, step % per_sample
        bus[sample] += source / per_sample
        if inside == (at if q.sampling else per_sample - 1):
            share = 1.0 if q.sampling else 1.0 / per_sample
            out[sample, 0] = (sample + q.time_at) * per_sample * dt
            out[sample, 1], out[sample, 9] = share * total[6], share * total[7]
            out[sample, 8] = motor.pole_pairs * (s.start_angle + share * total[8]) + d.hall
            for n in range(6):
                out[sample, 2 + n] = share * total[n]
        if q.sampling or inside == per_sample - 1:
            total[:] = 0.0
    return out, bus, energy


def steps_of(a: Actuator, longest: float) -> tuple[int, int]:
    """Return the steps a control period and a sample, each at most `longest` (s)."""
    period = Fraction(a.control.period).limit_denominator(10**8)
    sample = 1 / Fraction(a.acquisition.rate).limit_denominator(1000)
    common = Fraction(math.gcd(period.numerator * sample.denominator,
                               sample.numerator * period.denominator),
                      period.denominator * sample.denominator)
    step = common / math.ceil(float(common) / longest * (1.0 - 1e-9))
    return int(period / step), int(sample / step)


def run(a: Actuator, profile: Profile, own: Own = SAME, s: Surroundings = USUAL,
        d: Damage = SOUND, *, seed: int = 0, averaged: bool = False,
        longest: float = LONGEST_STEP) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return samples (n, 10) without noise of the currents, bus current (n,) (A), energies (J).

    Energies (6,): drawn, copper, turned by the motor, friction, damping, kept at the end.

    Parameters
    ----------
    a, own, s, d : the unit, what is its own, the conditions of the test, what is wrong.
    profile : of the test.
    seed : of the noise inside the loop.
    averaged : a modulated drive without its ripple.
    longest : step (s).
    """
    per_period, per_sample = steps_of(a, longest)
    n = round(profile.duration * a.acquisition.rate)
    ticks = n * per_sample // per_period + 1
    time = (np.arange(ticks) - a.acquisition.command_latency) * a.control.period
    noise = np.random.default_rng([seed, 0]).standard_normal((ticks, 2))
    noise *= np.array([a.noise.speed * s.noise[0], a.noise.position * s.noise[1]])
    noise /= math.sqrt(a.control.period * NOISE_RATE)
    samples, bus, energy = _run(
        a, own, s, d, averaged, rotor_table(a, own, d, s.temperature),
        profile.command(time + 1e-9), noise, profile.start, profile.inverter_off,
        per_period, per_sample, n)
    samples[:, ROTOR_ANGLE] %= 2.0 * np.pi
    return samples, bus, energy
