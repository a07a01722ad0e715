"""Stiffness that the motor meets when it starts: that of the shaft, or none in a gap.

While the motor starts, its kinetic energy less the work of its torque is the work of friction
and shaft, E(θ) = ½ J ω² − ∫ T dθ, so −E'' is the stiffness behind the motor: shaft stiffness /
ratio² in contact, zero inside the lost motion.
"""

from __future__ import annotations

import numpy as np

from ema_prognostics.current_sensors import CurrentSensors
from ema_prognostics.torque_lines import Plant, torque_current
from ema_record.channels import MOTOR_SPEED, PHASE_CURRENTS, ROTOR_ANGLE
from ema_record.record import Record

PARTS = ((0.0, 0.25), (0.25, 0.5))
"""Travel of the motor over which the stiffness is fitted (rad)."""
LENGTH = 0.012
"""The travel is over by then, after the command (s)."""
MIN_SAMPLES = 5


def start_stiffness(record: Record, sensors: CurrentSensors, plant: Plant) -> np.ndarray:
    """Return the stiffness in each of `PARTS`, relative to the nominal shaft, shape (2,).

    Zero where the record holds too few samples of the travel.
    """
    begin = record.profile.command_time
    first, last = np.searchsorted(record.time, (begin - 1e-3, begin + LENGTH))
    samples = record.samples[first:last]
    theta = np.unwrap(samples[:, ROTOR_ANGLE])
    q = torque_current(theta, sensors.correct(samples[:, PHASE_CURRENTS]), plant.flat_top)
    torque = np.clip(2.0 * plant.back_emf_constant * q, -plant.torque_limit, plant.torque_limit)
    step = np.diff(theta)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (torque[1:] + torque[:-1]) * step)])
    energy = 0.5 * plant.motor_inertia * samples[:, MOTOR_SPEED] ** 2 - work
    travel = np.abs(theta - theta[0])
    nominal = plant.shaft_stiffness / plant.gear_ratio**2
    found = np.zeros(len(PARTS))
    for index, (low, high) in enumerate(PARTS):
        inside = (travel > low) & (travel <= high) & (travel > 2e-3)
        if np.count_nonzero(inside) >= MIN_SAMPLES:
            u = (travel[inside] - 0.5 * (low + high)) / (high - low)
            found[index] = -2.0 * np.polyfit(u, energy[inside], 2)[0] / (high - low) ** 2
    return found / nominal
