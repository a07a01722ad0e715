"""Laws of force or torque against position: springs, weight, cogging."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ema_identification.rig.laws.base import Law, Shape
from ema_identification.rig.trajectory import Segment, Trajectory
from ema_record.rig import Axis

HIGHEST_ORDER = 400
MAX_ORDERS = 800
HIGHEST_INERTIA = 4
SLOW_SHARE = 0.01
"""An order is looked for where it lies inside the band for so much of the time at least."""
_TURN = 2.0 * math.pi


def wave(trajectory: Trajectory, order: float) -> float:
    """Return radians of phase a unit of position, for an order a turn or a m."""
    return order if trajectory.axis.motion == "rotary" else _TURN * order


def periodic_columns(
    segment: Segment, trajectory: Trajectory, shape: Shape
) -> Sequence[np.ndarray]:
    """Return cosine and sine of position, zero where they are too fast for the sampling."""
    number = wave(trajectory, shape[0])
    phase = number * segment.position
    slow = np.abs(number * segment.smooth_speed) < _TURN * 0.4 * segment.rate
    return np.cos(phase) * slow, np.sin(phase) * slow


def orders(trajectory: Trajectory) -> Sequence[Shape]:
    """Return the orders a turn (rotary) or a m (linear) that the record can show.

    Whole numbers a turn where the axis turns more than once, and steps of half the
    resolution ``1 / travel`` as far as `MAX_ORDERS` allow; nothing below one and a half periods
    in the travel.
    """
    travel = trajectory.turns
    if travel <= 0.0:
        return ()
    slow = float(np.quantile(np.abs(trajectory.speed), SLOW_SHARE))
    highest = trajectory.band * _TURN / max(slow, 1e-12) / wave(trajectory, 1.0)
    lowest = 1.5 / travel
    if trajectory.axis.motion == "rotary":
        highest = min(highest, HIGHEST_ORDER)
        whole = [float(n) for n in range(max(1, math.ceil(lowest)), int(highest) + 1)]
    else:
        whole = []
        highest = min(highest, MAX_ORDERS / (2.0 * travel))
    step = 0.5 / travel
    room = MAX_ORDERS - len(whole)
    fine = np.arange(lowest, min(highest, lowest + room * step), step)
    found = set(whole) | {
        float(n) for n in fine if not whole or abs(n - round(n)) > step}
    return tuple((n,) for n in sorted(found) if lowest <= n <= highest)


def is_whole(order: float, travel: float) -> bool:
    """Return whether an order is a whole number a turn, within the resolution."""
    return order >= 0.75 and abs(order - round(order)) < 0.5 / max(travel, 1e-9)


def _same_as_ripple(axis: Axis, shape: Shape) -> tuple[str, ...]:
    order = shape[0]
    if axis.motion == "rotary" and order == round(order):
        return ("unbalance", "speed_sensor_runout") if order == 1 else ()
    return ("gear_mesh_ripple",)


def _rests(trajectory: Trajectory) -> Sequence[Shape]:
    """Return positions of rest within the travel and half of it beyond either end."""
    low, high = float(trajectory.position.min()), float(trajectory.position.max())
    reach = 0.5 * (high - low)
    return tuple((float(x),) for x in np.linspace(low - reach, high + reach, 13))


def _inertia_columns(
    segment: Segment, _trajectory: Trajectory, shape: Shape
) -> Sequence[np.ndarray]:
    """Return what an inertia ``J(θ)`` asks for: ``J a + dJ/dθ v²/2``, cosine and sine of it."""
    order, speed = shape[0], segment.speed
    cosine, sine = np.cos(order * segment.position), np.sin(order * segment.position)
    half = 0.5 * order * speed**2
    return (cosine * segment.acceleration - half * sine, sine * segment.acceleration
            + half * cosine)


COGGING_TORQUE = Law(
    name="cogging_torque", meaning="force or torque that is periodic in position",
    equation="u = A cos(n θ - φ), n periods a turn; on a linear axis n periods a m",
    reference="Hanselman 2006, Brushless Permanent Magnet Motor Design",
    against="position", coefficients=("cosine", "sine"), shape=("order",),
    units={"amplitude": "u", "phase": "rad", "order": "1/turn"},
    columns=periodic_columns, grid=orders, periodic=True, repeats=True,
    equivalent=_same_as_ripple,
)
SPRING = Law(
    name="spring", meaning="force in proportion to position",
    equation="u = k (x - x_0), x_0 where it is at rest", reference="Hooke's law",
    against="position", coefficients=("stiffness",), shape=("rest",),
    units={"stiffness": "u/x", "rest": "x"},
    columns=lambda segment, _t, shape: (segment.position - shape[0],), grid=_rests,
)
GRAVITY = Law(
    name="gravity", meaning="weight of an arm: periodic in position, once a turn",
    equation="u = A cos(θ - φ)", reference="moment of a weight about a horizontal axis",
    against="position", coefficients=("cosine", "sine"), shape=("order",),
    units={"amplitude": "u", "phase": "rad", "order": "1/turn"}, columns=periodic_columns,
    grid=lambda _t: ((1.0,),), periodic=True,
    applies=lambda trajectory: trajectory.axis.motion == "rotary" and trajectory.turns < 1.5,
)
POSITION_DEPENDENT_INERTIA = Law(
    name="position_dependent_inertia",
    meaning="inertia that changes with the angle: a crank, a linkage",
    equation="u = J(θ) a + J'(θ) v²/2, J(θ) = A cos(n θ - φ) beside the mean inertia",
    reference="Lagrange's equation of one degree of freedom; Dresig, Holzweißig 2010, ch. 2",
    against="load", coefficients=("cosine", "sine"), shape=("order",),
    units={"amplitude": "u/a", "phase": "rad", "order": "1/turn"}, columns=_inertia_columns,
    grid=lambda _t: tuple((float(n),) for n in range(1, HIGHEST_INERTIA + 1)), periodic=True,
    applies=lambda trajectory: trajectory.axis.motion == "rotary" and trajectory.turns > 0.25,
)
