"""Features of the sensors and the supply, of a record as a whole."""

from __future__ import annotations

import numpy as np

from ema_identification.actuator.signals import Signals
from ema_record.record import Record
from ema_sim.parameters import Actuator

CONSISTENCY = {
    "offset_a": ("phase current a", "test phase"),
    "offset_b": ("phase current b", "test phase"),
    "offset_c": ("phase current c", "test phase"),
    "gain_ab": ("sum of the phase currents", "load"),
    "gain_ac": ("sum of the phase currents", "load"),
    "position_step": ("surface position", "test phase"),
    "speed_step": ("motor speed", "test phase"),
    "position_at_start": ("surface position", "test phase"),
    "bus_slope": ("bus voltage", "load"),
    "slip": ("measured speed minus speed of the rotor angle", "speed"),
}
"""Signal and abscissa of each feature of the record as a whole."""
LEAST_STEP = 0.25
"""Least step of a converter that is told from a finer one, relative to nominal."""


def converter_step(values: np.ndarray) -> float:
    """Return the step of the converter that gave `values`: their smallest difference."""
    steps = np.abs(np.diff(values))
    steps = steps[steps > 1e-12]
    return float(steps.min()) if len(steps) else 0.0


def _bus_slope(record: Record) -> float:
    """Return by how much the bus falls a bus current (V/A); 0 if the record does not tell."""
    if len(record.dc_bus) < 3:
        return 0.0
    voltage, current = record.dc_bus[:, 1], record.dc_bus[:, 2]
    centred = current - current.mean()
    power = float(centred @ centred)
    return float(-(centred @ voltage) / power) if power > 1e-6 else 0.0


def _log_step(found: float, nominal: float) -> float:
    return float(np.log2(max(found / nominal, LEAST_STEP)))


def consistency(record: Record, signals: Signals, actuator: Actuator) -> dict[str, float]:
    """Return the features of `CONSISTENCY`."""
    c = actuator.converters
    off = record.time < record.profile.inverter_off
    start = signals.position[off].mean() if off.any() else signals.position[0]
    travel = signals.theta[-1] - signals.theta[0]
    middle = 0.5 * (signals.speed[1:] + signals.speed[:-1])
    read = float(middle @ np.diff(signals.time))
    length = float(np.abs(np.diff(signals.theta)).sum()) + 1.0
    return {
        "offset_a": float(signals.offset[0]), "offset_b": float(signals.offset[1]),
        "offset_c": float(signals.offset[2]),
        "gain_ab": float(signals.gain[0] - signals.gain[1]),
        "gain_ac": float(signals.gain[0] - signals.gain[2]),
        "position_step": _log_step(converter_step(signals.position),
                                   c.position_range / 2.0**c.position_bits),
        "speed_step": _log_step(converter_step(signals.speed),
                                c.speed_range / 2.0**c.speed_bits),
        "position_at_start": 1e3 * (float(start) - record.profile.start),
        "bus_slope": _bus_slope(record),
        "slip": 1e3 * (read * signals.pole_pairs - travel) / length,
    }
