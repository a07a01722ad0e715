"""Records of the second simulator: sensor noise, converters, the slow channels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from benchmarks.any_actuator.described import Damage, Own, Surroundings
from benchmarks.any_actuator.physics import run
from ema_record.actuator import NOISE_RATE, Actuator
from ema_record.channels import (
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
)
from ema_record.profile import Profile
from ema_record.record import Provenance, Record

SLOW = 0.1
"""Interval of bus and temperature readings (s)."""


class BenchTest(NamedTuple):
    """One test of one unit."""

    actuator: Actuator
    """Of the unit."""
    own: Own
    surroundings: Surroundings
    damage: Damage
    seed: int
    unit: str


def _convert(x: np.ndarray, span: float, bits: int, low: float) -> np.ndarray:
    """Return readings of a converter of `span` that begins at `low`."""
    bit = span / 2.0**bits
    return np.asarray(bit * np.clip(np.rint(x / bit), np.ceil(low / bit),
                                    np.floor((low + span) / bit)))


def record_of(test: BenchTest, profile: Profile) -> Record:
    """Simulate a test and return its record; channels that are not recorded are NaN."""
    a, s = test.actuator, test.surroundings
    samples, bus, _ = run(a, profile, test.own, s, test.damage, seed=test.seed)
    rng = np.random.default_rng([test.seed, 1])
    sigma = s.noise[2] * a.noise.current * np.sqrt(a.acquisition.rate / NOISE_RATE)
    samples[:, PHASE_CURRENTS] += sigma * rng.standard_normal((len(samples), 3))
    if a.acquisition.converters:
        c = a.converters
        for channel, span, bits in (
                (MOTOR_SPEED, c.speed_range, c.speed_bits),
                (PHASE_CURRENTS, c.current_range, c.current_bits),
                (REFERENCE_CURRENTS, c.current_range, c.current_bits),
                (SURFACE_POSITION, c.position_range, c.position_bits)):
            samples[:, channel] = _convert(samples[:, channel], span, bits, -0.5 * span)
        samples[:, ROTOR_ANGLE] = _convert(samples[:, ROTOR_ANGLE], c.angle_range, c.angle_bits,
                                           0.0)
    q = a.acquisition
    for there, channel in ((q.phase_current_c, PHASE_CURRENTS.stop - 1),
                           (q.reference_currents, REFERENCE_CURRENTS),
                           (q.rotor_angle, ROTOR_ANGLE), (q.surface_position, SURFACE_POSITION)):
        if not there:
            samples[:, channel] = np.nan
    rail = 2.0 * a.inverter.bus_voltage * (1.0 + s.bus)
    slow = slow_means(samples[:, 0], bus, a.acquisition.rate)
    return Record(
        samples=samples, profile=profile, provenance=Provenance(
            serial_number=test.unit, software_version="second simulator",
            start_time=1_790_000_000_000_000_000 + 10**10 * (test.seed % 10**6)),
        dc_bus=np.column_stack([slow[:, 0], rail - test.damage.sag * slow[:, 1], slow[:, 1]]),
        winding_temperature=np.column_stack([slow[:, 0], np.full(len(slow), s.temperature)]),
    )


def slow_means(time: np.ndarray, values: np.ndarray, rate: float) -> np.ndarray:
    """Return the ends and the means of intervals of `SLOW`, shape (m, 2)."""
    n = max(1, round(SLOW * rate))
    edges = np.arange(0, len(values), n)
    counts = np.diff(np.append(edges, len(values)))
    return np.column_stack([time[edges + counts - 1], np.add.reduceat(values, edges) / counts])
