"""The reference: a plain fixed-step loop that anyone can check by reading it once.

Semi-implicit Euler at 0.1 µs: currents, then speeds, then angles; whatever may change is looked
at in every step, nothing is predicted, located or kept from the step before. The legs of drives
with a carrier always switch. It shares the laws of effects and friction with `kernel` and none
of its logic; it is some fifty times slower.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
from numba import njit

from ema_record.actuator import (
    FOC,
    HEXAGON,
    PWM_INDEPENDENT,
    RELAY,
    SINE,
    Actuator,
    Drive,
    load_actuator,
)
from ema_record.channels import N_CHANNELS
from ema_record.errors import SimulationError, UsageError
from ema_record.profile import Profile
from ema_record.record import Provenance, Record
from ema_record.sources import source_hash
from ema_record.version import VERSION
from ema_sim.acquisition import SensorNoise, convert, effective_converters
from ema_sim.effects import Effects
from ema_sim.effects.compile import law
from ema_sim.machine import FIRST_EDGE, SECTOR
from ema_sim.plant import ports, sensor_ports
from ema_sim.plant import state as st
from ema_sim.plant.control import clip, quantise, speed_control
from ema_sim.plant.electrical import reference_signs, wrap
from ema_sim.plant.mechanics import net_torque, shaft_torque

STEP = 1e-7
"""Default step (s)."""
BUS_CURRENT = N_CHANNELS
"""Column of the loop's output that no channel has: mean bus current (A)."""
AUXILIARY_PERIOD = 0.1
THIRD = 2.0 * math.pi / 3.0


@law
def sector_of(theta: float) -> int:
    """Return the commutation sector 0..5 of the paper's Table 1; sector 0 is 30° to 90°."""
    return math.floor((theta - FIRST_EDGE) / SECTOR) % 6


@njit(cache=True, error_model="numpy")
def current_control(
    drive: Drive, rail: float, theta: float, amplitude: float, wanted: np.ndarray,
    sensed: np.ndarray, integral: np.ndarray, mean: np.ndarray,
) -> None:
    """Set the legs' means, -1 to 1, once a period of the carrier, and the integrals (V).

    `theta` is the angle (rad) and `amplitude` the current (A) of a control in the rotor's axes,
    `wanted` the phase currents (A) of the other; `sensed` are the phase currents read (A).
    """
    axes = 2 if drive.kind == FOC else 3
    turn, error = np.zeros((axes, 3)), np.zeros(axes)
    for j in range(3):
        if axes == 2:
            turn[0, j], turn[1, j] = math.cos(theta - j * THIRD), math.sin(theta - j * THIRD)
        else:
            turn[j, j] = 1.0
    if axes == 2:
        error[1] = amplitude
        error -= 2.0 / 3.0 * turn @ sensed
    else:
        error += wanted - sensed
    if drive.kind == PWM_INDEPENDENT:
        for j in range(3):
            asked_j = integral[j] + (drive.proportional_gain
                                     + drive.integral_gain / drive.pwm_frequency) * error[j]
            mean[j] = min(max(asked_j / rail, -1.0), 1.0)
            if abs(asked_j) <= rail or error[j] * asked_j <= 0.0:
                integral[j] += drive.integral_gain / drive.pwm_frequency * error[j]
        return
    if axes == 3:
        error -= error.mean()
    new = integral[:axes] + drive.integral_gain / drive.pwm_frequency * error
    asked = drive.proportional_gain * error + new
    volts = turn.T @ asked
    size = math.sqrt(2.0 / 3.0 * np.sum(volts**2))
    if drive.modulation != SINE:
        volts -= 0.5 * (volts.max() + volts.min())
        size = volts.max() if drive.modulation == HEXAGON else size * math.cos(math.pi / 6.0)
    if size <= rail or np.sum(error * asked) <= 0.0:
        integral[:axes] = new
    mean[:] = volts / max(rail, size)


@cache
def loop() -> Callable[..., None]:
    """Return the compiled loop of the present sources (see `compile`)."""
    return _build(source_hash("ema_sim.simulate"))


def _build(sources: str) -> Callable[..., None]:
    @njit(cache=True, error_model="numpy")
    def run(
        a: Actuator,
        e: Effects,
        state: np.ndarray,
        command: np.ndarray,
        noise: np.ndarray,
        inverter_on: int,
        steps_a_period: int,
        steps_a_sample: int,
        steps_a_carrier: int,
        dt: float,
        out: np.ndarray,
    ) -> None:
        """Fill `out`, shape (n, 11), with means over each sample of `steps_a_sample` steps.

        `command` (rad) and `noise` (rad/s, rad) have a row for each control period of
        `steps_a_period` steps; the inverter drives from step `inverter_on` on.
        """
        _ = sources
        motor, shaft, gear, control = a.motor, a.shaft, a.gear, a.control
        legs, signs, duty, integrals = np.ones(3), np.zeros(3), np.zeros(3), np.zeros(3)
        relays, sensed = a.drive.kind == RELAY, np.zeros(3)
        i, x, k = np.zeros(3), np.zeros(3), np.zeros(3)
        g, r = np.zeros(3), np.zeros(3)
        gain, offset, mean = np.zeros(3), np.zeros(3), np.zeros(N_CHANNELS + 1)
        omega_m, omega_s = state[st.OMEGA_M], state[st.OMEGA_S]
        theta_m, theta_s = state[st.THETA_M], state[st.THETA_S]
        theta_0 = state[st.THETA_0]
        # What no step changes.
        top = ports.flat_top(e, motor)
        varies = ports.inductance_varies(e)
        for j in range(3):
            r[j] = ports.phase_resistance(e, motor, j)
            g[j] = 1.0 / ports.phase_inductance(e, motor, j, 0.0)
            gain[j], offset[j] = sensor_ports.current_gain(e, j), sensor_ports.current_offset(e, j)
        inertia_m, inertia_s = ports.motor_inertia(e, motor), ports.surface_inertia(e, a.surface)
        dynamic_s, static_s = ports.surface_dry_friction(e, a.surface)
        stiffness, backlash = ports.shaft_stiffness(e, shaft), ports.lost_motion(e, shaft)
        delay = sensor_ports.delay_periods(e, a)
        acts = delay + a.acquisition.reference_latency
        asked = np.zeros(len(command))
        integral, noise_w, noise_q = 0.0, 0.0, 0.0
        sag, source_current = e.bus_voltage_sag, 0.0
        source_time = sag.resistance * sag.capacitance
        rail = ports.leg_voltage(e, a.inverter.bus_voltage)

        period, row, left = 0, 0, steps_a_sample
        for n in range(len(out) * steps_a_sample):
            theta_r = theta_m + theta_0
            theta_e = wrap(motor.pole_pairs * theta_r)

            # Position and speed control, once a period; its reference may be late.
            if n == period * steps_a_period:
                p = period
                period += 1
                noise_w, noise_q = noise[p]
                if n >= inverter_on:
                    position = quantise(
                        theta_s + sensor_ports.position_offset(e) + noise_q,
                        sensor_ports.position_step(e, a.converters), a.converters.position_range,
                    )
                    speed = quantise(
                        omega_m * sensor_ports.speed_factor(e, theta_r) + noise_w,
                        sensor_ports.speed_step(e, a.converters), a.converters.speed_range,
                    )
                    omega_ref = clip(
                        control.position_gain * (command[p] - position), control.speed_limit
                    )
                    asked[p], integral = speed_control(
                        omega_ref - speed, integral, control.proportional_gain,
                        control.integral_gain, control.period, a.inverter.current_limit,
                    )
            ago = [math.floor(n / steps_a_period - late + 1e-9) for late in (delay, acts)]
            i_set, i_act = [asked[p] if p >= 0 else 0.0 for p in ago]

            # Commutation; relays or carrier.
            sensor = theta_e + sensor_ports.commutation_angle(e)
            if a.drive.kind == FOC:
                for j in range(3):
                    signs[j] = math.sin(sensor - j * THIRD)
            else:
                signs[0], signs[1], signs[2] = reference_signs(sector_of(sensor))
            for j in range(3):
                sensed[j] = i[j] * gain[j] + offset[j]
                if relays:
                    if sensed[j] >= signs[j] * i_act + a.inverter.hysteresis:
                        legs[j] = -1.0
                    elif sensed[j] <= signs[j] * i_act - a.inverter.hysteresis:
                        legs[j] = 1.0
            if not relays:
                place = n % steps_a_carrier
                if place == 0 and n >= inverter_on:
                    current_control(
                        a.drive, rail, sensor, i_act,
                        signs * i_act, sensed, integrals, duty)
                triangle = abs(2.0 * (place + 0.5) / steps_a_carrier - 1.0)
                for j in range(3):
                    legs[j] = 1.0 if triangle < 0.5 * (1.0 + duty[j]) else -1.0

            # Electrical: L di/dt = v - v_n - R i - k ω, star point floating.
            bus_current = 0.0
            for j in range(3):
                k[j] = ports.back_emf_constant(e, motor, top, j, theta_e, theta_r, i[j])
            if n >= inverter_on:
                bus_current = 0.5 * (legs[0] * i[0] + legs[1] * i[1] + legs[2] * i[2])
                if source_time > 0.0:  # the capacitor gives the rest
                    source_current += dt / source_time * (bus_current - source_current)
                    bus_current = source_current
                rail = ports.leg_voltage(e, a.inverter.bus_voltage)
                rail -= 0.5 * sag.resistance * bus_current
                above, below = 0.0, 0.0
                for j in range(3):
                    v = rail * legs[j] - ports.switch_drop(e, i[j])
                    x[j] = v - r[j] * i[j] - k[j] * omega_m
                    if varies:
                        g[j] = 1.0 / ports.phase_inductance(e, motor, j, i[j])
                    above += x[j] * g[j]
                    below += g[j]
                for j in range(3):
                    i[j] += dt * (x[j] - above / below) * g[j]

            # Mechanical: motor, shaft, surface.
            torque = clip(k[0] * i[0] + k[1] * i[1] + k[2] * i[2], motor.torque_limit)
            torque += ports.added_motor_torque(e, motor, k[0], k[1], k[2], omega_m, theta_r)
            slope = ports.gear_slope(e, gear, theta_r)
            on_shaft = shaft_torque(
                ports.gear_output(e, gear, theta_m, theta_r) - theta_s,
                omega_m * slope - omega_s,
                stiffness, shaft.damping, backlash,
            )
            back_driven = on_shaft * omega_m < 0.0
            loss = gear.efficiency if back_driven else 1.0 / gear.efficiency
            on_motor = on_shaft * slope * loss
            dynamic, static = ports.motor_dry_friction(e, motor, omega_m, on_motor)
            active = torque - on_motor - ports.motor_viscous_friction(e, motor, omega_m)
            before = omega_m
            omega_m += dt * net_torque(omega_m, active, dynamic, static) / inertia_m
            if before * omega_m < 0.0:
                omega_m = 0.0
            active = on_shaft - ports.load_torque(e, theta_s)
            active -= a.surface.viscous_friction * omega_s
            before = omega_s
            omega_s += dt * net_torque(omega_s, active, dynamic_s, static_s) / inertia_s
            if before * omega_s < 0.0:
                omega_s = 0.0
            theta_m += dt * omega_m
            theta_s += dt * omega_s
            if abs(theta_s) > a.surface.end_stop:
                theta_s = math.copysign(a.surface.end_stop, theta_s)
                omega_s = 0.0

            # Acquisition: means over the sample.
            theta_r = theta_m + theta_0
            mean[1] += omega_m * sensor_ports.speed_factor(e, theta_r) + noise_w
            for j in range(3):
                mean[2 + j] += i[j] * gain[j] + offset[j]
                mean[5 + j] += signs[j] * i_set
            mean[8] += motor.pole_pairs * theta_r + sensor_ports.commutation_angle(e)
            mean[9] += theta_s + sensor_ports.position_offset(e) + noise_q
            mean[10] += bus_current
            left -= 1
            if left == 0:
                out[row] = mean / steps_a_sample
                out[row, 0] = (row + 0.5) * steps_a_sample * dt
                mean[:] = 0.0
                row, left = row + 1, steps_a_sample

        state[st.OMEGA_M], state[st.OMEGA_S] = omega_m, omega_s
        state[st.THETA_M], state[st.THETA_S] = theta_m, theta_s
        state[st.I_A], state[st.I_B], state[st.I_C] = i

    return run


def simulate_reference(
    profile: Profile,
    *,
    actuator: Actuator | None = None,
    effects: Effects | None = None,
    seed: int = 0,
    noise: float = 1.0,
    rate: float | None = None,
    start_angle: float | None = None,
    step: float = STEP,
) -> Record:
    """Run one test with the fixed-step loop; arguments, noise and record as `simulate`.

    Parameters
    ----------
    profile, actuator, effects, seed, noise, rate, start_angle : see `simulate.simulate`.
    step : length of a step (s); control period and sample must be multiples of it.

    Raises
    ------
    UsageError
        The step does not divide the control period or the sample.
    SimulationError
        A value is not finite.
    """
    a = actuator if actuator is not None else load_actuator()
    e = effects if effects is not None else Effects()
    steps_a_period = _steps("control period", a.control.period, step)
    rate = a.acquisition.rate if rate is None else rate
    steps_a_sample = _steps("sample", 1.0 / rate, step)
    if start_angle is None:
        start_angle = float(np.random.default_rng([seed, 1]).uniform(
            0.0, 2.0 * math.pi * a.motor.pole_pairs))
    n = round(profile.duration * rate)
    periods = -(-n * steps_a_sample // steps_a_period)
    sensor_noise = SensorNoise(a, seed, noise, rate)
    out = np.zeros((n, N_CHANNELS + 1))
    loop()(
        a, e, st.initial_state(a, profile.start, start_angle),
        profile.command(np.arange(periods) * a.control.period + 1e-9),
        sensor_noise.inside(periods), round(profile.inverter_off / step),
        steps_a_period, steps_a_sample, _carrier(a, step), step, out,
    )
    if not np.isfinite(out).all():
        raise SimulationError(
            "fixed-step simulation: values are not finite: the parameters are outside what "
            f"the model holds for, or the step of {step:g} s is too long"
        )
    block = max(1, math.ceil(AUXILIARY_PERIOD * rate))
    ends = np.append(np.arange(block, n, block), n)
    times = out[ends - 1, 0]
    current = np.array([c.mean() for c in np.split(out[:, BUS_CURRENT], ends[:-1])])
    open_circuit = 2.0 * a.inverter.bus_voltage * (1.0 + e.bus_voltage_change.change)
    voltage = open_circuit - e.bus_voltage_sag.resistance * current
    temperature = np.full(len(ends), e.winding_temperature.temperature)
    return Record(
        samples=convert(
            effective_converters(a.converters, e), a.acquisition,
            out[:, :N_CHANNELS].copy(), sensor_noise.currents(n),
        ),
        profile=profile,
        provenance=Provenance(serial_number="SIM-REFERENCE", software_version=VERSION),
        dc_bus=np.column_stack([times, voltage, current]),
        winding_temperature=np.column_stack([times, temperature]),
    )


def _carrier(a: Actuator, step: float) -> int:
    """Return how many steps make a period of the carrier, 1 if there is none."""
    return 1 if a.drive.kind == RELAY else _steps("carrier", 1.0 / a.drive.pwm_frequency, step)


def _steps(what: str, length: float, step: float) -> int:
    """Return how many steps make `length` (s)."""
    if not 0.0 < step <= length:
        raise UsageError(f"step {step:g} s: must be above 0 and at most the {what}, {length:g} s")
    count = round(length / step)
    if abs(count * step - length) > 1e-6 * length:
        raise UsageError(
            f"step {step:g} s does not divide the {what} of {length:g} s: choose one that does"
        )
    return count
