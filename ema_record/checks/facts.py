"""What the rules look at: the messages of a bag in the order of the file, and its samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ema_record.bag.container import BagContent, read_content
from ema_record.bag.metadata import RECOVERY, START, TestMetadata, read_test_metadata
from ema_record.channels import (
    MOTOR_SPEED,
    N_CHANNELS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    TIME,
)
from ema_record.errors import InvalidRecordError, RecordError
from ema_record.limits import MAX_SAMPLES
from ema_record.profile import Profile
from ema_record.record import Record
from ema_record.wire.samples import decode_block
from ema_record.wire.sensors import BATTERY_STATE, TEMPERATURE
from ema_record.wire.topics import COMMAND, DC_BUS, SAMPLES, WEIGHT_ON_WHEELS, WINDING_TEMPERATURE
from ema_record.wire.trajectory import decode_command
from ema_record.wire.types import deserialize

T = TypeVar("T")
READ_TOPICS = frozenset({SAMPLES, COMMAND, DC_BUS, WINDING_TEMPERATURE, WEIGHT_ON_WHEELS})


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """One message of samples."""

    log_time: int
    """Reception (ns since the epoch)."""
    samples: np.ndarray
    """Shape (k, 10)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Differences from sample to sample where time goes on by one interval, moving or not.

    Attributes
    ----------
    time : ndarray, shape (m,)
        Of the later sample (s).
    turned : ndarray, shape (m,)
        Motor speed times interval (rad).
    angle : ndarray, shape (m,)
        Change of the rotor angle, -pi to pi (rad).
    travel : ndarray, shape (m,)
        Change of the surface position (rad).

    """

    time: np.ndarray
    turned: np.ndarray
    angle: np.ndarray
    travel: np.ndarray


@dataclass(frozen=True)
class BagFacts:
    """A bag as recorded; the samples may be in any order and of any value."""

    source: str
    content: BagContent
    blocks: list[Block]
    test: TestMetadata
    has_start: bool
    command: Profile | None
    """Read off `/ema/command`."""
    bus_voltage: np.ndarray
    """Shape (m,) (V)."""
    winding_temperature: np.ndarray
    """Shape (m,) (degC)."""
    weight_on_wheels: list[bool]
    errors: list[str]
    """Messages that cannot be decoded, one line each."""
    _derived: dict[object, Any] = field(default_factory=dict, repr=False)

    def derived(self, make: Callable[[BagFacts], T]) -> T:
        """Return what `make` makes of these facts, made once for all rules."""
        if make not in self._derived:
            self._derived[make] = make(self)
        found: T = self._derived[make]
        return found

    @property
    def recovered(self) -> dict[str, str] | None:
        """Return what 'ema recover' noted in the bag."""
        return self.content.metadata.get(RECOVERY)

    @property
    def profile(self) -> Profile | None:
        """Return the test profile as the bag says."""
        return self.test.profile or self.command

    @cached_property
    def samples(self) -> np.ndarray:
        """Finite samples in order of time, each time once, shape (n, 10), column by column."""
        if not self.blocks:
            return np.empty((0, N_CHANNELS))
        samples = np.concatenate([block.samples for block in self.blocks])
        finite = np.isfinite(samples).all(axis=1)
        if not (finite.all() and (np.diff(samples[:, TIME]) > 0.0).all()):
            samples = samples[finite]
            _, first = np.unique(samples[:, TIME], return_index=True)
            samples = samples[first]
        return np.asfortranarray(samples)

    @cached_property
    def unusable(self) -> np.ndarray:
        """Times of the samples that are not finite, shape (k,) (s), in order.

        A sample without a time has that of the last one before it.
        """
        if not self.blocks:
            return np.empty(0)
        samples = np.concatenate([block.samples for block in self.blocks])
        finite = np.isfinite(samples)
        bad = ~finite.all(axis=1)
        timed = np.maximum.accumulate(np.where(finite[:, TIME], np.arange(len(samples)), 0))
        return np.sort(samples[timed, TIME][bad])

    @cached_property
    def interval(self) -> float:
        """Median interval of the samples (s); NaN below 2 samples."""
        time = self.samples[:, TIME]
        return float(np.median(np.diff(time))) if len(time) > 1 else float("nan")

    @cached_property
    def angle_in_degrees(self) -> bool:
        """Return whether the rotor angle goes beyond a turn in radians."""
        angle = self.samples[:, ROTOR_ANGLE]
        return bool(len(angle)) and float(np.abs(angle).max()) > 2.0 * np.pi + 0.5

    @cached_property
    def motion(self) -> Motion:
        """Return what moved from sample to sample."""
        s = self.samples
        step = np.diff(s[:, TIME])
        regular = np.abs(step - self.interval) < 0.1 * self.interval
        speed = 0.5 * (s[1:, MOTOR_SPEED] + s[:-1, MOTOR_SPEED])
        angle = s[:, ROTOR_ANGLE] * (np.pi / 180.0 if self.angle_in_degrees else 1.0)
        turned = np.mod(np.diff(angle) + np.pi, 2.0 * np.pi) - np.pi
        return Motion(
            time=s[1:, TIME][regular], turned=(speed * step)[regular], angle=turned[regular],
            travel=np.diff(s[:, SURFACE_POSITION])[regular],
        )


def facts_of_record(record: Record) -> BagFacts:
    """Return a record for those rules that need no bag."""
    return BagFacts(
        source=record.provenance.source, content=BagContent(),
        blocks=[Block(log_time=0, samples=record.samples)] if len(record) else [],
        test=TestMetadata(profile=record.profile, provenance=record.provenance, counts={}),
        has_start=True, command=None, bus_voltage=record.dc_bus[:, 1],
        winding_temperature=record.winding_temperature[:, 1], weight_on_wheels=[], errors=[],
    )


def gather_facts(path: str | Path) -> BagFacts:
    """Read a bag for the rules.

    Raises
    ------
    InvalidRecordError, IncompleteRecordError
        It cannot be read at all: no bag, cut, or damaged.

    """
    source = str(path)
    content = read_content(Path(path), READ_TOPICS, file_order=True)
    test = read_test_metadata(content.metadata, source)
    errors: list[str] = []
    blocks: list[Block] = []
    count = 0
    for message in content.messages.get(SAMPLES, []):
        try:
            samples = decode_block(message.data)
        except InvalidRecordError as error:
            errors.append(str(error))
            continue
        count += len(samples)
        if count > MAX_SAMPLES:
            raise InvalidRecordError(f"{source}: more than {MAX_SAMPLES} samples: split the bag")
        if len(samples):
            blocks.append(Block(log_time=message.log_time, samples=samples))
    return BagFacts(
        source=source, content=content, blocks=blocks, test=test,
        has_start=START in content.metadata, command=_command(content, blocks, errors),
        bus_voltage=_slow(content, DC_BUS, BATTERY_STATE, "voltage", errors),
        winding_temperature=_slow(
            content, WINDING_TEMPERATURE, TEMPERATURE, "temperature", errors
        ),
        weight_on_wheels=[
            bytes(m.data[4:5]) != b"\x00" for m in content.messages.get(WEIGHT_ON_WHEELS, [])
        ],
        errors=errors,
    )


def _command(content: BagContent, blocks: list[Block], errors: list[str]) -> Profile | None:
    """Return the profile of the last command before the samples."""
    commands = content.messages.get(COMMAND, [])
    if not commands or not blocks:
        return None
    before = [m for m in commands if m.log_time <= blocks[0].log_time]
    first = blocks[0].samples[0]
    try:
        return decode_command(
            (before or commands[:1])[-1].data, start=float(first[SURFACE_POSITION]),
            duration=float(blocks[-1].samples[-1, TIME]),
        )
    except RecordError as error:
        errors.append(str(error))
        return None


def _slow(
    content: BagContent, topic: str, kind: str, field: str, errors: list[str]
) -> np.ndarray:
    values = []
    for message in content.messages.get(topic, []):
        try:
            decoded = deserialize(message.data, kind, topic)
        except RecordError as error:
            errors.append(str(error))
            continue
        values.append(float(getattr(decoded, field)))
    return np.array(values, dtype=np.float64)
