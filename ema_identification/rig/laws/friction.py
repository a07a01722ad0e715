"""Laws of friction against direction, speed, load and position."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_identification.rig.laws.base import Law, Shape, sign
from ema_identification.rig.trajectory import Segment, Trajectory

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


def _load(segment: Segment, trajectory: Trajectory, _shape: Shape) -> Sequence[np.ndarray]:
    load = np.abs(trajectory.smoothed(segment, segment.acceleration))
    return (load * sign(segment, trajectory),)


def _outer_load(segment: Segment, trajectory: Trajectory, _s: Shape) -> Sequence[np.ndarray]:
    return (np.abs(segment.disturbance) * sign(segment, trajectory),)


def _both_directions(trajectory: Trajectory) -> bool:
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
    columns=lambda segment, _t, _s: (np.abs(segment.smooth_speed),), applies=_both_directions,
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
    against="load", coefficients=("value",), units={"value": "u/a"}, columns=_load,
    requires=("coulomb_friction",),
    positive=True,
)
OUTER_LOAD_FRICTION = Law(
    name="external_load_friction",
    meaning="dry friction in proportion to the external load", equation="u = μ |d| sign(v)",
    reference="Hamon et al. 2010, IFAC 43(10)",
    against="load", coefficients=("value",), units={"value": "1"}, columns=_outer_load,
    requires=("coulomb_friction",),
    applies=lambda trajectory: trajectory.has_disturbance,
    positive=True,
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
