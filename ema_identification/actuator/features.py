"""The feature vector of a record: what two runs with the same physics have in common.

Waveforms of two runs differ, because the current relays make them chaotic; these numbers do not.
Which numbers there are follows from the profile's plan, so they exist for any profile.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.consistency import CONSISTENCY, consistency
from ema_identification.actuator.lines import TURN, lines, turns_of
from ema_identification.actuator.segments import Plan, Segment, plan
from ema_identification.actuator.signals import Signals, prepare
from ema_identification.actuator.transitions import transition_features
from ema_record.profile import Profile
from ema_record.record import Record
from ema_sim.parameters import Actuator


class Feature(NamedTuple):
    """What one number of the vector is."""

    name: str
    place: str
    """Segment or transition (`Plan`), or ``record``."""
    signal: str
    against: str
    """As `identification.Where.against`."""


class Lines(NamedTuple):
    """How many lines a segment gives."""

    torque: int
    speed: int
    current: int


FAST = Lines(12, 4, 13)
MIDDLE = Lines(24, 4, 7)
SLOW = Lines(24, 2, 3)
BANDS = ((25, 40), (41, 64))
"""Bands of higher lines of the torque, from which the largest is kept."""
THIRD = np.exp(2j * np.pi / 3.0 * np.arange(3))
TINY = 1e-12
WHOLE = "record"
"""Place of a feature of the record as a whole."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureMap:
    """How a record of one profile becomes a vector."""

    profile: Profile
    actuator: Actuator
    plan: Plan
    features: tuple[Feature, ...]

    def extract(self, record: Record) -> np.ndarray:
        """Return the feature vector of a record, shape (d,)."""
        return np.array([entry[3] for _, entry in _walk(record, self.plan, self.actuator)])


def feature_map(profile: Profile, actuator: Actuator, example: Record) -> FeatureMap:
    """Return the map of a profile; `example` is any record of it."""
    steps = plan(profile, actuator)
    features = tuple(
        Feature(key if place == WHOLE else f"{place}.{key}", place, signal, against)
        for place, (key, signal, against, _) in _walk(example, steps, actuator))
    return FeatureMap(profile=profile, actuator=actuator, plan=steps, features=features)


Entry = tuple[str, str, str, float]
"""Name within its place, signal, abscissa and value of a feature."""


def _walk(record: Record, steps: Plan, actuator: Actuator) -> Iterator[tuple[str, Entry]]:
    """Yield place and entry of each feature."""
    signals = prepare(record, actuator)
    for key, value in consistency(record, signals, actuator).items():
        yield WHOLE, (key, *CONSISTENCY[key], value)
    for segment in steps.segments:
        source = _hold(record, signals, segment) if segment.kind == "hold" else _moving(
            signals, segment, actuator)
        for entry in source:
            yield segment.name, entry
    for transition in steps.transitions:
        for entry in transition_features(signals, transition, actuator):
            yield transition.name, entry


def _log(value: float) -> float:
    return float(np.log(value + TINY))


def _hold(record: Record, signals: Signals, segment: Segment) -> Iterator[Entry]:
    part = signals.between(segment.begin, segment.end)
    q, speed, lag = signals.torque_current[part], signals.speed[part], signals.lag[part]
    goal = record.profile.command(signals.time[part])
    yield "current", "motor torque", "test phase", float(q.mean())
    yield "current_spread", "motor torque", "test phase", _log(q.std())
    yield "speed_spread", "motor speed", "test phase", _log(speed.std())
    yield "lag", "motor travel minus surface position", "test phase", 1e3 * float(lag.mean())
    yield "error", "surface position", "test phase", 1e3 * float(
        (signals.position[part] - goal).mean())


def _moving(signals: Signals, segment: Segment, actuator: Actuator) -> Iterator[Entry]:
    part = signals.between(segment.begin, segment.end)
    q, speed = signals.torque_current[part], signals.speed[part]
    position, lag = signals.position[part], signals.lag[part]
    yield "current", "motor torque", "speed", float(q.mean())
    yield "speed", "motor speed", "speed", float(speed.mean())
    yield "lag", "motor travel minus surface position", "load", 1e3 * float(lag.mean())
    centred = position - position.mean()
    yield "slope", "motor torque", "position", float(
        (centred @ (q - q.mean())) / (centred @ centred + TINY))
    yield "lag_slope", "motor travel minus surface position", "position", 1e3 * float(
        (centred @ (lag - lag.mean())) / (centred @ centred + TINY))
    yield "current_ripple", "motor torque", "frequency", _log(np.diff(q).std())
    yield "speed_ripple", "motor speed", "frequency", _log(np.diff(speed).std())
    smooth = np.add.reduceat(speed[:len(speed) // 8 * 8], np.arange(0, len(speed) // 8 * 8, 8))
    yield "speed_hunting", "motor speed", "frequency", _log(np.diff(smooth).std() / 8.0)
    for k, phase in enumerate("abc"):
        yield (f"ripple_{phase}", f"phase current {phase}", "frequency",
               _log(np.diff(signals.error[part, k]).std()))
    turns_planned = abs(segment.speed) * (segment.end - segment.begin) / TURN
    if turns_planned * signals.pole_pairs >= 1.2:
        yield from _locked(signals, segment, part, actuator)


def _locked(
    signals: Signals, segment: Segment, part: slice, actuator: Actuator
) -> Iterator[Entry]:
    """Yield lines locked to the rotor angle."""
    wanted = SLOW if segment.kind == "ramp" else MIDDLE if abs(segment.speed) < 400.0 else FAST
    top = BANDS[-1][1] if wanted is not FAST else wanted.current
    turns = turns_of(signals.theta, part)
    if turns is None:  # it did not move: no lines
        found = np.zeros((top + 1, 7), dtype=complex)
    else:
        p = turns.part
        dt = np.gradient(signals.time[p])
        slip = np.cumsum(signals.speed[p] * dt) * signals.pole_pairs - turns.theta
        slip -= np.linspace(0.0, 1.0, len(slip)) * (slip[-1] - slip[0]) + slip[0]
        stack = np.column_stack([signals.torque_current[p], signals.speed[p],
                                 signals.error[p], signals.total[p], slip])
        found = lines(turns, stack, top)
    k2 = 2.0 * actuator.motor.back_emf_constant
    h = np.arange(top + 1)
    accelerating = 1j * h * actuator.motor.inertia * found[0, 1].real * signals.pole_pairs
    torque = k2 * found[:, 0] - accelerating * found[:, 1]
    yield from _complex("torque_line", range(1, wanted.torque + 1), torque, 1e3, "motor torque")
    yield from _complex("speed_line", range(1, wanted.speed + 1), found[:, 1], 1.0, "motor speed")
    yield from _complex("slip_line", range(1, 3), found[:, 6], 1e3,
                        "measured speed minus speed of the rotor angle")
    yield from _complex("sum_line", range(1, 3), found[:, 5], 1e3, "sum of the phase currents")
    yield "sum_mean", "sum of the phase currents", "test phase", 1e3 * float(found[0, 5].real)
    forward = 2.0 / 3.0 * found[:wanted.current + 1, 2:5] @ THIRD
    backward = 2.0 / 3.0 * found[:wanted.current + 1, 2:5].conj() @ THIRD
    yield from _complex("error_line", range(wanted.current + 1), forward, 1e3, "phase currents")
    yield from _complex("error_line_back", range(1, wanted.current + 1), backward, 1e3,
                        "phase currents")
    if wanted is not FAST:
        for low, high in BANDS:
            yield (f"torque_band_{low}_{high}", "motor torque", "rotor angle",
                   _log(1e3 * float(np.abs(torque[low:high + 1]).max()) + 1e-2))


def _complex(
    name: str, orders: range, values: np.ndarray, scale: float, signal: str
) -> Iterator[Entry]:
    parts = scale * np.ascontiguousarray(values[orders.start:orders.stop]).view(float)
    for key, value in zip(_line_names(name, orders), parts.tolist()):
        yield key, signal, "rotor angle", value


@cache
def _line_names(name: str, orders: range) -> list[str]:
    return [f"{name}_{h}_{part}" for h in orders for part in ("re", "im")]
