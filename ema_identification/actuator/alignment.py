"""Align: what a record measures of its own conditions, so that the simulator can start alike."""

from __future__ import annotations

import numpy as np

from ema_identification.actuator.lines import TURN
from ema_identification.actuator.signals import OFF_GUARD
from ema_identification.actuator.spread import REFERENCE_TEMPERATURE, Conditions
from ema_record.channels import PHASE_CURRENTS
from ema_record.record import Record
from ema_sim.actuator import Model

NOISE_RANGE = (0.1, 20.0)
"""Factors on the sensor noise that are believed."""


def align(record: Record, model: Model) -> Conditions:
    """Return the conditions of a test, read off its record."""
    measured = set()
    temperature = REFERENCE_TEMPERATURE
    if len(record.winding_temperature):
        temperature = float(np.mean(record.winding_temperature[:, 1]))
        measured.add("temperature")
    bus = 0.0
    if len(record.dc_bus):
        bus = _open_circuit(record) / (2.0 * model.actuator.inverter.bus_voltage) - 1.0
        measured.add("bus")
    off = record.time < record.profile.inverter_off - OFF_GUARD
    still = off if off.any() else np.arange(len(record)) < 20
    turned = np.exp(1j * record.channel("rotor_angle")[still]).mean()
    return Conditions(
        temperature=temperature, bus=bus, noise=_noise(record, model, off),
        start_angle=float(np.angle(turned)) % TURN, measured=frozenset(measured),
    )


def _open_circuit(record: Record) -> float:
    """Return the voltage between the rails at no current (V)."""
    voltage, current = record.dc_bus[:, 1], record.dc_bus[:, 2]
    if len(voltage) < 3 or float(np.ptp(current)) < 0.5:
        return float(voltage.mean())
    slope, level = np.polyfit(current, voltage, 1)
    return float(level) if abs(slope) < 2.0 else float(voltage.mean())


def _noise(record: Record, model: Model, off: np.ndarray) -> float:
    """Return the factor on the noise, from the currents while the inverter is off."""
    nominal = model.actuator.noise.current * np.sqrt(record.rate / 20_000.0)
    if off.sum() < 40 or nominal <= 0.0:
        return 1.0
    spread = float(np.sqrt(record.samples[off, PHASE_CURRENTS].var(axis=0, ddof=1).mean()))
    return float(np.clip(spread / nominal, *NOISE_RANGE))
