"""Laws without memory: of motion (inertia, viscous friction), of friction, and of position."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ema_identification.rig.laws.base import Law, Shape, sign
from ema_identification.rig.signals.trajectory import Segment, Trajectory
from ema_rig.record import Axis

_REVIEW = "Armstrong-Hélouvry et al. 1994, Automatica 30(7)"


def speeds_grid(trajectory: Trajectory) -> Sequence[Shape]:
    """Return Stribeck speeds between standstill and half the highest speed."""
    speed = np.abs(trajectory.speed)
    low = max(2.0 * trajectory.standstill, float(np.quantile(speed, 0.02)))
    high = 0.5 * float(np.quantile(speed, 0.98))
    if high <= 1.2 * low:
        return ()
    return tuple((float(v),) for v in np.geomspace(low, high, 12))


def _stribeck(segment: Segment, trajectory: Trajectory, shape: Shape) -> Sequence[np.ndarray]:
    ratio = segment.smooth_speed / shape[0]
    return (sign(segment, trajectory) * np.exp(-(ratio**2)),)


def both_directions(trajectory: Trajectory) -> bool:
    """Return whether a motion goes both ways, not just by chance."""
    forward = float(np.mean(trajectory.speed > 0))
    return 0.02 < forward < 0.98


COULOMB_FRICTION = Law(
    name="coulomb_friction", meaning="dry friction, constant but for the direction",
    equation="u = F sign(v)", reference=_REVIEW,
    against="speed", coefficients=("level",), units={"level": "u"},
    columns=lambda segment, trajectory, _s: (sign(segment, trajectory),),
    positive=True,
)
OFFSET = Law(
    name="offset", meaning="constant input that moves nothing: bias of drive or sensor, weight",
    equation="u = c", reference="Janot, Gautier, Brunot 2019 (EMPS benchmark)",
    against="speed", coefficients=("value",), units={"value": "u"},
    columns=lambda segment, _t, _s: (np.ones(len(segment)),),
    equivalent=lambda _axis, _shape: ("asymmetric_friction",),
)
ASYMMETRIC_FRICTION = Law(
    name="asymmetric_friction", meaning="friction that depends on the direction of motion",
    equation="u = D |v|; the part that does not grow with speed is an offset",
    reference="Swevers et al. 1997, IEEE Control Systems 17(5)",
    against="speed", coefficients=("viscous_difference",), units={"viscous_difference": "u/v"},
    columns=lambda segment, _t, _s: (np.abs(segment.smooth_speed),), applies=both_directions,
)
STRIBECK_FRICTION = Law(
    name="stribeck_friction", meaning="dry friction that falls as the speed rises",
    equation="u = S sign(v) exp(-(v/v_s)²)", reference=_REVIEW,
    against="speed", coefficients=("increase",), shape=("speed",),
    units={"increase": "u", "speed": "v"}, columns=_stribeck, grid=speeds_grid,
    requires=("coulomb_friction",),
    positive=True, sharpens=True,
)
QUADRATIC_DRAG = Law(
    name="quadratic_drag", meaning="windage or drag in proportion to the square of the speed",
    equation="u = D v |v|", reference="drag equation, turbulent flow",
    against="speed", coefficients=("value",), units={"value": "u/v²"},
    columns=lambda segment, _t, _s: (segment.smooth_speed * np.abs(segment.smooth_speed),),
    positive=True, joins=("coulomb_friction",),
)
SUBLINEAR_VISCOUS_FRICTION = Law(
    name="sublinear_viscous_friction",
    meaning="viscous friction that rises less than in proportion to speed",
    equation="u = D sign(v) |v|^(1/2)",
    reference="Bona, Indri 2005, 44th IEEE CDC (power laws of lubricated friction)",
    against="speed", coefficients=("value",), units={"value": "u/v^0.5"},
    columns=lambda segment, trajectory, _s: (
        sign(segment, trajectory) * np.sqrt(np.abs(segment.smooth_speed)),),
    requires=("coulomb_friction",), positive=True, sharpens=True,
)
LOAD_DEPENDENT_FRICTION = Law(
    name="load_dependent_friction",
    meaning="dry friction in proportion to the inertial load that is transmitted",
    equation="u = μ |a| sign(v)", reference="Hamon et al. 2010, IFAC 43(10)",
    against="load", coefficients=("value",), units={"value": "u/a"},
    columns=lambda segment, trajectory, _s: (
        np.abs(trajectory.smoothed(segment, segment.acceleration)) * sign(segment, trajectory),),
    requires=("coulomb_friction",), positive=True,
)
OUTER_LOAD_FRICTION = Law(
    name="external_load_friction",
    meaning="dry friction in proportion to the external load", equation="u = μ |d| sign(v)",
    reference="Hamon et al. 2010, IFAC 43(10)",
    against="load", coefficients=("value",), units={"value": "1"},
    columns=lambda segment, trajectory, _s: (
        np.abs(segment.disturbance) * sign(segment, trajectory),),
    requires=("coulomb_friction",), positive=True,
    applies=lambda trajectory: trajectory.has_disturbance,
)
POSITION_DEPENDENT_FRICTION = Law(
    name="position_dependent_friction",
    meaning="dry friction that changes along the travel",
    equation="u = k (x - x_0) sign(v), x_0 the middle of the travel",
    reference=_REVIEW, against="position", coefficients=("slope",), shape=("middle",),
    units={"slope": "u/x", "middle": "x"},
    columns=lambda segment, trajectory, shape: (
        (segment.position - shape[0]) * sign(segment, trajectory),),
    grid=lambda trajectory: ((float(
        0.5 * (trajectory.position.min() + trajectory.position.max())),),),
    requires=("coulomb_friction",),
)

INERTIA = Law(
    name="inertia", meaning="inertia of everything that moves",
    equation="u = J a", reference="Newton's second law",
    against="load", coefficients=("value",), units={"value": "u/a"},
    columns=lambda segment, _t, _s: (segment.acceleration,), positive=True,
)
VISCOUS_FRICTION = Law(
    name="viscous_friction", meaning="friction in proportion to speed",
    equation="u = B v; a voltage also drives against the back-EMF, which is in proportion too",
    reference=_REVIEW,
    against="speed", coefficients=("value",), units={"value": "u/v"},
    columns=lambda segment, _t, _s: (segment.speed,), positive=True,
    equivalent=lambda axis, _s: ("back_emf",) if axis.input == "voltage" else (),
)
DISTURBANCE = Law(
    name="disturbance", meaning="the known force or torque from outside, which helps the input",
    equation="u + g d = J a + ...; g = 1 where input and disturbance have one unit",
    reference="balance of the axis",
    against="load", coefficients=("gain",), units={"gain": "1"},
    columns=lambda segment, _t, _s: (-segment.disturbance,),
    applies=lambda trajectory: trajectory.has_disturbance,
)

HIGHEST_ORDER = 400
MAX_ORDERS = 800
HIGHEST_INERTIA = 4
LEAST_PERIODS = 3.0
"""Of a wave in the travel: fewer may as well be a spring, a stop, or the load of another axis."""
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
    resolution ``1 / travel`` as far as `MAX_ORDERS` allow; nothing below `LEAST_PERIODS` in the
    travel.
    """
    travel = trajectory.turns
    if travel <= 0.0:
        return ()
    slow = float(np.quantile(np.abs(trajectory.speed), SLOW_SHARE))
    highest = trajectory.band * _TURN / max(slow, 1e-12) / wave(trajectory, 1.0)
    lowest = LEAST_PERIODS / travel
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
        if axis.pole_pairs is not None and axis.input in ("current", "torque"):
            if order == axis.pole_pairs:
                return ("current_sensor_offset",)
            if order == 2 * axis.pole_pairs:
                return ("current_sensor_gain",)
        return ("unbalance", "speed_sensor_runout") if order == 1 else ()
    return ("gear_mesh_ripple",)


def _rests(trajectory: Trajectory) -> Sequence[Shape]:
    """Return positions of rest within the travel and half of it beyond either end."""
    low, high = float(trajectory.position.min()), float(trajectory.position.max())
    reach = 0.5 * (high - low)
    return tuple((float(x),) for x in np.linspace(low - reach, high + reach, 13))


def _stop_places(trajectory: Trajectory) -> Sequence[Shape]:
    """Return places in the outer thirds of the travel, at which a stop may begin."""
    low, high = np.quantile(trajectory.position, [0.002, 0.998])
    outer = (high - low) * np.linspace(0.04, 0.32, 8)
    return tuple((float(x),) for x in (*(low + outer), *(high - outer)))


def _clearances(trajectory: Trajectory) -> Sequence[Shape]:
    """Return middles about that of the travel, and halves of a clearance within it."""
    low, high = np.quantile(trajectory.position, [0.002, 0.998])
    span = float(high - low)
    return tuple((float(0.5 * (low + high) + m * span), float(h * span))
                 for m in np.linspace(-0.15, 0.15, 5) for h in np.linspace(0.05, 0.4, 8))


def _stop(segment: Segment, trajectory: Trajectory, shape: Shape) -> Sequence[np.ndarray]:
    """Return the way into a stop, which lies towards the nearer end of the travel."""
    low, high = trajectory.position.min(), trajectory.position.max()
    into = segment.position - shape[0]
    return (np.maximum(into, 0.0) if shape[0] > 0.5 * (low + high) else np.minimum(into, 0.0),)


def _beyond(segment: Segment, _trajectory: Trajectory, shape: Shape) -> Sequence[np.ndarray]:
    way = segment.position - shape[0]
    return (way - np.clip(way, -abs(shape[1]), abs(shape[1])),)


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
HARDENING_SPRING = Law(
    name="hardening_spring", meaning="a spring that stiffens, or yields, as it is deflected",
    equation="u = k_3 (x - x_0)³", reference="Duffing 1918, Erzwungene Schwingungen",
    against="position", coefficients=("cubic",), shape=("rest",),
    units={"cubic": "u/x³", "rest": "x"},
    columns=lambda segment, _t, shape: ((segment.position - shape[0]) ** 3,), grid=_rests,
)
END_STOP = Law(
    name="end_stop", meaning="an elastic stop at one end of the travel",
    equation="u = k (x - x_s) beyond x_s", reference="Nordin, Gutman 2002, Automatica 38(10)",
    against="position", coefficients=("stiffness",), shape=("place",),
    units={"stiffness": "u/x", "place": "x"}, columns=_stop, grid=_stop_places, positive=True,
    excludes=("end_stops",),
)
END_STOPS = Law(
    name="end_stops", meaning="elastic stops at both ends, or a spring with play between",
    equation="u = k (x - x_0 ∓ w) beyond x_0 ± w", reference="Nordin, Gutman 2002, "
    "Automatica 38(10)",
    against="position", coefficients=("stiffness",), shape=("middle", "half_clearance"),
    units={"stiffness": "u/x", "middle": "x", "half_clearance": "x"}, columns=_beyond,
    grid=_clearances, positive=True,
    equivalent=lambda _axis, _shape: ("two_sided_backlash",),
)
GRAVITY = Law(
    name="gravity", meaning="weight of an arm: periodic in position, once a turn",
    equation="u = A cos(θ - φ)", reference="moment of a weight about a horizontal axis",
    against="position", coefficients=("cosine", "sine"), shape=("order",),
    units={"amplitude": "u", "phase": "rad", "order": "1/turn"}, columns=periodic_columns,
    grid=lambda _t: ((1.0,),), periodic=True,
    applies=lambda trajectory: trajectory.axis.motion == "rotary"
    and trajectory.turns < LEAST_PERIODS,
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
