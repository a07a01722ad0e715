"""`recover_bag`: a readable bag from one that was cut or damaged; the original stays as it is.

The new bag is never ``complete``: its status is that of the original if the recorder still
wrote one that says so (``aborted``), else ``interrupted``.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ema_record.actuator import load_actuator
from ema_record.bag.mcap_stream import McapMessage
from ema_record.bag.metadata import END, START, is_intact, read_test_metadata
from ema_record.bag.salvage import Salvage, salvage_bag
from ema_record.bag.writer import BagWriter
from ema_record.channels import SURFACE_POSITION, TIME
from ema_record.errors import (
    IncompleteRecordError,
    InvalidRecordError,
    RecordError,
    UsageError,
)
from ema_record.files import exists
from ema_record.limits import MAX_DURATION, MAX_RATE
from ema_record.profile import Profile
from ema_record.record import LARGEST_STEP, Provenance, Status
from ema_record.wire.samples import decode_block
from ema_record.wire.topics import BAG_TOPICS, COMMAND, SAMPLES
from ema_record.wire.trajectory import decode_command, trajectory_points

_MAX_GAPS = 50


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Samples that are missing between two that are there."""

    time: float
    """Of the first one that is missing (s)."""
    samples: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Recovery:
    """What was recovered of a bag, and what was lost."""

    source: str
    bag: str
    """The new bag."""
    status: Status
    samples: int
    expected_samples: int
    """Of the whole test profile, at the rate of the samples."""
    end: float
    """Time of the last sample since the acceptance of the command (s); 0 without one."""
    missing_samples: int
    missing_ms: float
    gaps: tuple[Gap, ...]
    unread_bytes: int
    damages: tuple[str, ...]
    left_out: dict[str, int]
    """Messages that are not of the test's topics, or not decodable, by topic."""

    def to_dict(self) -> dict[str, object]:
        """Return the fields as plain types."""
        return asdict(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Parts:
    """What goes into the new bag."""

    messages: list[McapMessage]
    times: np.ndarray
    left_out: dict[str, int]
    profile: Profile
    provenance: Provenance
    notes: tuple[str, ...]


def recover_bag(source: str | Path, out: str | Path | None = None) -> Recovery:
    """Write what can be read of the bag `source` as a new bag.

    Parameters
    ----------
    source : path-like
        A bag directory without ``metadata.yaml``, cut or damaged, or an ``.mcap`` file.
    out : path-like, optional
        The directory to make; default: the name of the source with ``_recovered``.

    Raises
    ------
    UsageError
        The bag is whole.
    InvalidRecordError, IncompleteRecordError
        Nothing can be recovered.
    OutputError
        `out` exists, or cannot be written.

    """
    place = Path(source)
    target = Path(out) if out is not None else default_output(place)
    if target.exists():
        raise exists(target)
    found = salvage_bag(place)
    if found.whole and place.is_dir():
        raise UsageError(
            f"{source}: the bag is whole: there is nothing to recover; 'ema lint' looks for "
            "defects in what was recorded"
        )
    parts = _sorted_out(found, str(source))
    status: Status = "aborted" if parts.provenance.status == "aborted" else "interrupted"
    report = _report(str(source), target, status, parts, found)
    _write(parts, target, report)
    return report


def default_output(source: Path) -> Path:
    """Return where the recovered bag of `source` goes unless told."""
    place = source.resolve()
    name = place.name if place.is_dir() else place.name.split(".mcap")[0]
    return place.with_name(f"{name}_recovered")


def _sorted_out(found: Salvage, source: str) -> _Parts:
    """Keep the messages of the test's topics that can be decoded."""
    topics = {topic.name: topic.type for topic in BAG_TOPICS}
    left_out: Counter[str] = Counter()
    kept: list[McapMessage] = []
    times: list[np.ndarray] = []
    first: np.ndarray | None = None
    command: McapMessage | None = None
    for message in found.messages:
        topic = message.channel.topic
        kind = message.channel.schema_name
        if kind not in (topics.get(topic), (topics.get(topic) or "").replace("/msg/", "/")):
            left_out[topic] += 1
            continue
        if topic == SAMPLES:
            try:
                block = decode_block(message.data)
            except InvalidRecordError:
                left_out[topic] += 1
                continue
            times.append(block[:, TIME].copy())
            first = block[:1].copy() if first is None and len(block) else first
        elif topic == COMMAND and first is None:
            command = message
        kept.append(message)
    notes, start = _start_of(found)
    profile, provenance = _test_of(start, found, command, first, source)
    return _Parts(
        messages=kept, times=np.concatenate(times) if times else np.empty(0),
        left_out=dict(left_out), profile=profile, provenance=provenance, notes=notes,
    )


def _start_of(found: Salvage) -> tuple[tuple[str, ...], dict[str, dict[str, str]]]:
    """Return our own metadata records that are intact, and what is not."""
    own = {name: found.metadata[name] for name in (START, END) if name in found.metadata}
    intact = {name: values for name, values in own.items() if is_intact(values)}
    return tuple(f"metadata {name} damaged and not used" for name in own.keys() - intact), intact


def _test_of(
    own: dict[str, dict[str, str]],
    found: Salvage,
    command: McapMessage | None,
    first: np.ndarray | None,
    source: str,
) -> tuple[Profile, Provenance]:
    """Return profile and provenance; the command, which has a checksum, wins."""
    try:
        known = read_test_metadata(own, source)
    except RecordError:
        known = read_test_metadata({}, source)
    profile, provenance = known.profile, known.provenance
    if START not in own:
        provenance = replace(provenance, status="interrupted")
    if command is not None:
        start = 0.0 if first is None else float(first[0, SURFACE_POSITION])
        try:
            commanded = decode_command(command.data, start=start)
        except RecordError:
            commanded = None
        if commanded is not None and (
            profile is None or trajectory_points(commanded) != trajectory_points(profile)
        ):
            profile = commanded
        if not provenance.start_time:
            provenance = replace(provenance, start_time=command.log_time)
    if profile is None:
        reason = found.damages[0] if found.damages else "no test metadata"
        raise IncompleteRecordError(
            f"{source}: neither test metadata nor a message on {COMMAND} can be read ({reason}): "
            "the test profile is not known; record the test again"
        )
    return profile, provenance


def _report(source: str, bag: Path, status: Status, parts: _Parts, found: Salvage) -> Recovery:
    """Return what is there and what is missing, from the times of the samples."""
    times = parts.times[np.abs(parts.times) <= MAX_DURATION + 1.0]
    steps = np.diff(times)
    forward = steps[steps > 0.0]
    interval = (
        float(np.median(forward)) if len(forward) else 1.0 / load_actuator().acquisition.rate
    )
    interval = max(interval, 1.0 / MAX_RATE)
    edges = np.concatenate([[-0.5 * interval], times])
    jumps = np.diff(edges)
    places = np.flatnonzero(jumps > LARGEST_STEP * interval)
    gaps = tuple(
        Gap(time=float(edges[k] + interval), samples=round(float(jumps[k]) / interval) - 1)
        for k in places[:_MAX_GAPS].tolist()
    )
    expected = round(parts.profile.duration / interval)
    missing = max(0, expected - len(times))
    return Recovery(
        source=source, bag=str(bag), status=status, samples=len(times),
        expected_samples=expected, end=float(times.max()) if len(times) else 0.0,
        missing_samples=missing, missing_ms=1e3 * missing * interval, gaps=gaps,
        unread_bytes=found.unread, damages=(*found.damages, *parts.notes),
        left_out=parts.left_out,
    )


def _write(parts: _Parts, out: Path, report: Recovery) -> None:
    """Write the new bag; the name of the old one does not travel with it."""
    with BagWriter(
        out, profile=parts.profile, provenance=parts.provenance, flush_interval=None
    ) as writer:
        for message in parts.messages:
            writer.write_raw(
                message.channel.topic, bytes(message.data),
                min(message.log_time, (1 << 63) - 1), min(message.publish_time, (1 << 63) - 1),
            )
        writer.close(report.status, start_time=parts.provenance.start_time, recovery={
            "samples": str(report.samples),
            "missing_samples": str(report.missing_samples),
            "missing_ms": f"{report.missing_ms:.3f}",
            "unread_bytes": str(report.unread_bytes),
        })
