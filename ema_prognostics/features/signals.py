"""What the features are computed from: corrected signals of a whole record.

Offset and gain errors of the current sensors are read off the record itself. Offsets: the
inverter is off at the beginning of a test, the currents are zero. Gains: the true currents of a
star sum to zero, so the readings do not vary along one direction, which is the smallest
eigenvector of ⟨i iᵀ⟩; white noise, equal in the phases, does not turn it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ema_record.actuator import Actuator, Motor, load_actuator
from ema_record.channels import (
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    measured,
    median,
)
from ema_record.errors import IncompleteRecordError
from ema_record.record import Record
from ema_sim.machine import MAGNET, REFERENCE, THIRD, unit_back_emf
from ema_sim.rebuild import completed, present

MIN_SAMPLES = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class CurrentSensors:
    """Errors of the three current sensors.

    Attributes
    ----------
    offset : ndarray, shape (3,) (A), zero where the record has no interval without current.
    gain : ndarray, shape (3,), relative to their mean.
    """

    offset: np.ndarray
    gain: np.ndarray

    def correct(self, currents: np.ndarray) -> np.ndarray:
        """Return readings, shape (n, 3) (A), without the errors."""
        return (currents - self.offset) / self.gain


def current_sensors(record: Record, *, two: bool = False) -> CurrentSensors:
    """Return the errors of the current sensors in a record; `two`: the third is no measurement."""
    currents = record.samples[:, PHASE_CURRENTS]
    rest = currents[record.at_rest]
    offset = rest.mean(axis=0) if len(rest) >= MIN_SAMPLES else np.zeros(3)
    gain = np.ones(3)
    if not two:
        on = currents[record.at_rest.stop:].T - offset[:, None]
        _, vectors = np.linalg.eigh(on @ on.T)
        normal = np.abs(vectors[:, 0])
        if normal.min() >= 0.2:  # else a phase carries no current: no gain can be told
            gain = 1.0 / normal
    return CurrentSensors(offset=offset, gain=gain / gain.mean())


MAX_SAMPLES = 4_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Signals:
    """Signals of a record, corrected with what the record itself tells.

    Attributes
    ----------
    record : with all channels, those that were not recorded rebuilt.
    actuator : the kit's, as the diagnosis knows it.
    has_references, has_position : whether these were recorded.
    rate : samples a second.
    time, speed, position : ndarray, shape (n,). s; rad/s, of the motor; rad, of the surface.
    theta : ndarray, shape (n,). Electrical angle of the rotor, unwrapped (rad): what commutation,
        back-EMF and the lines refer to.
    currents : ndarray, shape (n, 3). Phase currents without sensor offset and gain (A).
    torque_current : ndarray, shape (n,). q = Σ k_k(θ) i_k / 2k (A).
    sensors : errors of the current sensors.
    torque_constant : 2k at the measured winding temperature (N m/A).
    temperature : of the winding (degC), 20 where not measured.
    bus_voltage : between the rails (V), nominal where not measured.
    """

    record: Record
    actuator: Actuator
    has_references: bool
    has_position: bool
    rate: float
    time: np.ndarray
    speed: np.ndarray
    theta: np.ndarray
    position: np.ndarray
    currents: np.ndarray
    torque_current: np.ndarray
    sensors: CurrentSensors
    torque_constant: float
    temperature: float
    bus_voltage: float

    @property
    def motor_angle(self) -> np.ndarray:
        """Mechanical angle of the motor, unwrapped, shape (n,) (rad): `theta` / pole pairs."""
        return self.theta / self.actuator.motor.pole_pairs

    def torque(self, part: slice) -> np.ndarray:
        """Return the torque of some samples, within what the motor can, shape (m,) (N m)."""
        limit = self.actuator.motor.torque_limit
        return np.clip(self.torque_constant * self.torque_current[part], -limit, limit)

    def between(self, begin: float, end: float) -> slice:
        """Return the samples between two times after the first command (s)."""
        t0 = self.record.profile.command_time
        first, last = np.searchsorted(self.time, (t0 + begin, t0 + end))
        if last - first < 20:
            raise IncompleteRecordError(
                f"{last - first} samples between {t0 + begin:.3f} and {t0 + end:.3f} s, at "
                "least 20: repeat the test"
            )
        return slice(int(first), int(last))


def phase_shares(theta: np.ndarray, currents: np.ndarray, motor: Motor) -> np.ndarray:
    """Return what each phase gives of the torque current, shape (n, 3) (A)."""
    return np.column_stack([
        0.5 * unit_back_emf(theta - k * THIRD, motor) * currents[:, k] for k in range(3)])


def prepare(record: Record, actuator: Actuator | None = None) -> Signals:
    """Return the corrected signals of `record`; `actuator` is the nominal model."""
    if len(record) > MAX_SAMPLES:
        raise IncompleteRecordError(f"{len(record)} samples, at most {MAX_SAMPLES}")
    nominal = actuator if actuator is not None else load_actuator()
    there = present(record)
    # One channel after the other: a column of a table is read at a third of the cost.
    samples = np.asfortranarray(completed(record, nominal))
    record = replace(record, samples=samples)
    sensors = current_sensors(record, two=not there[PHASE_CURRENTS].all())
    currents = sensors.correct(samples[:, PHASE_CURRENTS])
    theta = np.unwrap(samples[:, ROTOR_ANGLE])
    warm, rails = (measured(x[:, 1]) for x in (record.winding_temperature, record.dc_bus))
    temperature = float(median(warm)) if len(warm) else REFERENCE
    bus = float(median(rails)) if len(rails) else 2.0 * nominal.inverter.bus_voltage
    factor = 1.0 + MAGNET * (temperature - REFERENCE)
    return Signals(
        record=record, actuator=nominal, has_references=bool(there[REFERENCE_CURRENTS].all()),
        has_position=bool(there[SURFACE_POSITION]), rate=record.rate, time=samples[:, 0],
        speed=samples[:, MOTOR_SPEED], theta=theta, position=samples[:, SURFACE_POSITION],
        currents=currents,
        torque_current=phase_shares(theta, currents, nominal.motor).sum(axis=1), sensors=sensors,
        torque_constant=2.0 * nominal.motor.back_emf_constant * factor,
        temperature=temperature, bus_voltage=bus,
    )
