"""Laws with memory or of the drive: lost motion, presliding, delay, dead zone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import signal

from ema_identification.rig.laws.base import Law, Shape, sign
from ema_identification.rig.signals.trajectory import Segment, Trajectory, derivative

TWO_LEVELS = 0.2
"""Spread of the size of an input over its mean, below which it has two levels only."""
DAMPINGS = (0.01, 0.03, 0.1)


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


def _ways(position: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield the first and the last sample of each way between two reversals."""
    turns = np.nonzero(np.diff(np.sign(np.diff(position))) != 0.0)[0] + 1
    ends = [0, *turns.tolist(), len(position) - 1]
    yield from zip(ends[:-1], ends[1:])


def _since_reversal(position: np.ndarray, width: float) -> np.ndarray:
    """Return the state of a stop operator: travel since the last reversal, within ± width."""
    state = np.zeros_like(position)
    for first, last in _ways(position):
        way = position[first:last + 1] - position[first]
        state[first:last + 1] = np.clip(state[first] + way, -width, width)
    return state


def _build_up(position: np.ndarray, distance: float) -> np.ndarray:
    """Return the state of Dahl's model, from -1 to 1: it nears the direction over `distance`."""
    state = np.zeros_like(position)
    for first, last in _ways(position):
        way = position[first:last + 1] - position[first]
        side = np.sign(way[-1])
        state[first:last + 1] = side + (state[first] - side) * np.exp(-np.abs(way) / distance)
    return state


def _presliding(segment: Segment, trajectory: Trajectory, shape: Shape) -> Sequence[np.ndarray]:
    state = _build_up(trajectory.smoothed(segment, segment.position), shape[0])
    return (state - sign(segment, trajectory),)


def _backlash(segment: Segment, trajectory: Trajectory, shape: Shape) -> Sequence[np.ndarray]:
    """Return the acceleration of a load in a gap less that of the drive, and its friction.

    The load rests while the gap is crossed, and is caught at the far side in one blow: its
    momentum is that of the drive's speed again, which its own friction alone would not give back.
    """
    state = _since_reversal(trajectory.smoothed(segment, segment.position), 0.5 * shape[0])
    crossing = (np.abs(state) < 0.5 * shape[0] * (1.0 - 1e-9)).astype(np.float64)
    return (-derivative(derivative(state, segment.step), segment.step),
            -crossing * sign(segment, trajectory))


def _derivative_of_prediction(
    segment: Segment, trajectory: Trajectory, _shape: Shape
) -> Sequence[np.ndarray]:
    return (derivative(trajectory.smoothed(segment, segment.prediction), segment.step),)


def _many_levels(trajectory: Trajectory) -> bool:
    """Return whether the input has more than two levels; else its sign is the input itself."""
    size = np.abs(trajectory.target)
    return float(np.std(size)) > TWO_LEVELS * float(np.mean(size))


def resonances_grid(trajectory: Trajectory) -> Sequence[Shape]:
    """Return antiresonances that the band shows both sides of, lightly and well damped."""
    return tuple((float(f), d) for d in DAMPINGS
                 for f in np.geomspace(0.05 * trajectory.band, 0.5 * trajectory.band, 12))


def _snap(segment: Segment) -> np.ndarray:
    """Return the second derivative of the acceleration, shape (n,)."""
    return derivative(derivative(segment.acceleration, segment.step), segment.step)


def _lagging_load(segment: Segment, _trajectory: Trajectory, shape: Shape) -> Sequence[np.ndarray]:
    """Return the acceleration of a load on a spring less that of the drive."""
    omega, damping = 2.0 * np.pi * shape[0], shape[1]
    warped = 2.0 * segment.rate * np.tan(0.5 * omega * segment.step)
    above, below = signal.bilinear(
        [2.0 * damping * warped, warped**2], [1.0, 2.0 * damping * warped, warped**2],
        segment.rate)
    start = signal.lfilter_zi(above, below) * segment.acceleration[0]
    load, _ = signal.lfilter(above, below, segment.acceleration, zi=start)
    return (load - segment.acceleration,)


def frequencies_grid(trajectory: Trajectory) -> Sequence[Shape]:
    """Return frequencies within the band, half the resolution of the record apart (Hz)."""
    step = 0.5 / max(float(np.ptp(trajectory.time)), 1e-9)
    return tuple((float(f),) for f in np.arange(4.0 * step, trajectory.band, step))


def _wave_in_time(segment: Segment, _trajectory: Trajectory, shape: Shape) -> Sequence[np.ndarray]:
    phase = 2.0 * np.pi * shape[0] * segment.time
    return np.cos(phase), np.sin(phase)


def _one_clock(trajectory: Trajectory) -> bool:
    """Return whether all stretches follow one another in time: of one record."""
    return all(a.time[-1] < b.time[0]
               for a, b in zip(trajectory.segments[:-1], trajectory.segments[1:]))


HYSTERESIS = Law(
    name="presliding_hysteresis",
    meaning="dry friction that builds up over a distance after each reversal",
    equation="u = F (z - sign(v)), dz = (sign(v) - z) |dx| / δ, δ the distance",
    reference="Dahl 1968, A Solid Friction Model, TOR-0158(3107-18)-1",
    against="test phase", coefficients=("level",), shape=("distance",),
    units={"level": "u", "distance": "x"}, columns=_presliding, grid=travel_grid,
    requires=("coulomb_friction",),
    positive=True, sharpens=True,
)
BACKLASH = Law(
    name="backlash",
    meaning="lost motion: load and its friction are let go after each reversal",
    equation="u = J_l (a_l - a) - F_l sign(v) [in the gap], x_l = x less the play of the gap",
    reference="Nordin, Gutman 2002, Automatica 38(10)",
    against="test phase", coefficients=("inertia", "friction"), shape=("gap",),
    units={"inertia": "u/a", "friction": "u", "gap": "x"}, columns=_backlash, grid=travel_grid,
    positive=True, beside={"presliding_hysteresis": "inertia"},
    excludes=("load_side_compliance",),  # the sensor is at one side, here the drive's
)
DELAY = Law(
    name="control_delay",
    meaning="the motion lags behind the recorded input by a constant time",
    equation="u(t) = û(t + τ), to first order û + τ dû/dt", reference="Taylor's theorem",
    against="frequency", coefficients=("delay",), units={"delay": "s"},
    columns=_derivative_of_prediction, of_prediction=True, dynamic=True, excludes=("drive_lag",),
)
LAG = Law(
    name="drive_lag",
    meaning="the drive follows its command as a lag of first order: its current loop, a winding",
    equation="u = û + τ dû/dt", reference="Ellis 2012, Control System Design Guide, ch. 6",
    against="frequency", coefficients=("time_constant",), units={"time_constant": "s"},
    columns=_derivative_of_prediction, of_prediction=True, dynamic=True, positive=True,
    equivalent=lambda axis, _s: ("winding_inductance",) if axis.input == "voltage" else (),
    excludes=("control_delay",),
)
COMPLIANCE = Law(
    name="compliance", meaning="the load hangs on a spring: a belt, a shaft, a gear",
    equation="u = J a + J_l (a_l - a), a_l'' + 2 ζ ω a_l' + ω² a_l = 2 ζ ω a' + ω² a, ω = 2 π f",
    reference="Ellis, Lorenz 2000, IEEE IAS Annual Meeting (two-mass drives)",
    against="frequency", coefficients=("load_inertia",), shape=("frequency", "damping"),
    units={"load_inertia": "u/a", "frequency": "Hz", "damping": "1"},
    columns=_lagging_load, grid=resonances_grid, positive=True,
    part_of="inertia", located="frequency", dynamic=True,
    excludes=("load_side_compliance", "quasi_static_compliance"),  # the sensor is at one side
)
QUASI_STATIC_COMPLIANCE = Law(
    name="quasi_static_compliance",
    meaning="the load hangs on a spring that the motion winds up, far below its resonance",
    equation="u = J a - c a'', c = J_l / ω², the first term of Taylor's series of a compliance",
    reference="Ellis, Lorenz 2000, IEEE IAS Annual Meeting (two-mass drives)",
    against="frequency", coefficients=("value",), units={"value": "u*s²/a"},
    columns=lambda segment, _t, _s: (-_snap(segment),),
    dynamic=True, positive=True, excludes=("compliance", "load_side_compliance"),
    equivalent=lambda _axis, _shape: ("compliance",),
)
DEAD_ZONE = Law(
    name="dead_zone", meaning="the drive swallows a part of the input around zero",
    equation="u = û + d sign(û)", reference="Tao, Kokotović 1994, IEEE Trans. Aut. Control 39(1)",
    against="load", coefficients=("width",), units={"width": "u"},
    columns=lambda segment, trajectory, _s: (
        np.sign(trajectory.smoothed(segment, segment.prediction)),),
    of_prediction=True, linear=False, applies=_many_levels, positive=True,
)
LOAD_SIDE_COMPLIANCE = Law(
    name="load_side_compliance",
    meaning="the sensor sits at a load that hangs on a spring: the drive moves before it",
    equation="u = J a + c a'', c = J_1 J_2 / k; resonance at √(J / c)",
    reference="Ellis, Lorenz 2000, IEEE IAS Annual Meeting (two-mass drives)",
    against="frequency", coefficients=("value",), units={"value": "u*s²/a"},
    columns=lambda segment, _t, _s: (_snap(segment),),
    dynamic=True, positive=True,
    excludes=("compliance", "quasi_static_compliance", "backlash"),
)
PERIODIC_DISTURBANCE = Law(
    name="periodic_disturbance",
    meaning="a wave in time whatever the motion: hum, a pump, a fan",
    equation="u = A cos(2 π f t - φ)",
    reference="Bodson, Douglas 1997, Automatica 33(12)",
    against="frequency", coefficients=("cosine", "sine"), shape=("frequency",),
    units={"amplitude": "u", "phase": "rad", "frequency": "Hz"}, columns=_wave_in_time,
    grid=frequencies_grid, periodic=True, looked_for=True, repeats=True, applies=_one_clock,
)
