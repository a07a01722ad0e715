"""`recover_bag`: a readable bag from one that was cut or damaged; the original stays as it is.

The new bag is never ``complete``: its status is that of the original if the recorder still
wrote one that says so (``aborted``), else ``interrupted``. Chunks are the unit: one whose
checksum does not match is left out, reading goes on after it; of one that the end cuts, the
messages before the cut are kept.
"""

from __future__ import annotations

import io
import re
from collections import Counter
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from ema_record.actuator import load_actuator
from ema_record.bag import container
from ema_record.bag.compression import unpack_zstd_part
from ema_record.bag.container import MCAP_SUFFIXES, METADATA_FILE, find_files, refuse_links
from ema_record.bag.mcap_stream import McapMessage, McapMetadata, McapStream
from ema_record.bag.metadata import END, START, is_intact, read_test_metadata
from ema_record.bag.writer import BagWriter
from ema_record.channels import SURFACE_POSITION, TIME
from ema_record.errors import IncompleteRecordError, InvalidRecordError, RecordError, UsageError
from ema_record.limits import (
    MAX_DURATION,
    MAX_FILES,
    MAX_MESSAGE_BYTES,
    MAX_MESSAGES,
    MAX_RATE,
    MAX_TOTAL_BYTES,
    MAX_UNPACKED_FILE_BYTES,
)
from ema_record.profile import Profile
from ema_record.record import LARGEST_STEP, Provenance, Status
from ema_record.wire.samples import decode_block
from ema_record.wire.topics import AIRCRAFT_WIDE, BAG_TOPICS, COMMAND, SAMPLES, split_name
from ema_record.wire.trajectory import decode_command, trajectory_points

_MAX_GAPS, _MAX_DAMAGES = 50, 20
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


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


def recover_bag(source: str | Path, out: str | Path | None = None) -> Recovery:
    """Write what can be read of the bag `source` as a new bag.

    Parameters
    ----------
    source : bag directory without ``metadata.yaml``, cut or damaged, or an ``.mcap`` file.
    out : directory to make; default: the name of the source with ``_recovered``.

    Raises
    ------
    UsageError
        The bag is whole.
    InvalidRecordError, IncompleteRecordError
        Nothing can be recovered: no bag, no sample, or the test is not known.
    OutputError
        `out` exists, or cannot be written.
    """
    place = Path(source)
    target = Path(out) if out is not None else default_output(place)
    container.check_place(target, place)
    container.check_name(target)
    found = _salvage(place)
    if found.whole:
        raise UsageError(f"{source}: the bag is whole, there is nothing to recover: 'ema check' "
                         "says what to do with it")
    parts = _sorted_out(found, str(source))
    if not len(parts.times):
        raise _nothing(str(source), "no sample", found)
    if np.diff(parts.times).min(initial=0.0) < -0.5 * parts.profile.duration:
        raise InvalidRecordError(f"{source}: several tests, time begins anew: recover each alone")
    status: Status = "aborted" if parts.provenance.status == "aborted" else "interrupted"
    report = _report(str(source), target, status, parts, found)
    _write(parts, target, report)
    return report


def default_output(source: Path) -> Path:
    """Return where the recovered bag of `source` goes unless told."""
    place = source.absolute() if source.is_symlink() else source.resolve()
    return place.with_name(f"{place.name.split('.mcap')[0]}_recovered")


def _sorted_out(found: Salvage, source: str) -> _Parts:
    """Keep the messages of the test's topics that can be decoded."""
    topics = {topic.name: topic.type for topic in BAG_TOPICS}
    left_out: Counter[str] = Counter()
    kept, times = list[McapMessage](), list[np.ndarray]()
    first: np.ndarray | None = None
    command: McapMessage | None = None
    namespace: str | None = None
    for message in found.messages:
        of, topic = split_name(message.channel.topic)
        if topic in topics.keys() - AIRCRAFT_WIDE:
            namespace = of if namespace is None else namespace
            topic = topic if of == namespace else message.channel.topic  # of another one
        kind = container.full_type(message.channel.schema_name)
        if kind != topics.get(topic) or len(message.data) < 4:  # the writer takes no shorter ones
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
    profile, provenance = _test_of(_intact(found), found, command, first, source)
    return _Parts(
        messages=kept, times=np.concatenate(times) if times else np.empty(0),
        left_out=dict(left_out), profile=profile,
        provenance=replace(provenance, namespace=namespace or ""),
    )


def _intact(found: Salvage) -> dict[str, dict[str, str]]:
    """Return our own metadata records that are intact, and note what is not."""
    own = {name: found.metadata[name] for name in (START, END) if name in found.metadata}
    intact = {name: values for name, values in own.items() if is_intact(values)}
    found.damages += [f"metadata {k} damaged and not used" for k in own if k not in intact]
    return intact


def _test_of(
    own: dict[str, dict[str, str]], found: Salvage, command: McapMessage | None,
    first: np.ndarray | None, source: str,
) -> tuple[Profile, Provenance]:
    """Return profile and provenance; the command, which has a checksum, wins."""
    try:
        known = read_test_metadata(own, source)
    except RecordError:
        known = read_test_metadata({}, source)
    profile, provenance = known.profile, known.provenance
    if command is not None:
        at = np.nan if first is None else float(first[0, SURFACE_POSITION])
        start = at if np.isfinite(at) else None
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
        raise _nothing(source, f"neither test metadata nor a message on {COMMAND}", found)
    return profile, provenance


def _nothing(source: str, what: str, found: Salvage) -> IncompleteRecordError:
    """Return the error for a bag of which too little is left."""
    why = (*found.damages, "never recorded")[0]
    return IncompleteRecordError(f"{source}: {what} can be read ({why}): record the test again")


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
        unread_bytes=found.unread, damages=tuple(found.damages),
        left_out=parts.left_out,
    )


def _write(parts: _Parts, out: Path, report: Recovery) -> None:
    """Write the new bag; the name of the old one does not travel with it."""
    with BagWriter(
        out, profile=parts.profile, provenance=parts.provenance, flush_interval=None
    ) as writer, writer.whole():
        for message in parts.messages:
            writer.write_raw(
                split_name(message.channel.topic).topic, bytes(message.data),
                min(message.log_time, (1 << 63) - 1), min(message.publish_time, (1 << 63) - 1),
            )
        writer.close(report.status, start_time=parts.provenance.start_time, recovery={
            "samples": str(report.samples),
            "missing_samples": str(report.missing_samples),
            "missing_ms": f"{report.missing_ms:.3f}",
            "unread_bytes": str(report.unread_bytes),
        })


@dataclass
class Salvage:
    """What was read of one bag, in the order of its files."""

    messages: list[McapMessage] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    """Values of each metadata record by its name."""
    damages: list[str] = field(default_factory=list)
    """What could not be read, one line each."""
    unread: int = 0
    """Bytes of the files that could not be read."""
    room: int = MAX_TOTAL_BYTES
    """Bytes that messages may still have."""
    whole: bool = True
    """Nothing was cut or damaged, and ``metadata.yaml`` is there."""

    def damaged(self, what: str, unread: int = 0) -> None:
        """Note something that could not be read."""
        self.whole = False
        self.unread += unread
        if len(self.damages) < _MAX_DAMAGES:
            self.damages.append(what)


def _salvage(path: Path) -> Salvage:
    """Read what is left of a bag directory or of an ``.mcap`` file; nothing is changed."""
    found, first = Salvage(), None
    for file in _files(path, found):
        try:
            _salvage_file(file, found)
        except RecordError as error:  # empty, or no MCAP file: the others count
            first = first or error
            found.damaged(str(error), file.stat().st_size)
        except OSError as error:
            raise container.unreadable(file, error) from None
        except MemoryError:
            found.damaged(f"{file}: not enough memory to unpack it", file.stat().st_size)
    if found.messages or found.metadata:
        return found
    raise first or IncompleteRecordError(
        f"{path}: cut before anything was recorded: record the test again")


def _files(path: Path, found: Salvage) -> list[Path]:
    """Return the MCAP files at `path`, numbered ones in the order of their numbers."""
    if path.is_file():
        return [path]
    files = ([p for p in path.iterdir() if p.name.endswith(MCAP_SUFFIXES) and p.is_file()]
             if path.is_dir() else [])
    try:
        find_files(path)
    except RecordError as error:
        if not files:
            raise
        found.damaged(str(error) if (path / METADATA_FILE).is_file() else
                      f"no {METADATA_FILE}: the recorder did not finish")
    if len(files) > MAX_FILES:
        raise InvalidRecordError(f"{path}: {len(files)} .mcap files, at most {MAX_FILES}: one bag")
    refuse_links(path, files)
    return sorted(files, key=lambda file: (int(match[1]) if (match := re.search(
        r"_(\d{1,9})\.mcap", file.name)) else -1, file.name))


def _salvage_file(file: Path, found: Salvage) -> None:
    """Add what can be read of one file to `found`."""
    with file.open("rb") as stream:
        if file.name.endswith(".zstd"):
            data = unpack_zstd_part(stream.read(MAX_UNPACKED_FILE_BYTES), MAX_UNPACKED_FILE_BYTES)
            mcap = McapStream(io.BytesIO(data), len(data), str(file), on_damage=found.damaged)
        else:
            mcap = McapStream(stream, file.stat().st_size, str(file), on_damage=found.damaged)
        for item in mcap:
            if isinstance(item, McapMetadata):
                found.metadata[item.name] = item.values
            elif len(found.messages) < MAX_MESSAGES and found.room > 0:
                found.messages.append(_unpacked_message(item, found.room))
                found.room -= len(found.messages[-1].data)
            else:
                found.damaged(f"{file}: more than {MAX_MESSAGES} messages or "
                              f"{MAX_TOTAL_BYTES} bytes of them")
                return


def _unpacked_message(message: McapMessage, room: int) -> McapMessage:
    """Return a message, unpacked where its recorder compressed each message by itself."""
    data = bytes(message.data)
    if not data.startswith(_ZSTD_MAGIC):
        return message
    return message._replace(data=memoryview(unpack_zstd_part(data, min(MAX_MESSAGE_BYTES, room))))
