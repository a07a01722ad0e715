"""Laws with memory or of the drive: lost motion, presliding, delay, dead zone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_identification.rig.laws.base import Law, Shape, sign
from ema_identification.rig.trajectory import Segment, Trajectory, derivative
from ema_record.rig import Axis


def travel_grid(trajectory: Trajectory) -> Sequence[Shape]:
    """Return distances between what the band resolves and a tenth of the travel.

    After a reversal the axis travels ``a / (8 f²)`` within half a period of the band's edge.
    """
    span = float(np.ptp(trajectory.position))
    hard = float(np.sqrt(np.mean(trajectory.acceleration**2)))
    low = max(hard / (4.0 * trajectory.band**2), 1e-5 * span)
    high = 0.1 * span
    if high <= 2.0 * low:
        return ()
    return tuple((float(d),) for d in np.geomspace(low, high, 14))


def _since_reversal(position: np.ndarray, width: float) -> np.ndarray:
    """Return the state of a stop operator: travel since the last reversal, within ± width."""
    steps = np.diff(position)
    turns = np.nonzero(np.diff(np.sign(steps)) != 0.0)[0] + 1
    ends = [0, *turns.tolist(), len(position) - 1]
    state = np.zeros_like(position)
    for first, last in zip(ends[:-1], ends[1:]):  # one way between reversals
        way = position[first:last + 1] - position[first]
        state[first:last + 1] = np.clip(state[first] + way, -width, width)
    return state


def _presliding(segment: Segment, trajectory: Trajectory, shape: Shape) -> Sequence[np.ndarray]:
    state = _since_reversal(trajectory.smoothed(segment, segment.position), 0.5 * shape[0])
    return (state / (0.5 * shape[0]) - sign(segment, trajectory),)


def _backlash(segment: Segment, trajectory: Trajectory, shape: Shape) -> Sequence[np.ndarray]:
    state = _since_reversal(trajectory.smoothed(segment, segment.position), 0.5 * shape[0])
    crossing = (np.abs(state) < 0.5 * shape[0] * (1.0 - 1e-9)).astype(np.float64)
    return (-crossing * trajectory.smoothed(segment, segment.acceleration),
            -crossing * sign(segment, trajectory))


def _derivative_of_prediction(
    segment: Segment, trajectory: Trajectory, _shape: Shape
) -> Sequence[np.ndarray]:
    return (derivative(trajectory.smoothed(segment, segment.prediction), segment.step),)


def _sign_of_prediction(
    segment: Segment, trajectory: Trajectory, _shape: Shape
) -> Sequence[np.ndarray]:
    return (np.sign(trajectory.smoothed(segment, segment.prediction)),)


def _or_inductance(axis: Axis, _shape: Shape) -> tuple[str, ...]:
    return ("winding_inductance",) if axis.input == "voltage" else ()


HYSTERESIS = Law(
    name="presliding_hysteresis",
    meaning="dry friction that builds up over a distance after each reversal",
    equation="u = F (z/δ - sign(v)), z the travel since reversal within ± δ, 2δ the distance",
    reference="Al-Bender, Lampaert, Swevers 2005, IEEE Trans. Automatic Control 50(11)",
    against="test phase", coefficients=("level",), shape=("distance",),
    units={"level": "u", "distance": "x"}, columns=_presliding, grid=travel_grid,
    requires=("coulomb_friction",),
    positive=True,
)
BACKLASH = Law(
    name="backlash",
    meaning="lost motion: load and its friction are let go after each reversal",
    equation="u = -(J_l a + F_l sign(v)) while the gap is crossed",
    reference="Nordin, Gutman 2002, Automatica 38(10)",
    against="test phase", coefficients=("inertia", "friction"), shape=("gap",),
    units={"inertia": "u/a", "friction": "u", "gap": "x"}, columns=_backlash, grid=travel_grid,
    positive=True,
)
DELAY = Law(
    name="control_delay",
    meaning="the motion lags behind the recorded input by a constant time",
    equation="u(t) = û(t + τ), to first order û + τ dû/dt", reference="Taylor's theorem",
    against="frequency", coefficients=("delay",), units={"delay": "s"},
    columns=_derivative_of_prediction, of_prediction=True, equivalent=_or_inductance,
)
DEAD_ZONE = Law(
    name="dead_zone", meaning="the drive swallows a part of the input around zero",
    equation="u = û + d sign(û)", reference="Tao, Kokotović 1994, IEEE Trans. Aut. Control 39(1)",
    against="load", coefficients=("width",), units={"width": "u"},
    columns=_sign_of_prediction, of_prediction=True,
    positive=True,
)
