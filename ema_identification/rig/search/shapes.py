"""Shapes that no law is named after: what may live where, whatever its form.

Each shape is a set of regressors that follow any smooth dependence on one quantity, or one
wave in position or time. They say where something is left, and what it looks like.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from ema_identification.rig.fit.balance import Design
from ema_identification.rig.fit.regression import autocorrelation
from ema_identification.rig.laws.base import Term
from ema_identification.rig.laws.static import COGGING_TORQUE, orders
from ema_identification.rig.signals.trajectory import Column, Segment, Trajectory

KNOTS = 9
PLACES = 21
MAX_FREQUENCIES = 12
OF_MOTION = 0.4
ABOVE_MOTION = 1.2
"""Waves in time have a name from so many times the band of the speed."""
REPEATS = 0.97
"""Least autocorrelation of the speed of a motion that repeats itself."""
IMAGE = 0.25
"""Of the power of a wave, what is left of an image without the waves that it is one of."""
RANK_OF_SHARED = 20
"""Of a wave that the motion has too: any smooth shape that takes nearly as much is named first."""


@dataclass(frozen=True, kw_only=True)
class GenericShape:
    """Regressors of one smooth dependence, already filtered and gated, shape (rows, k)."""

    against: str
    """``speed``, ``position``, ``load``, ``frequency``, ``test phase``."""
    label: str
    """For people: ``speed and direction``."""
    columns: np.ndarray
    looks: int = 1
    """How many shapes this one was picked from by looking; its p-value is multiplied by it."""
    groups: tuple[int, ...] = ()
    """Numbers of columns that follow one another along the abscissa."""
    of_motion: bool = False
    """Of a wave in time: whether the motion has it too."""
    rank: int = 0
    """Which of two shapes that take the same is named: the lower."""
    order: float | None = None
    """Of a wave: periods a turn or a m, or Hz against ``frequency``."""


def smooth_shapes(trajectory: Trajectory) -> list[GenericShape]:
    """Return the smooth dependences on speed, position, load and time.

    A dependence on the acceleration alone is not among them: its noise, which the input does
    not follow, bends any such curve.
    """
    speed_knots = np.unique(np.quantile(np.abs(trajectory.speed), np.linspace(0, 1, KNOTS)))
    low, high = np.quantile(trajectory.position, [0.005, 0.995])
    place_knots = np.linspace(low, high, PLACES)
    load_knots = np.unique(np.quantile(trajectory.acceleration, np.linspace(0.002, 0.998, 7)))
    time_knots = np.linspace(trajectory.time.min(), trajectory.time.max(), 6)

    def by_direction(segment: Segment) -> np.ndarray:
        speed = segment.smooth_speed
        hats, forward = _hats(np.abs(speed), speed_knots), speed > 0.0
        return np.hstack([hats * forward[:, None], hats * ~forward[:, None]])

    def signed(hats: np.ndarray, segment: Segment) -> np.ndarray:
        return hats * np.sign(segment.smooth_speed)[:, None]

    sets: list[tuple[str, str, Column]] = [
        ("speed", "speed and direction", by_direction),
        ("position", "position", lambda s: _hats(s.position, place_knots)),
        ("position", "position, with the sign of the speed",
         lambda s: signed(_hats(s.position, place_knots), s)),
        ("load", "acceleration, with the sign of the speed",
         lambda s: signed(_hats(trajectory.smoothed(s, s.acceleration), load_knots), s)),
        ("test phase", "time", lambda s: _hats(s.time, time_knots)),
    ]
    if trajectory.axis.motion == "rotary" and trajectory.turns > 1.2:
        angles = np.linspace(0.0, 2 * np.pi, 13)
        sets.append(("position", "angle within a turn",
                     lambda s: _hats(np.mod(s.position, 2 * np.pi), angles)))
    shapes = []
    for rank, (against, label, column) in enumerate(sets):
        columns = trajectory.reduce(column)
        sides = 2 if against == "speed" else 1
        shapes.append(GenericShape(
            against=against, label=label, rank=1 + rank, columns=columns,
            groups=(columns.shape[1] // sides,) * sides))
    return [_with_plain_speed(trajectory, shapes[0], speed_knots), *shapes[1:]]


def _hats(values: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Return the hat functions of the knots at the values, shape (n, knots)."""
    return np.column_stack([np.interp(values, knots, hat) for hat in np.eye(len(knots))])


def _with_plain_speed(
    trajectory: Trajectory, shape: GenericShape, knots: np.ndarray
) -> GenericShape:
    """Return the shape against speed, in which a straight line is the speed as recorded.

    Hats of the smooth speed add up to the smooth speed. Beside viscous friction, which takes the
    speed as it is, their difference would be a filter that takes a share of any residual.
    """
    values = np.concatenate([knots, -knots])
    line = trajectory.reduce(lambda segment: segment.speed) - shape.columns @ values
    return replace(shape, columns=shape.columns + np.outer(line, values / (values @ values)))


def waves_in_position(design: Design) -> list[GenericShape]:
    """Return one shape for each order that the record can show."""
    terms = [Term(law=COGGING_TORQUE, shape=shape) for shape in orders(design.trajectory)]
    design.evaluate(terms)
    return [GenericShape(against="position", label="a wave in position", order=term.shape[0],
                         columns=design.columns(term)) for term in terms]


def waves_in_time(
    trajectory: Trajectory, residual: np.ndarray, freest: np.ndarray
) -> list[GenericShape]:
    """Return the strongest frequencies of a residual, as shapes picked from all of them.

    Waves that the motion may have too (two fifths of them follow from the `freest` model's
    regressors, or they lie within the band of the speed, or at a multiple of the cycle of a
    motion that repeats itself, or are images of such waves) are marked: they may as well depend on
    the motion.
    """
    rate = trajectory.row_rate
    start = trajectory.time.min()
    even = np.zeros(int(np.ptp(trajectory.time) * rate) + 2)
    index = np.rint((trajectory.time - start) * rate).astype(int)
    even[np.minimum(index, len(even) - 1)] = residual
    size = 4 * len(even)
    power = np.abs(np.fft.rfft(even, size))
    frequency = np.fft.rfftfreq(size, 1.0 / rate)
    inside = (frequency > 2.0 / max(np.ptp(trajectory.time), 1e-9)) & (frequency < trajectory.band)
    peaks, _ = signal.find_peaks(np.where(inside, power, 0.0), distance=6)
    strongest = peaks[np.argsort(-power[peaks])][:MAX_FREQUENCIES]
    looks = max(1, int(4 * np.ptp(trajectory.time) * trajectory.band))
    basis = freest / np.sqrt(len(freest))
    own, cycle = ABOVE_MOTION * _motion_band(trajectory), cycle_frequency(trajectory)
    shapes: list[GenericShape] = []
    for peak in strongest:
        phase = 2 * np.pi * frequency[peak] * (trajectory.time - start)
        pair = np.column_stack([np.cos(phase), np.sin(phase)])
        shared = frequency[peak] < own or _is_multiple(float(frequency[peak]), cycle, trajectory) \
            or bool(np.sum((basis.T @ pair) ** 2) >= OF_MOTION * np.sum(pair**2)) \
            or _is_image(pair, [s.columns for s in shapes if s.of_motion], residual)
        shapes.append(GenericShape(
            against="frequency", label="a wave in time", looks=looks, columns=pair,
            order=float(frequency[peak]), of_motion=shared, rank=RANK_OF_SHARED * shared))
    return shapes


def _is_image(pair: np.ndarray, others: list[np.ndarray], residual: np.ndarray) -> bool:
    """Return whether a wave is mostly what rows left out at regular times make of others."""
    if not others:
        return False
    columns = np.column_stack(others)
    found, *_ = np.linalg.lstsq(columns, residual, rcond=1e-9)
    with_them, without = (np.sum((pair.T @ values) ** 2)
                          for values in (residual, residual - columns @ found))
    return bool(without < IMAGE * with_them)


def _motion_band(trajectory: Trajectory) -> float:
    """Return the frequency below which 99 % of the power of the speed lies (Hz)."""
    longest = max(trajectory.segments, key=len)
    power = np.cumsum(np.abs(np.fft.rfft(longest.smooth_speed * np.hanning(len(longest)))) ** 2)
    place = int(np.searchsorted(power, 0.99 * power[-1]))
    return place / (len(longest) * longest.step)


def cycle_frequency(trajectory: Trajectory) -> float | None:
    """Return how often a motion repeats itself (Hz), None where it does not.

    By the autocorrelation of the speed; its peaks at whole numbers of cycles make it sharp.
    """
    longest = max(trajectory.segments, key=len)
    speed = longest.smooth_speed
    correlation = autocorrelation(speed, len(speed) * 2 // 3)
    correlation /= max(correlation[0], 1e-300) * (1.0 - np.arange(len(correlation)) / len(speed))
    peaks, _ = signal.find_peaks(correlation, height=REPEATS)
    away = np.nonzero(correlation < 0.5)[0]
    if not len(away):
        return None
    peaks = peaks[(peaks > away[0]) & (peaks <= len(speed) // 3)]
    if not len(peaks):
        return None
    lag = float(peaks[0])
    cycles = 1
    while 2 * cycles * lag < len(correlation) - 1:
        cycles *= 2
        reach = max(2, int(0.1 * lag))
        near = round(cycles * lag)
        window = correlation[near - reach:near + reach + 1]
        lag = (near - reach + int(np.argmax(window))) / cycles
    return float(1.0 / (lag * longest.step))


def _is_multiple(frequency: float, cycle: float | None, trajectory: Trajectory) -> bool:
    """Return whether a frequency is a multiple of a cycle, within half the resolution."""
    if cycle is None:
        return False
    off = abs(frequency / cycle - round(frequency / cycle)) * cycle
    return off < 0.5 / float(np.ptp(trajectory.time))


def freest_columns(known: np.ndarray, shapes: list[GenericShape]) -> np.ndarray:
    """Return the regressors of the freest model: all smooth shapes at once, well conditioned."""
    columns = np.concatenate([known, *(shape.columns for shape in shapes)], axis=1)
    scale = np.sqrt(np.mean(columns**2, axis=0))
    columns = columns[:, scale > 1e-9 * scale.max()]
    upper = np.linalg.qr(columns / np.sqrt(np.mean(columns**2, axis=0)))  # quicker than svd
    left, values, _ = np.linalg.svd(upper.R, full_matrices=False)
    return np.asarray(upper.Q @ left[:, values > 1e-6 * values[0]] * np.sqrt(len(columns)))
