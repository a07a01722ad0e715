"""Rules on the values of each channel by itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ema_record.channels import (
    ALL,
    CHANNELS,
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    TIME,
    measured,
    median,
)
from ema_record.checks.facts import LONGEST, SET_UNIT, SETTLED, BagFacts, Hit, Rule
from ema_record.wire.topics import DC_BUS, WINDING_TEMPERATURE

STUCK_TIME, FAR = 0.02, 4
"""Run of one value of a noisy channel that no noise gives (s); or, of the longest other one."""
TURNED = 4.0
"""Electrical angle beyond which no commutation interval goes (rad)."""
LOST_MOTION = 0.0917
"""Motor travel, at the surface, that no worn transmission swallows (of the way to the stop)."""
STANDING = (1.3e-3, 0.05)
"""A motor that stands: reads so little (of its highest speed), turns so little (rad)."""
RESTLESS = 0.5
"""Share of repeated samples below which a channel changes all the time."""
LIVELY = 0.2
"""The same of a channel that is cut off where it does not change."""
ENOUGH = 100
"""Samples from which such a share is known."""
CLIPPED = 20
"""Samples on end at the extreme value of a noisy channel."""
SPIKE = (0.6818, 0.0506, 0.005)
"""Distance from both neighbours that nothing gives in one interval: of a current (of the limit),
of the speed (of the highest), of the position (of the way to the end stop)."""
STEPS = 6.0
"""The same, at least, in steps of the converter."""
BUS_VOLTAGE = (0.05, 5.0)
"""Share of the nominal voltage between the rails that no sag and no charge gives."""
REFERENCE = 5.0
"""Times the current limit that no reference goes to."""
WINDING = (-60.0, 230.0)
"""Temperature that a winding survives (degC)."""
_NOISY = (MOTOR_SPEED, *range(PHASE_CURRENTS.start, PHASE_CURRENTS.stop))


def not_finite(facts: BagFacts) -> Iterator[Hit]:
    """Find values that are no numbers; a channel that was not recorded has none."""
    absent = [c for c in ALL if not facts.has(c)]
    for block in facts.blocks:
        bad = ~np.isfinite(block.samples)
        bad[:, absent] = False
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


def _path(motion: np.ndarray) -> np.ndarray:
    """Return the length of a path, shape (n,), from its n - 1 steps."""
    return np.concatenate([[0.0], np.cumsum(np.abs(motion))])


class _Course:
    """How far the motor has turned by each sample, in electrical rad, as the channels tell it."""

    def __init__(self, facts: BagFacts) -> None:
        s, pole_pairs = facts.samples, facts.actuator.motor.pole_pairs
        self.speed = self.angle = self.position = None
        if not facts.too_fast:
            self.speed = np.cumsum(np.abs(s[:, MOTOR_SPEED])) * facts.interval * pole_pairs
        if facts.has(ROTOR_ANGLE):
            unit = np.pi / 180.0 if facts.angle_in_degrees else 1.0
            step = np.mod(unit * np.diff(s[:, ROTOR_ANGLE]) + np.pi, 2.0 * np.pi) - np.pi
            self.angle = _path(step)
        elif facts.has(SURFACE_POSITION):
            # Means over windows: the path of a noisy position is longer than that of the motor.
            n = max(1, min(facts.window, len(s)) // 4)
            slow = np.convolve(s[:, SURFACE_POSITION], np.full(n, 1.0 / n), mode="same")
            slow[:n], slow[-n:] = slow[n], slow[-n - 1]
            self.position = _path(np.diff(slow)) * facts.actuator.gear.ratio * pole_pairs

    def without(self, column: int) -> np.ndarray | None:
        """Return the path as a channel other than `column` tells it, None: there is none."""
        if column == MOTOR_SPEED:
            return self.position if self.angle is None else self.angle
        return self.speed if column == ROTOR_ANGLE or self.angle is None else self.angle


def stuck(facts: BagFacts) -> Iterator[Hit]:
    """Find channels that keep one value while they ought to change."""
    s = facts.samples
    if len(s) < ENOUGH:
        return
    course = _Course(facts)
    off = facts.profile.inverter_off + SETTLED if facts.profile else 0.0
    live = min(int(np.searchsorted(s[:, TIME], off)), len(s) // 2)
    for column in facts.columns[1:]:
        moved = course.without(column)
        if moved is None:
            if column not in _NOISY:
                continue
            moved = np.zeros(len(s))
        begin, end = _runs(s[:, column])
        if column in _NOISY:
            begin = np.maximum(begin, live)
            *_, other, longest = np.sort(np.append(end - begin, 1))
            k = int(np.argmax(end - begin))
            hit = longest > max(LONGEST, FAR * other) or longest * facts.interval > STUCK_TIME
            hit = hit and _stopped(facts, column, begin[k], end[k], moved)
        else:
            k = int(np.argmax(moved[end - 1] - moved[begin]))
            travel = moved[end[k] - 1] - moved[begin[k]]
            pole_pairs, way = facts.actuator.motor.pole_pairs, facts.actuator.surface.end_stop
            lost = LOST_MOTION * way * facts.actuator.gear.ratio * pole_pairs
            hit = travel > (lost if column == SURFACE_POSITION else TURNED)
        if hit:
            yield Hit(
                f"{CHANNELS[column].name} stays at {s[begin[k], column]:.6g} "
                f"{CHANNELS[column].unit} for {1e3 * (end[k] - begin[k]) * facts.interval:.1f} ms",
                float(s[begin[k], TIME]), float((end[k] - begin[k]) * facts.interval), "s",
                CHANNELS[column].name,
            )


def _stopped(facts: BagFacts, column: int, begin: int, end: int, moved: np.ndarray) -> bool:
    """Return whether a noisy channel that keeps its value from `begin` to `end` is stuck.

    The motor turned meanwhile by more than the channel allows; or, where it stood or moved
    alike, the channel changes all the time: one without noise never does.
    """
    s = facts.samples
    pole_pairs, highest = facts.actuator.motor.pole_pairs, facts.actuator.control.speed_limit
    turned = moved[end - 1] - moved[begin]
    reading = abs(s[begin, MOTOR_SPEED]) if column == MOTOR_SPEED else 0.0
    missed = turned - reading * pole_pairs * (end - begin) * facts.interval
    if abs(missed) > TURNED and moved.any():
        return True
    if column == MOTOR_SPEED and reading < STANDING[0] * highest and turned < STANDING[1]:
        return False
    stands = turned < STANDING[1] * pole_pairs
    rate = np.gradient(moved) / facts.interval if len(moved) > 1 else moved
    alike = (np.abs(rate) < facts.standing * pole_pairs) == stands
    alike[begin:end] = False
    same = np.concatenate([[False], np.diff(s[:, column]) == 0.0])
    return int(alike.sum()) >= ENOUGH and float(same[alike].mean()) < RESTLESS


def saturated(facts: BagFacts) -> Iterator[Hit]:
    """Find transducers at the end of their range: the same extreme value, often on end.

    Elsewhere such a channel changes from sample to sample; one that is quiet does not.
    """
    s = facts.samples
    for column in (*_NOISY, SURFACE_POSITION):
        if len(s) < ENOUGH or not facts.has(column):
            continue
        values = s[:, column]
        begin, end = _runs(values)
        extremes = float(values.max()), float(values.min())
        held = np.isin(values[begin], extremes)
        rest = len(s) - int((end - begin)[held].sum())
        still = (rest - int((~held).sum())) / max(rest, 1)  # beside both ends of its range
        for extreme in extremes:
            runs = (end - begin)[values[begin] == extreme]
            at = begin[values[begin] == extreme]
            total = int(runs.sum())
            longest = int(runs.max())
            if column == SURFACE_POSITION:
                k = int(np.argmax(runs))
                turned = np.abs(s[at[k]:at[k] + longest, MOTOR_SPEED]).sum() * facts.interval
                lost = LOST_MOTION * facts.actuator.surface.end_stop
                clipped = turned / facts.actuator.gear.ratio > lost
            else:
                if column == MOTOR_SPEED and (
                    abs(extreme) < STANDING[0] * facts.actuator.control.speed_limit
                ):
                    continue  # it stands
                clipped = longest >= CLIPPED and rest >= ENOUGH and still < LIVELY
            if clipped:
                yield Hit(
                    f"{CHANNELS[column].name} is cut off at {extreme:.6g} {CHANNELS[column].unit}",
                    float(s[at[0], TIME]), total * facts.interval, "s", CHANNELS[column].name,
                )


def spike_bounds(facts: BagFacts) -> dict[int, float]:
    """Return the distance from both neighbours that nothing gives in one interval, by column."""
    a, c = facts.actuator, facts.actuator.converters
    current = max(SPIKE[0] * a.inverter.current_limit,
                  STEPS * c.current_range / 2**c.current_bits)
    return {
        MOTOR_SPEED: max(SPIKE[1] * a.control.speed_limit, facts.acceleration * facts.interval,
                         STEPS * c.speed_range / 2**c.speed_bits),
        **dict.fromkeys(facts.currents, current),
        SURFACE_POSITION: max(SPIKE[2] * a.surface.end_stop,
                              STEPS * c.position_range / 2**c.position_bits),
    }


def spikes(facts: BagFacts) -> Iterator[Hit]:
    """Find single samples far from both neighbours."""
    s = facts.samples
    if len(s) < 3:
        return
    for column, bound in spike_bounds(facts).items():
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
    if len(readings := measured(facts.bus_voltage)):
        voltage = float(median(readings))
        nominal = 2.0 * facts.actuator.inverter.bus_voltage
        if not BUS_VOLTAGE[0] <= voltage / nominal <= BUS_VOLTAGE[1]:
            yield Hit(f"bus voltage {voltage:g} V: is it in mV or kV?", None, voltage, "V", DC_BUS)
    if len(readings := measured(facts.winding_temperature)):
        celsius = float(median(readings))
        if not WINDING[0] <= celsius <= WINDING[1]:
            yield Hit(f"winding at {celsius:g} degC: is it in K?", None, celsius, "degC",
                      WINDING_TEMPERATURE)


def references_beyond(facts: BagFacts) -> Iterator[Hit]:
    """Find reference currents that no current limit allows."""
    s = facts.samples
    if not (len(s) and facts.has_references):
        return
    peak = float(np.abs(s[:, REFERENCE_CURRENTS]).max())
    if peak > REFERENCE * facts.actuator.inverter.current_limit:
        yield Hit(f"reference currents up to {peak:g} A: are they in mA?", None, peak, "A",
                  "reference_current")


_WIRING = "check the transducer, its plug and its wires, then record the test again"
RULES = (
    Rule(name="not_finite", find=not_finite, remedy=_WIRING),
    Rule(name="stuck_channel", find=stuck, remedy=_WIRING),
    Rule(name="saturation", find=saturated,
         remedy="choose a larger range of the converter and record the test again"),
    Rule(name="spike", find=spikes, remedy=_WIRING),
    Rule(name="wrong_unit", find=slow_units, remedy=SET_UNIT),
    Rule(name="wrong_unit", find=references_beyond, remedy=SET_UNIT),
)
