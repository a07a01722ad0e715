"""Records of a rig become a `Trajectory`; what cannot be used is refused, with its remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import signal

from ema_identification.rig.fit.model import Settings
from ema_identification.rig.fit.sign_flips import LEVEL_OF_CHANCE
from ema_identification.rig.fit.visible import what_shows
from ema_identification.rig.signals.agree import ROOM, agreeing_band
from ema_identification.rig.signals.clocks import earlier, response_band, speed_lag, speed_noise
from ema_identification.rig.signals.plausible import GAP, RUN, check_columns, check_input
from ema_identification.rig.signals.recorder import cleaned
from ema_identification.rig.signals.sensor_range import check_range
from ema_identification.rig.signals.trajectory import (
    Segment,
    Trajectory,
    derivative,
    low_pass,
    monotone_low_pass,
)
from ema_identification.rig.signals.two_sides import between_the_sides
from ema_record.errors import (
    IncompleteRecordError,
    InvalidRecordError,
    RecordError,
    UsageError,
    counted,
)
from ema_rig.record import DISTURBANCE, OUTPUT_POSITION, POSITION, SPEED, RigRecord

MIN_SAMPLES = 200


def too_short(record: RigRecord, why: str) -> IncompleteRecordError:
    """Return the error for a record that is too short."""
    return IncompleteRecordError(
        f"{record.source}: too short to identify ({why}): record several cycles of the motion in "
        "both directions"
    )


def no_motion(record: RigRecord, rms: float, standstill: float) -> InvalidRecordError:
    """Return the error for a record in which nothing moves."""
    unit = record.axis.speed_unit
    return InvalidRecordError(
        f"{record.source}: no excitation: speed {rms:.3g} {unit} rms, standstill is below "
        f"{standstill:.3g} {unit}: {RUN}"
    )


def check_record(record: RigRecord) -> None:
    """Refuse records that are too short, or whose input or output does not change.

    Raises
    ------
    IncompleteRecordError, InvalidRecordError
        The channel is named, with the remedy.
    """
    if len(record) < MIN_SAMPLES:
        raise too_short(record, f"{len(record)} samples, at least {MIN_SAMPLES}")
    for channel in record.channels[1:]:
        if channel.name not in (record.axis.input_channel.name, POSITION, SPEED):
            continue
        values = record.channel(channel.name)
        if np.ptp(values) == 0.0:
            raise InvalidRecordError(
                f"{record.source}: {channel.name} is {values[0]:.4g} {channel.unit} throughout: "
                "name another column in the map, or record a run in which it changes"
            )


NOISE_RMS = 3.0
"""Speeds below so many times the noise of the speed count as standstill."""
SMALLEST = 1e-3
"""Likewise below this share of the rms speed."""
MAX_SAMPLES = 400_000
"""Most samples of all segments, after thinning."""
MIN_SEGMENT = 64
CLEAR = 0.25
"""Standard deviations."""
ROWS_A_CYCLE = 20.0
"""Samples a cycle of the highest frequency that is looked at."""
MISSING = 2.5
"""Intervals, of the 99th percentile, from which samples are missing."""


def prepare(records: Sequence[RigRecord], settings: Settings) -> Trajectory:
    """Return the trajectory of records of one axis.

    Parameters
    ----------
    records : of the same axis: equal motion and input.
    settings : of the model file; what is not set is derived from the records.

    Raises
    ------
    UsageError, InvalidRecordError
        Different axes; too short; nothing moves; wrong units; constant channels.
    """
    if not records:
        raise UsageError("no record: give at least one rig bag")
    trajectory = _trajectory(records, settings)
    for record in records:
        own = trajectory if len(records) == 1 else _alone(record, trajectory)
        if own is not None:
            check_input(record, own, lambda record: _alone(record, trajectory))
    return trajectory


def _alone(record: RigRecord, trajectory: Trajectory) -> Trajectory | None:
    """Return the trajectory of one record under the same filter, None where there is none."""
    try:
        return _trajectory([record], Settings(band=trajectory.band, gate=trajectory.gate))
    except RecordError:
        return None


def _trajectory(records: Sequence[RigRecord], settings: Settings) -> Trajectory:
    """Return the trajectory of records of one axis, their inputs not looked at."""
    first = records[0]
    for record in records:
        if (record.axis.motion, record.axis.input) != (first.axis.motion, first.axis.input):
            raise UsageError(
                f"{record.source}: a {record.axis.motion} axis with {record.axis.input} input, "
                f"but {first.source} has a {first.axis.motion} one with {first.axis.input}: "
                "identify records of one axis together"
            )
        for channel in (POSITION, SPEED):
            if record.has(channel) != first.has(channel):
                raise UsageError(
                    f"{record.source} has {'a' if record.has(channel) else 'no'} {channel} and "
                    f"{first.source} has {'one' if first.has(channel) else 'none'}: identify "
                    "records with the same channels together")
        check_record(record)
    notes: list[str] = []
    records = [cleaned(record, notes) for record in records]
    raw = [piece for record in records for piece in even_pieces(record, notes)]
    if not raw:
        raise too_short(first, "no stretch without a gap holds 64 samples")
    for record in records:
        check_columns(record)
        if record.has(POSITION):
            check_range(record, LEVEL_OF_CHANCE)
    is_position = not first.has(SPEED)
    longest = max(raw, key=lambda piece: len(piece["time"]))
    band = response_band(longest[POSITION if is_position else SPEED], float(longest["rate"]),
                         is_position=is_position)
    told = max(_told(records), ROOM * band.motion)
    if settings.band is None and told < band.edge:
        notes.append(f"band taken at {told:.3g} Hz: many samples are missing")
    edge = settings.band or min(band.edge, told)
    if first.has(SPEED) and first.has(POSITION):
        _one_clock(raw, edge, band.motion, notes)
    if settings.band is None and settings.decimate is None:
        edge = agreeing_band(raw, edge, band.motion, notes)
    quiet = speed_noise(replace(band, edge=edge), is_position=is_position)
    if first.has(POSITION) and first.has(OUTPUT_POSITION):
        notes.append(between_the_sides([p for p in raw if OUTPUT_POSITION in p], edge,
                                       first.axis.position_unit))
    segments = tuple(_segment(piece, edge, settings) for piece in raw)
    if sum(len(segment) for segment in segments) > MAX_SAMPLES:
        raise UsageError(
            f"{first.source}: {sum(len(s) for s in segments)} samples at {segments[0].rate:.4g} "
            f"1/s after thinning, at most {MAX_SAMPLES}: set settings.band in the model file "
            "lower, or import a part with 'start' and 'end'"
        )
    rms = float(np.sqrt(np.mean(np.concatenate([s.smooth_speed for s in segments]) ** 2)))
    standstill = settings.standstill or max(NOISE_RMS * quiet, SMALLEST * rms)
    if rms < 2.0 * standstill and settings.standstill is None:
        raise no_motion(first, rms, standstill)
    if is_position:
        notes.append("speed derived from position")
    elif not first.has(POSITION):
        notes.append("position integrated from speed: its zero is not known")
    trajectory = Trajectory(
        axis=first.axis, segments=segments, band=edge, standstill=standstill,
        decimation=settings.decimate, gate=settings.gate, interval=1.0 / first.rate,
        has_disturbance=any(record.has(DISTURBANCE) for record in records), notes=tuple(notes),
    )
    cycles = sum(_alternations(segment.smooth_speed) for segment in segments) / 2
    if len(trajectory.target) < 60 or (cycles < 1.0 and not _shows_the_axis(trajectory)):
        if trajectory.rest > 0.8:
            raise no_motion(first, rms, standstill)
        raise too_short(first, f"{len(trajectory.target)} rows of the band and {cycles:.2g} "
                               "cycles of the speed, at least 60 and 1")
    return trajectory


def _shows_the_axis(trajectory: Trajectory) -> bool:
    """Return whether inertia and viscous friction stand apart, though no cycle is whole."""
    own = {p.name: p for p in what_shows(trajectory).parameters}
    return own["inertia"].shown and own["viscous_friction"].shown


def _one_clock(
    pieces: Sequence[dict[str, np.ndarray]], band: float, motion: float, notes: list[str]
) -> None:
    """Take out of the speeds what they lag behind the positions."""
    lag = speed_lag(pieces, band, motion)
    if lag == 0.0:
        return
    for piece in pieces:
        piece[SPEED] = earlier(piece[SPEED], piece["time"], lag)
    notes.append(f"speed taken {1e3 * lag:.3g} ms earlier, where it is the slope of the position "
                 "(a drive filters its speed)")


def _alternations(speed: np.ndarray) -> int:
    """Return how often a speed changes between clearly above and clearly below its mean."""
    score = (speed - speed.mean()) / max(float(speed.std()), 1e-300)
    clear = score[np.abs(score) > CLEAR] > 0.0
    return int(np.count_nonzero(clear[1:] != clear[:-1]))


def _told(records: Sequence[RigRecord]) -> float:
    """Return the band that the samples tell where many are missing, else infinity (Hz).

    Straight lines between samples far apart bend as a load on a spring would make them.
    """
    found = []
    for record in records:
        steps = np.diff(record.time) * record.rate
        longest = float(np.quantile(steps[steps <= GAP], 0.99))
        found.append(record.rate / (ROWS_A_CYCLE * longest) if longest > MISSING else np.inf)
    return min(found)


def even_pieces(record: RigRecord, notes: list[str]) -> list[dict[str, np.ndarray]]:
    """Return the stretches between gaps on an even grid, as columns by name, with ``rate``."""
    time = record.time
    step = 1.0 / record.rate
    steps = np.diff(time)
    cuts = np.nonzero(steps > GAP * step)[0] + 1
    uneven = float(np.quantile(np.abs(steps / step - 1.0), 0.99))
    if uneven > 0.01:
        notes.append(f"{record.source}: uneven sampling (1 % of the intervals off by more than "
                     f"{100 * uneven:.0f} %), interpolated to {record.rate:.5g} 1/s")
    pieces: list[dict[str, np.ndarray]] = []
    lost = 0
    for rows in np.split(np.arange(len(time)), cuts):
        if len(rows) < MIN_SEGMENT:
            lost += len(rows)
            continue
        grid = time[rows[0]] + step * np.arange(
            int((time[rows[-1]] - time[rows[0]]) / step + 1e-6) + 1)
        piece = {channel.name: np.interp(grid, time[rows], record.samples[rows, k])
                 for k, channel in enumerate(record.channels)}
        piece["time"] = grid
        piece["input"] = piece.pop(record.axis.input_channel.name)
        piece["rate"] = np.array(1.0 / step)
        pieces.append(piece)
    if len(cuts):
        notes.append(f"{record.source}: {counted(len(cuts), 'gap')} of more than {GAP:g} "
                     f"intervals: {len(pieces)} stretches, {lost} samples left out")
    return pieces


def _segment(piece: dict[str, np.ndarray], band: float, settings: Settings) -> Segment:
    """Return the motion of one stretch, thinned where the band leaves room."""
    rate = float(piece["rate"])
    factor = int(rate / (ROWS_A_CYCLE * band)) if settings.decimate is None else 1
    columns = {name: values for name, values in piece.items() if name != "rate"}
    if factor > 1:
        columns = {name: _thinned(values, factor) for name, values in columns.items()}
        rate /= factor
    step = 1.0 / rate
    position, speed = columns.get(POSITION), columns.get(SPEED)
    if settings.cutoff is not None:
        position = None if position is None else low_pass(position, rate, settings.cutoff)
        speed = None if speed is None else low_pass(speed, rate, settings.cutoff)
    if speed is None:
        assert position is not None  # the record has one of both
        speed = derivative(position, step)
    if position is None:
        position = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) * 0.5 * step)])
    return Segment(
        step=step, time=columns["time"], input=columns["input"], position=position, speed=speed,
        smooth_speed=monotone_low_pass(speed, rate, band), acceleration=derivative(speed, step),
        disturbance=columns.get(DISTURBANCE, np.zeros(len(speed))),
    )


def _thinned(values: np.ndarray, factor: int) -> np.ndarray:
    """Return every `factor`-th value after a linear-phase filter without delay."""
    taps = signal.firwin(20 * factor + 1, 1.0 / factor)
    padded = np.pad(values, 10 * factor, mode="reflect", reflect_type="odd")
    filtered: np.ndarray = signal.oaconvolve(padded, taps, mode="valid")
    return filtered[::factor]
