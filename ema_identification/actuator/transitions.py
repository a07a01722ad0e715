"""Features of a change of speed: how speed, torque current and lag run through it.

After a slow reversal they are read against the motor's travel instead of time: the gap in which
the shaft carries nothing, its width and the torque that the motor side then needs.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ema_identification.actuator.segments import SLOW, Transition
from ema_identification.actuator.signals import Signals
from ema_sim.parameters import Actuator

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

Entry = tuple[str, str, str, float]
LAG = "motor travel minus surface position"


def transition_features(
    signals: Signals, transition: Transition, actuator: Actuator
) -> Iterator[Entry]:
    """Yield (name, signal, against, value)."""
    if transition.room < LEAST_ROOM:
        return
    slow = abs(transition.before) < SLOW and abs(transition.after) < SLOW
    if transition.kind == "reversal" and slow:
        yield from _gap(signals, transition, actuator)
        return
    edges = (STEP_EDGES if transition.stepped else
             STOP_EDGES if transition.kind == "stop" else START_EDGES)
    edges = edges[edges <= transition.room + 1e-9] + transition.time
    for name, values, signal, scale in (
        ("speed", signals.speed, "motor speed", 1.0),
        ("current", signals.torque_current, "motor torque", 1.0),
        ("lag", signals.lag, LAG, 1e3),
    ):
        for index, mean in enumerate(_means(signals.time, values, edges)):
            yield f"{name}_{index}", signal, "test phase", scale * mean


def _means(x: np.ndarray, values: np.ndarray, edges: np.ndarray) -> Iterator[float]:
    """Yield the mean of `values` between edges of the rising `x`."""
    bounds = np.searchsorted(x, edges)
    total = np.concatenate([[0.0], np.cumsum(values[bounds[0]:bounds[-1]])])
    bounds = bounds - bounds[0]
    for a, b in zip(bounds, bounds[1:]):
        yield float((total[b] - total[a]) / (b - a)) if b > a else 0.0


def _gap(signals: Signals, transition: Transition, actuator: Actuator) -> Iterator[Entry]:
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
    for name, values, signal in (
        ("gap_current", current, "motor torque"), ("gap_position", moved, "surface position"),
    ):
        last = float(values[0])
        for index, (a, b) in enumerate(zip(TRAVEL_EDGES, TRAVEL_EDGES[1:])):
            inside = values[(travel >= a) & (travel < b)]
            last = float(inside.mean()) if len(inside) else last
            yield f"{name}_{index}", signal, "position", last
    yield "turning_time", "motor speed", "test phase", 1e3 * float(
        signals.time[turning] - transition.time)
