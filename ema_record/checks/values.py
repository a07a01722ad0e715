"""Rules on the values of each channel by itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ema_record.actuator import Actuator
from ema_record.channels import (
    CHANNELS,
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    TIME,
)
from ema_record.checks.facts import SETTLED, BagFacts, Hit, Rule
from ema_record.wire.topics import DC_BUS, WINDING_TEMPERATURE

STUCK_TIME = 0.02
"""Run of one value of a noisy channel that no noise gives (s)."""
TURNED = 4.0
"""Electrical angle beyond which no commutation interval goes (rad)."""
LOST_MOTION = 0.055
"""Motor travel, at the surface, that no worn transmission swallows (rad)."""
STANDING = 0.05
"""Angle within which the motor stands (rad)."""
CLIPPED = 20
"""Samples on end at the extreme value of a noisy channel."""
BUS_VOLTAGE = (0.05, 5.0)
"""Share of the nominal voltage between the rails that no sag and no charge gives."""
REFERENCE = 5.0
"""Times the current limit that no reference goes to."""
WINDING = (-60.0, 230.0)
"""Temperature that a winding survives (degC)."""
_NOISY = (MOTOR_SPEED, *range(PHASE_CURRENTS.start, PHASE_CURRENTS.stop))


def not_finite(facts: BagFacts) -> Iterator[Hit]:
    """Find values that are no numbers."""
    for block in facts.blocks:
        bad = ~np.isfinite(block.samples)
        if bad.any():
            row, column = np.argwhere(bad)[0]
            yield Hit(
                f"{CHANNELS[column].name} is {block.samples[row, column]}",
                float(np.nan_to_num(block.samples[row, TIME])), float(bad.sum()), "values",
                CHANNELS[column].name,
            )


def _runs(column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return first and past-the-end index of each run of one value."""
    edges = np.flatnonzero(np.diff(column)) + 1
    return np.concatenate([[0], edges]), np.concatenate([edges, [len(column)]])


def stuck(facts: BagFacts) -> Iterator[Hit]:
    """Find channels that keep one value while they ought to change."""
    s = facts.samples
    if len(s) < 100:
        return
    pole_pairs = facts.actuator.motor.pole_pairs
    motor = np.cumsum(np.abs(s[:, MOTOR_SPEED])) * facts.interval * pole_pairs
    angle = np.mod(np.diff(s[:, ROTOR_ANGLE]) + np.pi, 2.0 * np.pi) - np.pi
    by_angle = np.concatenate([[0.0], np.cumsum(np.abs(angle))])
    lost_motion = LOST_MOTION * facts.actuator.gear.ratio * pole_pairs
    off = facts.profile.inverter_off + SETTLED if facts.profile else 0.0
    live = min(int(np.searchsorted(s[:, TIME], off)), len(s) // 2)
    for column in range(1, s.shape[1]):
        begin, end = _runs(s[:, column])
        last = end - 1
        if column in _NOISY:
            # A noisy channel keeps its value as seldom as it does elsewhere in the record.
            begin = np.maximum(begin, live)
            k = int(np.argmax(end - begin))
            rest = len(s) - (end[k] - begin[k])
            still = 1.0 - (len(begin) - 1) / max(rest, 1)
            long = (end[k] - begin[k]) * facts.interval > STUCK_TIME
            turned = by_angle[last[k]] - by_angle[begin[k]]
            speed = s[begin[k], MOTOR_SPEED] if column == MOTOR_SPEED else 0.0
            lasted = (end[k] - begin[k]) * facts.interval
            missed = turned - abs(speed) * pole_pairs * lasted
            if column == MOTOR_SPEED and abs(speed) < 1.0 and turned < STANDING:
                continue
            hit = long and (still < 0.9 or abs(missed) > TURNED)
        else:
            moved = by_angle if column != ROTOR_ANGLE else motor
            k = int(np.argmax(moved[last] - moved[begin]))
            travel = moved[last[k]] - moved[begin[k]]
            bound = lost_motion if column == SURFACE_POSITION else TURNED
            hit = travel > bound
        if hit:
            yield Hit(
                f"{CHANNELS[column].name} stays at {s[begin[k], column]:.6g} "
                f"{CHANNELS[column].unit} for {1e3 * (end[k] - begin[k]) * facts.interval:.1f} ms",
                float(s[begin[k], TIME]), float((end[k] - begin[k]) * facts.interval), "s",
                CHANNELS[column].name,
            )


def saturated(facts: BagFacts) -> Iterator[Hit]:
    """Find transducers at the end of their range: the same extreme value, often on end."""
    s = facts.samples
    for column in (*_NOISY, SURFACE_POSITION):
        if len(s) < 100:
            return
        values = s[:, column]
        begin, end = _runs(values)
        for extreme in (float(values.max()), float(values.min())):
            runs = (end - begin)[values[begin] == extreme]
            at = begin[values[begin] == extreme]
            total = int(runs.sum())
            longest = int(runs.max())
            if column == SURFACE_POSITION:
                k = int(np.argmax(runs))
                turned = np.abs(s[at[k]:at[k] + longest, MOTOR_SPEED]).sum() * facts.interval
                clipped = turned / facts.actuator.gear.ratio > LOST_MOTION
            else:
                clipped = longest >= CLIPPED and total < 0.97 * len(s)
            if clipped:
                yield Hit(
                    f"{CHANNELS[column].name} is cut off at {extreme:.6g} {CHANNELS[column].unit}",
                    float(s[at[0], TIME]), total * facts.interval, "s", CHANNELS[column].name,
                )


def spike_bounds(actuator: Actuator) -> dict[int, float]:
    """Return the distance from both neighbours that nothing gives in one interval, by column."""
    converters = actuator.converters
    current = 15.0 / 64.0 * converters.current_range
    return {
        MOTOR_SPEED: 0.02 * converters.speed_range,
        **dict.fromkeys(range(PHASE_CURRENTS.start, PHASE_CURRENTS.stop), current),
        SURFACE_POSITION: 1.5e-3 * converters.position_range,
    }


def spikes(facts: BagFacts) -> Iterator[Hit]:
    """Find single samples far from both neighbours."""
    s = facts.samples
    if len(s) < 3:
        return
    for column, bound in spike_bounds(facts.actuator).items():
        step = np.diff(s[:, column])
        single = (np.sign(step[:-1]) == -np.sign(step[1:])) & (
            np.minimum(np.abs(step[:-1]), np.abs(step[1:])) > bound
        ) & (np.abs(step[:-1] + step[1:]) < 0.5 * np.abs(step[:-1]))
        if single.any():
            row = int(np.argmax(single)) + 1
            yield Hit(
                f"{int(single.sum())} single values of {CHANNELS[column].name} far from their "
                "neighbours", float(s[row, TIME]), float(abs(step[row - 1])),
                CHANNELS[column].unit, CHANNELS[column].name,
            )


def slow_units(facts: BagFacts) -> Iterator[Hit]:
    """Find bus voltages and temperatures that are in another unit."""
    if len(facts.bus_voltage):
        voltage = float(np.median(facts.bus_voltage))
        nominal = 2.0 * facts.actuator.inverter.bus_voltage
        if not BUS_VOLTAGE[0] <= voltage / nominal <= BUS_VOLTAGE[1]:
            yield Hit(f"bus voltage {voltage:g} V: is it in mV or kV?", None, voltage, "V", DC_BUS)
    if len(facts.winding_temperature):
        celsius = float(np.median(facts.winding_temperature))
        if not WINDING[0] <= celsius <= WINDING[1]:
            yield Hit(f"winding at {celsius:g} degC: is it in K?", None, celsius, "degC",
                      WINDING_TEMPERATURE)


def references_beyond(facts: BagFacts) -> Iterator[Hit]:
    """Find reference currents that no current limit allows."""
    s = facts.samples
    peak = float(np.abs(s[:, REFERENCE_CURRENTS]).max()) if len(s) else 0.0
    if peak > REFERENCE * facts.actuator.inverter.current_limit:
        yield Hit(f"reference currents up to {peak:g} A: are they in mA?", None, peak, "A",
                  "reference_current")


_WIRING = "check the transducer, its plug and its wires, then record the test again"
_SCALE = "set the unit of the acquisition to that of the channel list"
RULES = (
    Rule(name="not_finite", find=not_finite, remedy=_WIRING),
    Rule(name="stuck_channel", find=stuck, remedy=_WIRING),
    Rule(name="saturation", find=saturated,
         remedy="choose a larger range of the converter and record the test again"),
    Rule(name="spike", find=spikes, remedy=_WIRING),
    Rule(name="wrong_unit", find=slow_units, remedy=_SCALE),
    Rule(name="wrong_unit", find=references_beyond, remedy=_SCALE),
)
