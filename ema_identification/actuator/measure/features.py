"""Features of a record: numbers that do not depend on where a limit cycle happens to be.

Waveforms of two runs with the same physics differ, because the current relays make them chaotic;
these numbers do not. They describe the sensors and the supply over the whole record, each segment
of constant speed by means and lines in rotor angle, and each change of speed by how speed, torque
current and lag run through it. After a slow reversal they are read against the motor's travel
instead of time: the gap in which the shaft carries nothing, its width, and the torque that the
motor side then needs. Which features there are follows from the profile's plan, so they exist for
any profile.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit

from ema_identification.actuator.measure.lines import lines, rotor_lines, slip_of, turns_of
from ema_identification.actuator.measure.segments import (
    SLOW,
    MotionPlan,
    MotionSegment,
    Transition,
    plan,
)
from ema_identification.actuator.measure.signals import (
    TINY,
    TURN,
    DriveSignals,
    between_edges,
    drive_signals,
    kept_room,
    section_numbers,
    spreads,
    travels,
)
from ema_record.actuator import Actuator
from ema_record.channels import fall_of_bus
from ema_record.profile import Profile
from ema_record.record import Record

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


@njit(cache=True, nogil=True)
def converter_step(values: np.ndarray) -> float:
    """Return the step of the converter that gave `values`: their smallest difference."""
    least = np.inf
    for i in range(len(values) - 1):
        step = abs(values[i + 1] - values[i])
        least = step if 1e-12 < step < least else least
    return float(least) if least < np.inf else 0.0


def _log_step(found: float, nominal: float) -> float:
    return float(np.log2(max(found / nominal, LEAST_STEP)))


def consistency(record: Record, signals: DriveSignals, actuator: Actuator) -> list[float]:
    """Return the features of `CONSISTENCY`."""
    c = actuator.converters
    off = np.searchsorted(signals.time, record.profile.inverter_off)
    start = signals.position[:max(off, 1)].mean()
    travel = signals.theta[-1] - signals.theta[0]
    read, length = travels(signals.time, signals.speed, signals.theta)
    return [
        *signals.offset.tolist(),
        float(signals.gain[0] - signals.gain[1]), float(signals.gain[0] - signals.gain[2]),
        _log_step(converter_step(signals.position), c.position_range / 2.0**c.position_bits),
        _log_step(converter_step(signals.speed), c.speed_range / 2.0**c.speed_bits),
        1e3 * (float(start) - record.profile.start),
        fall_of_bus(record.dc_bus),
        1e3 * (read * signals.pole_pairs - travel) / (length + 1.0),
    ]


STEP_EDGES = 1e-3 * np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0,
                              15.0, 20.0, 30.0])
START_EDGES = 1e-3 * np.array([0.0, 1.0, 2.0, 4.0, 7.0, 11.0, 16.0, 25.0, 40.0])
STOP_EDGES = 1e-3 * np.array([-40.0, -20.0, -8.0, 0.0, 10.0, 25.0, 45.0])
TRAVEL_EDGES = 1e-4 * np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0,
                                13.0, 14.0, 16.0, 18.0, 20.0, 24.0, 28.0, 33.0, 40.0])
"""At the surface (rad)."""
LOOK = (-0.010, 0.040)
"""Where the turning point of a reversal is looked for (s)."""
LEAST_ROOM = 5e-3
"""A transition with less time before the next one gives no features (s)."""

Table = Mapping[str, tuple[str, str]]
"""Signal and abscissa of features by key, in their order."""
Block = tuple[Table, Sequence[float] | np.ndarray]
"""Some features, and their values."""
LAG = "motor travel minus surface position"
RUNNING = (("speed", "motor speed", 1.0), ("current", "motor torque", 1.0), ("lag", LAG, 1e3))
"""Key, signal and scale of what is read in steps of time."""


@cache
def _steps(kinds: tuple[tuple[str, str], ...], count: int, against: str) -> Table:
    return {f"{key}_{k}": (signal, against) for key, signal in kinds for k in range(count)}


def transition_features(
    signals: DriveSignals, transition: Transition, actuator: Actuator
) -> Iterator[Block]:
    """Yield the features of a change."""
    if transition.room < LEAST_ROOM:
        return
    fastest = max(abs(transition.before), abs(transition.after))
    if transition.kind == "reversal" and fastest < SLOW * actuator.control.speed_limit:
        yield from _gap(signals, transition, actuator)
        return
    edges = (STEP_EDGES if transition.stepped else
             STOP_EDGES if transition.kind == "stop" else START_EDGES)
    edges = edges[edges <= transition.room + 1e-9] + transition.time
    bounds = np.searchsorted(signals.time, edges)
    rows = (signals.speed, signals.torque_current, signals.lag)
    yield _steps(tuple(kind[:2] for kind in RUNNING), len(edges) - 1, "test phase"), [
        scale * mean for values, (*_, scale) in zip(rows, RUNNING)
        for mean in between_edges(values, bounds, False).tolist()]


def _gap(signals: DriveSignals, transition: Transition, actuator: Actuator) -> Iterator[Block]:
    sense = 1.0 if transition.after > 0.0 else -1.0
    ratio = actuator.gear.ratio * actuator.motor.pole_pairs
    near = signals.between(transition.time + LOOK[0], transition.time + LOOK[1])
    if near.stop <= near.start:
        return
    turning = near.start + int(np.argmin(sense * signals.theta[near]))
    end = signals.between(0.0, transition.time + transition.room).stop
    part = slice(turning, max(end, turning + 2))
    travel = np.maximum.accumulate(
        sense * (signals.theta[part] - signals.theta[turning]) / ratio)
    moved = 1e3 * sense * (signals.position[part] - signals.position[turning])
    current = sense * signals.torque_current[part]
    bounds = np.searchsorted(travel, TRAVEL_EDGES)
    yield _steps((("gap_current", "motor torque"), ("gap_position", "surface position")),
                 len(bounds) - 1, "position"), [
        *between_edges(current, bounds, True).tolist(),
        *between_edges(moved, bounds, True).tolist()]
    yield TURNING, [1e3 * float(signals.time[turning] - transition.time)]


TURNING = {"turning_time": ("motor speed", "test phase")}


class Feature(NamedTuple):
    """What one number of the vector is."""

    name: str
    place: str
    """Segment or transition (`MotionPlan`), or ``record``."""
    signal: str
    against: str
    """As `result.Where.against`."""


FAST, MIDDLE, RAMP = (12, 4, 13), (24, 4, 7), (24, 2, 3)
"""How many lines a segment gives of torque, speed and currents."""
BANDS = ((25, 40), (41, 64))
"""Bands of higher lines of the torque, from which the largest is kept."""
THIRD = np.exp(2j * np.pi / 3.0 * np.arange(3))
WHOLE = "record"
"""Place of a feature of the record as a whole."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureMap:
    """How a record of one profile becomes a vector."""

    profile: Profile
    actuator: Actuator
    rate: float
    """Of the records, samples a second: ripple and noise depend on it."""
    plan: MotionPlan
    features: tuple[Feature, ...]

    def extract(self, record: Record) -> np.ndarray:
        """Return the feature vector of a record, shape (d,)."""
        return np.concatenate([values for _, _, values in _walk(
            record, self.plan, self.actuator)])


def nominal_rate(record: Record) -> float:
    """Return the rate of a record without the jitter of its clock, samples a second."""
    return float(f"{record.rate:.3g}")


def feature_map(profile: Profile, actuator: Actuator, example: Record) -> FeatureMap:
    """Return the map of a profile; `example` is any record of it, at the rate of all."""
    steps = plan(profile, actuator)
    features = tuple(
        Feature(key if place == WHOLE else f"{place}.{key}", place, signal, against)
        for place, table, _ in _walk(example, steps, actuator)
        for key, (signal, against) in table.items())
    return FeatureMap(profile=profile, actuator=actuator, rate=nominal_rate(example),
                      plan=steps, features=features)


def _walk(
    record: Record, steps: MotionPlan, actuator: Actuator
) -> Iterator[tuple[str, Table, Sequence[float] | np.ndarray]]:
    """Yield place, names and values of some features after others."""
    signals = drive_signals(record, actuator, kept_room(len(record)))
    yield WHOLE, CONSISTENCY, consistency(record, signals, actuator)
    for segment in steps.segments:
        source = _hold(record, signals, segment) if segment.kind == "hold" else _moving(
            signals, segment, actuator)
        for block in source:
            yield segment.name, *block
    for transition in steps.transitions:
        for block in transition_features(signals, transition, actuator):
            yield transition.name, *block


def _log(value: float) -> float:
    return float(np.log(value + TINY))


HOLD = {
    "current": ("motor torque", "test phase"),
    "current_spread": ("motor torque", "test phase"),
    "speed_spread": ("motor speed", "test phase"),
    "lag": (LAG, "test phase"),
    "error": ("surface position", "test phase"),
}
MOVING = {
    "current": ("motor torque", "speed"),
    "speed": ("motor speed", "speed"),
    "lag": (LAG, "load"),
    "slope": ("motor torque", "position"),
    "lag_slope": (LAG, "position"),
    "current_ripple": ("motor torque", "frequency"),
    "speed_ripple": ("motor speed", "frequency"),
    "speed_hunting": ("motor speed", "frequency"),
    **{f"ripple_{phase}": (f"phase current {phase}", "frequency") for phase in "abc"},
}


def _hold(record: Record, signals: DriveSignals, segment: MotionSegment) -> Iterator[Block]:
    part = signals.between(segment.begin, segment.end)
    q, speed = signals.torque_current[part], signals.speed[part]
    goal = record.profile.command(signals.time[part])
    yield HOLD, [
        float(q.mean()), _log(q.std()), _log(speed.std()), 1e3 * float(signals.lag[part].mean()),
        1e3 * float((signals.position[part] - goal).mean())]


def _moving(signals: DriveSignals, segment: MotionSegment, actuator: Actuator) -> Iterator[Block]:
    part = signals.between(segment.begin, segment.end)
    q, speed, lag, slope, lag_slope = section_numbers(signals.rows, part.start, part.stop)
    ripple = np.log(spreads(signals.rows, part.start, part.stop) + TINY)
    yield MOVING, [q, speed, 1e3 * lag, slope, 1e3 * lag_slope, *ripple.tolist()]
    turns_planned = abs(segment.speed) * (segment.end - segment.begin) / TURN
    if turns_planned * signals.pole_pairs >= LEAST_TURNS:
        yield from _locked(signals, segment, part, actuator)
    if turns_planned >= LEAST_TURNS and signals.pole_pairs > 1:
        yield from rotor_lines(
            signals.theta, signals.torque_current, signals.speed, part, actuator)


LEAST_TURNS, HALF_SPEED = 1.2, 0.5
"""Turns of a section of which lines are taken; share of the speed limit from which on few are."""


def _locked(
    signals: DriveSignals, segment: MotionSegment, part: slice, actuator: Actuator
) -> Iterator[Block]:
    """Yield lines locked to the rotor angle."""
    fast = abs(segment.speed) >= HALF_SPEED * actuator.control.speed_limit
    wanted = RAMP if segment.kind == "ramp" else FAST if fast else MIDDLE
    of_torque, of_speed, of_currents = wanted
    top = BANDS[-1][1] if wanted is not FAST else of_currents
    turns = turns_of(signals.theta, part)
    if turns is None:  # it did not move: no lines
        found = np.zeros((top + 1, 7), dtype=complex)
    else:
        p = turns.part
        slip = slip_of(signals.time[p], signals.speed[p], turns.theta, signals.pole_pairs)
        stack = np.vstack([signals.torque_current[p], signals.speed[p], signals.error[p].T,
                           signals.total[p], slip])
        found = lines(turns, stack.T, top)
    k2 = 2.0 * actuator.motor.back_emf_constant
    h = np.arange(top + 1)
    accelerating = 1j * h * actuator.motor.inertia * found[0, 1].real * signals.pole_pairs
    torque = k2 * found[:, 0] - accelerating * found[:, 1]
    error = found[:of_currents + 1, 2:5]
    yield _complex("torque_line", 1, torque[:of_torque + 1], 1e3, "motor torque")
    yield _complex("speed_line", 1, found[:of_speed + 1, 1], 1.0, "motor speed")
    yield _complex("slip_line", 1, found[:3, 6], 1e3,
                   "measured speed minus speed of the rotor angle")
    yield _complex("sum_line", 1, found[:3, 5], 1e3, "sum of the phase currents")
    yield SUM_MEAN, [1e3 * float(found[0, 5].real)]
    yield _complex("error_line", 0, 2.0 / 3.0 * error @ THIRD, 1e3, "phase currents")
    yield _complex("error_line_back", 1, 2.0 / 3.0 * error.conj() @ THIRD, 1e3, "phase currents")
    if wanted is not FAST:
        yield BAND_LINES, [_log(1e3 * float(np.abs(torque[low:high + 1]).max()) + 1e-2)
                           for low, high in BANDS]


SUM_MEAN = {"sum_mean": ("sum of the phase currents", "test phase")}
BAND_LINES = {f"torque_band_{low}_{high}": ("motor torque", "rotor angle")
              for low, high in BANDS}


def _complex(name: str, first: int, values: np.ndarray, scale: float, signal: str) -> Block:
    """Return lines from order `first` on; `values` : from order 0."""
    parts = scale * np.ascontiguousarray(values[first:]).view(float)
    return _line_table(name, first, len(values), signal), parts


@cache
def _line_table(name: str, first: int, end: int, signal: str) -> Table:
    return {f"{name}_{h}_{part}": (signal, "rotor angle")
            for h in range(first, end) for part in ("re", "im")}
