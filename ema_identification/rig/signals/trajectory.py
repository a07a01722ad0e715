"""`Trajectory`: measured motion and input on an even grid, and the filter that all share.

Every regressor is evaluated on the motion at the full rate, then filtered, decimated and
gated exactly like the measured input, so that both sides of the balance lose the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy import interpolate, signal

from ema_rig.record import Axis

REST_SHARE = 0.05
"""A row is left out where so much of its filter window is standstill ..."""
REST_SHARE_DECIMATED = 0.3
"""... and of the longer window of `scipy.signal.decimate`."""
STEADY = 0.98
"""Share of a filter window that goes one way, for its row to be away from a reversal."""
FILTER_ORDER = 4
ROWS_A_BAND = 2.5
"""Rows a second, in units of the band."""


@dataclass(frozen=True, kw_only=True)
class Segment:
    """A stretch without a gap, evenly sampled; all arrays have shape (n,), SI.

    Attributes
    ----------
    step : interval (s).
    time, input, position : ndarray. As recorded.
    speed, acceleration : ndarray. As measured or derived; for terms that are linear in them.
    smooth_speed : ndarray. Within the band, by a filter that does not overshoot; for terms that
        look at the sign or the size of the speed.
    disturbance : ndarray. Known force or torque from outside, zero where none was recorded.
    """

    step: float
    time: np.ndarray
    input: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    smooth_speed: np.ndarray
    acceleration: np.ndarray
    disturbance: np.ndarray
    prediction: np.ndarray = field(default_factory=lambda: np.empty(0))
    """What the terms so far predict of the input; empty until `Trajectory.predicted`."""

    @property
    def rate(self) -> float:
        """Samples a second (1/s)."""
        return 1.0 / self.step

    def __len__(self) -> int:
        return len(self.time)


Column = Callable[[Segment], np.ndarray]
"""A regressor at the full rate."""


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """What the regression sees of one or more records of the same axis."""

    axis: Axis
    segments: tuple[Segment, ...]
    band: float
    """Cut-off of the filter (Hz)."""
    standstill: float
    """Speeds below it count as standstill (m/s or rad/s)."""
    interval: float
    """Between samples as they were recorded (s)."""
    gate: float
    """Rows so near to a reversal are left out, in periods of the band."""
    decimation: int | None
    """Given: the filter of `scipy.signal.decimate` by this factor in place of our own."""
    has_disturbance: bool
    notes: tuple[str, ...]

    def smoothed(self, segment: Segment, values: np.ndarray) -> np.ndarray:
        """Return `values` within the band, without delay, at the full rate."""
        return low_pass(values, segment.rate, self.band)

    def later(self, lead: float) -> Trajectory:
        """Return the trajectory with its input later by `lead` (s); the rows are the same."""
        def of(segment: Segment) -> Segment:
            curve = interpolate.CubicSpline(segment.time, segment.input)
            time = np.clip(segment.time - lead, segment.time[0], segment.time[-1])
            return replace(segment, input=curve(time))

        return replace(self, segments=tuple(of(segment) for segment in self.segments))

    def _steps(self, segment: Segment) -> int:
        return self.decimation or max(1, int(segment.rate / (ROWS_A_BAND * self.band)))

    def _reduced(self, segment: Segment, values: np.ndarray) -> np.ndarray:
        if self.decimation is not None:
            return np.asarray(signal.decimate(values, self.decimation, axis=0, zero_phase=True))
        return self.smoothed(segment, values)[:: self._steps(segment)]

    def predicted(self, predictions: Sequence[np.ndarray]) -> Trajectory:
        """Return the same trajectory, its segments with a prediction of the input each."""
        segments = tuple(replace(segment, prediction=prediction)
                         for segment, prediction in zip(self.segments, predictions))
        other = replace(self, segments=segments)
        other.__dict__["_kept"] = self._kept  # the motion is the same
        return other

    @cached_property
    def _kept(self) -> tuple[np.ndarray, ...]:
        """Rows of each segment that are used, as booleans."""
        kept = []
        for segment in self.segments:
            resting = (np.abs(segment.smooth_speed) < self.standstill).astype(np.float64)
            if self.decimation is None:
                share = windowed(resting, segment.rate, self.band)[:: self._steps(segment)]
                rows = share < REST_SHARE
            else:
                rows = self._reduced(segment, resting) < REST_SHARE_DECIMATED
            rows &= self._reversal_near(segment)[:: self._steps(segment)][: len(rows)] == 0
            edge = int(np.ceil(0.5 / self.band / segment.step / self._steps(segment))) + 1
            rows[:edge] = False
            rows[len(rows) - edge:] = False
            kept.append(rows)
        return tuple(kept)

    def _reversal_near(self, segment: Segment) -> np.ndarray:
        """Return whether the direction changes within the gate of each sample, shape (n,)."""
        forward = segment.smooth_speed > 0.0
        changes = np.concatenate([[False], forward[1:] != forward[:-1]]).astype(np.int64)
        half = int(self.gate / self.band / segment.step)
        total = np.concatenate([[0], np.cumsum(changes)])
        index = np.arange(len(segment))
        high, low = np.minimum(index + half + 1, len(segment)), np.maximum(index - half, 0)
        return np.asarray((total[high] > total[low]) & (half > 0))

    @cached_property
    def steady(self) -> np.ndarray:
        """Whether the direction stays the same within the filter's window, shape (rows,)."""
        if self.decimation is not None:
            return np.ones(len(self.target), dtype=bool)
        return np.abs(self.pick(lambda segment: windowed(
            np.sign(segment.smooth_speed), segment.rate, self.band))) > STEADY

    def reduce(self, column: Column) -> np.ndarray:
        """Return regressors filtered, decimated and gated like the input.

        Shape (rows,), or (rows, k) where `column` gives k of them side by side.
        """
        return np.concatenate([
            self._reduced(segment, column(segment))[rows]
            for segment, rows in zip(self.segments, self._kept)
        ])

    def pick(self, column: Column) -> np.ndarray:
        """Return values at the rows, without the filter, shape (rows,); for plots and bins."""
        return np.concatenate([
            column(segment)[:: self._steps(segment)][: len(rows)][rows]
            for segment, rows in zip(self.segments, self._kept)
        ])

    @cached_property
    def target(self) -> np.ndarray:
        """Input at the rows, shape (rows,)."""
        return self.reduce(lambda segment: segment.input)

    @cached_property
    def time(self) -> np.ndarray:
        """Time at the rows, shape (rows,) (s)."""
        return self.pick(lambda segment: segment.time)

    @cached_property
    def position(self) -> np.ndarray:
        """Position at the rows, shape (rows,)."""
        return self.pick(lambda segment: segment.position)

    @cached_property
    def speed(self) -> np.ndarray:
        """Speed within the band at the rows, shape (rows,)."""
        return self.pick(lambda segment: segment.smooth_speed)

    @cached_property
    def acceleration(self) -> np.ndarray:
        """Acceleration within the band at the rows, shape (rows,)."""
        return self.pick(lambda segment: self.smoothed(segment, segment.acceleration))

    @cached_property
    def segment_of_row(self) -> np.ndarray:
        """Index of the segment of each row, shape (rows,)."""
        return np.repeat(np.arange(len(self.segments)), [int(k.sum()) for k in self._kept])

    @property
    def row_rate(self) -> float:
        """Rows a second (1/s)."""
        first = self.segments[0]
        return first.rate / self._steps(first)

    @property
    def rest(self) -> float:
        """Share of the time at standstill, which is left out."""
        total = sum(len(segment) for segment in self.segments)
        resting = sum(
            int((np.abs(segment.smooth_speed) < self.standstill).sum())
            for segment in self.segments
        )
        return resting / total

    @property
    def travel(self) -> tuple[float, float]:
        """Smallest and largest position (m or rad)."""
        return (min(float(s.position.min()) for s in self.segments),
                max(float(s.position.max()) for s in self.segments))

    @property
    def turns(self) -> float:
        """Travel between the extreme positions, in turns of a rotary axis or in m."""
        low, high = self.travel
        return (high - low) / (2 * np.pi if self.axis.motion == "rotary" else 1.0)


def low_pass(values: np.ndarray, rate: float, band: float) -> np.ndarray:
    """Return `values` filtered forward and backward by a Butterworth low-pass.

    Parameters
    ----------
    values : ndarray, shape (n,) or (n, k). Evenly sampled along the first axis.
    rate, band : samples a second (1/s), cut-off (Hz).
    """
    if band >= 0.45 * rate:
        return values
    length = min(len(values) - 1, int(3 * rate / band))
    return np.asarray(
        signal.sosfiltfilt(_sections(2.0 * band / rate), values, axis=0, padlen=length))


@lru_cache(maxsize=64)
def _sections(cutoff: float) -> np.ndarray:
    """Return the second-order sections for a cut-off in units of half the rate."""
    return np.asarray(signal.butter(FILTER_ORDER, cutoff, output="sos"))


def monotone_low_pass(values: np.ndarray, rate: float, band: float) -> np.ndarray:
    """Return `values` within the band by a Gaussian filter, which rings at no stop.

    Parameters
    ----------
    values : ndarray, shape (n,). Evenly sampled.
    rate, band : samples a second (1/s); where it passes a half, like `low_pass` (Hz).
    """
    if band >= 0.45 * rate:
        return values
    wide = rate * np.sqrt(2.0 * np.log(2.0)) / (2.0 * np.pi * band)
    reach = min(int(np.ceil(4.0 * wide)), len(values) - 1)
    bell = np.exp(-0.5 * (np.arange(-reach, reach + 1) / wide) ** 2)
    padded = np.pad(values, reach, mode="reflect", reflect_type="odd")
    return np.asarray(signal.oaconvolve(padded, bell / bell.sum(), mode="valid"))


def windowed(values: np.ndarray, rate: float, band: float) -> np.ndarray:
    """Return the mean of `values` weighted by the size of `low_pass`'s response, shape (n,)."""
    if band >= 0.45 * rate:
        return values
    half = min(int(2.0 * rate / band), len(values) - 1)
    impulse = np.zeros(8 * half + 1)
    impulse[4 * half] = 1.0
    window = np.abs(low_pass(impulse, rate, band))[3 * half:5 * half + 1]
    padded = np.pad(values, half, mode="edge")
    return np.asarray(signal.oaconvolve(padded, window / window.sum(), mode="valid"))


_STENCIL = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0


def derivative(values: np.ndarray, step: float) -> np.ndarray:
    """Return the derivative by central differences of sixth order, shape (n,).

    An error of 4e-4 at a tenth of the rate, where two-point differences lose 6 %.
    """
    if len(values) < 7:
        return np.gradient(values, step)
    inner = np.convolve(values, _STENCIL[::-1], mode="same") / step
    ends = np.gradient(values, step)
    inner[:3], inner[-3:] = ends[:3], ends[-3:]
    return inner
