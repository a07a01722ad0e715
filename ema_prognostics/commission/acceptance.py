"""Acceptance records: tests of healthy units, from which a kit is made.

They are read and checked here: whole, of one test, of one type, enough of them; and what they
tell of the recorder is measured: noise, rate, rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ema_prognostics.features.consistency import scatter_at_rest
from ema_prognostics.features.extract import extract
from ema_prognostics.features.profile_kind import ProfileKind, profile_kind
from ema_prognostics.training.conditions import noise_range
from ema_prognostics.verdict.judge import forbidden
from ema_record.actuator import FORMERLY, Actuator
from ema_record.actuator_type import actuator_hash, is_of_another_actuator
from ema_record.bag.read import read_bag
from ema_record.channels import (
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
)
from ema_record.errors import RecordError, UsageError
from ema_record.record import Record, unit_names
from ema_record.spread import Conditions
from ema_sim.rebuild import present
from ema_sim.simulate import simulate

MIN_RECORDS, MIN_UNITS = 4, 2
"""Fewest acceptance records, and units: a spread needs two units, a mean two records of each."""
MOST_RECORDS = 1000
LEAST_SAMPLES = 16
"""Of the interval without current from which the noise is read."""
MIN_STEPS = 6
"""Fewest different values while the inverter is off from which the noise is read."""
NOISE_ERROR = 0.1
"""Relative error of a measured noise: few samples, steps of the converter."""
ROUNDED = 0.3
"""Share of different values of a channel below which it counts as rounded."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Acceptance:
    """Acceptance records of one type.

    Attributes
    ----------
    records : of the units.
    kind : of their test.
    units : ndarray of int, shape (n,). Number of the unit of each record.
    serials : serial number of each unit.
    """

    records: tuple[Record, ...]
    kind: ProfileKind
    units: np.ndarray
    serials: tuple[str, ...]

    def features(self, actuator: Actuator) -> tuple[list[str], np.ndarray]:
        """Return names and features of the records, shape (n, d)."""
        found = [extract(record, self.kind, actuator) for record in self.records]
        names = list(found[0])
        for record, row in zip(self.records, found):
            if set(row) != set(names):
                odd = min(set(row) ^ set(names))
                raise UsageError(f"{record.provenance.source}: other channels than the first "
                                 f"record ({odd}): give records of one recorder")
        return names, np.array([[row[n] for n in names] for row in found])


def read_acceptance(paths: Sequence[str | Path], actuator: Actuator) -> Acceptance:
    """Return the acceptance records of `paths`.

    Raises
    ------
    UsageError
        Too few, of two types or tests, or one that cannot be used; the file is named.
    """
    if not MIN_RECORDS <= len(paths) <= MOST_RECORDS:
        raise UsageError(f"{len(paths)} acceptance records, {MIN_RECORDS} to {MOST_RECORDS} are "
                         "needed: record more tests of healthy units")
    records, kinds = list[Record](), list[ProfileKind]()
    for path in paths:
        try:
            record = read_bag(path)
        except RecordError as error:
            raise UsageError(f"{path}: cannot serve as acceptance record: {error}") from None
        for earlier, before in zip(records, paths):
            if np.array_equal(earlier.samples, record.samples, equal_nan=True):
                raise UsageError(f"{path}: the record of {before} once more: each test counts, "
                                 "record another one")
        records.append(record)
        kinds.append(_kind(record, str(path), actuator))
    if len(set(kinds)) > 1:
        other = next(k for k, kind in enumerate(kinds) if kind != kinds[0])
        raise UsageError(f"{paths[other]} is of the test {kinds[other]}, {paths[0]} of "
                         f"{kinds[0]}: give records of one test")
    named = [(record.provenance.actuator, path) for record, path in zip(records, paths)
             if record.provenance.actuator]
    for name, path in named:
        if name != named[0][0]:
            raise UsageError(f"{path} is of actuator type {name}, {named[0][1]} of {named[0][0]}: "
                             "give records of one type")
    return _by_unit(records, kinds[0])


def _by_unit(records: Sequence[Record], kind: ProfileKind) -> Acceptance:
    keys = unit_names(records)
    order = list(dict.fromkeys(keys))
    if len(order) < MIN_UNITS:
        raise UsageError(f"all records are of unit {order[0]}, at least {MIN_UNITS} units are "
                         "needed: how units differ cannot be told from one")
    return Acceptance(records=tuple(records), kind=kind, serials=tuple(order),
                      units=np.array([order.index(key) for key in keys]))


def _kind(record: Record, path: str, actuator: Actuator) -> ProfileKind:
    kind = profile_kind(record.profile, actuator)
    if kind is None:
        raise UsageError(f"{path}: its test {record.profile.name!r} is not one of the kit's: "
                         "record the kit's profile extended or step")
    if is_of_another_actuator(named := record.provenance.actuator):
        raise UsageError(f"{path}: of another actuator, {named[:16]!r}, the description is of "
                         f"{actuator_hash()!r}: give the one that it was recorded with, or, if "
                         f"that was corrected since, add the line {FORMERLY}: ['{named[:16]}']")
    verdict = forbidden(record)
    if verdict is not None:
        raise UsageError(f"{path}: cannot serve as acceptance record: {verdict.reasons[0]}")
    return kind


def measured_recorder(
    actuator: Actuator, records: Sequence[Record], conditions: Conditions
) -> Actuator:
    """Return the actuator with rate, channels, noise and converters as the records show them.

    Noise is measured while the inverter is off, beside that of a simulated record, see
    `noise_level`; a channel whose values repeat its steps is rounded.
    """
    there = np.min([present(record) for record in records], axis=0)
    rate = float(np.median([record.rate for record in records]))
    columns = {"speed": slice(MOTOR_SPEED, MOTOR_SPEED + 1), "current": PHASE_CURRENTS,
               "position": slice(SURFACE_POSITION, SURFACE_POSITION + 1)}
    found = {name: [value for value in (_noise(record, place) for record in records)
                    if value is not None]
             for name, place in columns.items() if there[place].all()}
    tried = {name: float(np.median(values)) for name, values in found.items() if values}
    own = simulate(records[0].profile, rate=rate, actuator=actuator._replace(
        noise=actuator.noise._replace(**tried)))
    noise = {}
    for name, level in tried.items():  # how much of it is seen depends on drive and recorder
        if (seen := _noise(own, columns[name])) is not None:
            noise[name] = noise_level(getattr(actuator.noise, name),
                                      level / seen * np.array(found[name]), conditions)
    speeds = [record.samples[:, MOTOR_SPEED] for record in records]
    rounded = all(len(np.unique(speed)) < ROUNDED * len(speed) for speed in speeds)
    currents = range(PHASE_CURRENTS.start, PHASE_CURRENTS.stop)
    return actuator._replace(
        noise=actuator.noise._replace(**noise),
        acquisition=actuator.acquisition._replace(
            rate=rate, converters=int(rounded),
            phase_current_c=int(all(there[k] for k in currents)),
            reference_currents=int(there[REFERENCE_CURRENTS].all()),
            rotor_angle=int(there[ROTOR_ANGLE]), surface_position=int(there[SURFACE_POSITION]),
        ),
    )


def noise_level(described: float, measured: np.ndarray, conditions: Conditions) -> float:
    """Return the noise of a channel, of which tests have `noise_least` to `noise_most` times.

    The described one, where that allows all that was measured. Else such that the middle between
    the least and the most measured is in the middle of what may be, in the logarithm: of a few
    numbers drawn evenly between two ends the mid-range tells these best (Lloyd 1952); their
    median, of eight, would be off by a third.

    Parameters
    ----------
    described : as `Actuator.noise` has it.
    measured : ndarray, shape (n,). Of the records, as it would have it.
    conditions : what the noise of a test may be.
    """
    least, most = noise_range(conditions)
    low, high = float(measured.max()) / most, float(measured.min()) / least
    if low <= (1.0 + NOISE_ERROR) * described and described <= (1.0 + NOISE_ERROR) * high:
        return described
    return float(np.sqrt(low * high))


def _noise(record: Record, place: slice) -> float | None:
    """Return the noise of a channel while the inverter is off (rms), None if not measured.

    A channel that stands on few of its steps shows its rounding and not its noise.
    """
    values = record.samples[record.at_rest, place]
    if len(values) < LEAST_SAMPLES or len(np.unique(values[:, 0])) < MIN_STEPS:
        return None
    return float(scatter_at_rest(values).mean())
