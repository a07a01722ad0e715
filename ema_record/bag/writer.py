"""`BagWriter`: writes a rosbag2 directory message by message, as the live recorder does.

`RawBag`, which it builds on, knows nothing of the test. Order of a bag's life: directory, MCAP
file with the start record, messages in chunks, end record, MCAP footer, fsync, and last
``metadata.yaml`` by temporary file and rename. A bag without it is incomplete.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO

import mcap.writer

from ema_record.bag.container import METADATA_FILE, check_name
from ema_record.bag.metadata import (
    END,
    RECOVERY,
    ROSBAG2,
    START,
    STATUSES,
    bagfile_information,
    channel_metadata,
    end_record,
    metadata_yaml,
    rosbag2_record,
    start_record,
)
from ema_record.errors import OutputError, UsageError
from ema_record.files import cannot_write, make_new_directory, new_file, put_back
from ema_record.limits import MAX_MESSAGE_BYTES
from ema_record.profile import Profile
from ema_record.record import Provenance, Status
from ema_record.version import VERSION
from ema_record.wire.topics import BAG_TOPICS, Topic, name_on_graph
from ema_record.wire.types import MESSAGE_ENCODING, SCHEMA_ENCODING, definition

CHUNK_SIZE = 512 << 10
"""Size of a chunk before compression (bytes)."""
FLUSH_INTERVAL = 0.04
"""Time after which messages are handed to the operating system while recording (s)."""
FLUSH_BYTES = 64 << 10
"""The same for bytes, where a late process catches up: 41 ms of samples at 20 kHz."""
MCAP_PROFILE = "ros2"
LIBRARY = f"ema_phm {VERSION}; mcap-python {mcap.__version__}"


class RawBag:
    """A new bag of any topics and metadata records, open for writing; one thread at a time.

    Parameters
    ----------
    path : the directory to make; its name becomes the name of the MCAP file.
    records : MCAP metadata that stand before the first message: values by name.
    topics : the topics of the bag.
    namespace : of the actuator: the topics are written under it, and are given without it.
    flush_interval : longest time that a message waits for a chunk to fill (s): so much of the
        recording and the block in progress are lost where the process is killed. None: until the
        chunk is full; the bytes then do not depend on the clock.

    Raises
    ------
    OutputError
        `path` exists, or cannot be written; also from `write_raw`, `flush` and `finish`.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        records: Mapping[str, Mapping[str, str]],
        topics: Sequence[Topic],
        namespace: str = "",
        flush_interval: float | None = None,
    ) -> None:
        """Make the directory, and begin the file in it."""
        self.path = Path(path)
        self.closed = False
        self._flush_interval = flush_interval
        self._waiting_since: float | None = None
        self._waiting_bytes = 0
        self._topics = {t.name: replace(t, name=name_on_graph(t.name, namespace)) for t in topics}
        self._counts = dict.fromkeys(self._topics, 0)
        self._first, self._last = (1 << 63) - 1, 0
        check_name(self.path)
        make_new_directory(self.path)
        self.file = self.path / f"{self.path.resolve().name}_0.mcap"
        try:
            self._stream: IO[bytes] = self.file.open("xb")
            self._mcap = mcap.writer.Writer(
                self._stream, chunk_size=CHUNK_SIZE, enable_data_crcs=True
            )
            self._mcap.start(profile=MCAP_PROFILE, library=LIBRARY)
            for name, values in records.items():
                self._mcap.add_metadata(name, dict(values))
            self._channels = self._register()
        except OSError as error:
            raise cannot_write(self.file, error) from None

    def _register(self) -> dict[str, int]:
        """Register all topics, so that the first chunk describes them all."""
        schemas: dict[str, int] = {}
        channels = {}
        for name, topic in self._topics.items():
            if topic.type not in schemas:
                schemas[topic.type] = self._mcap.register_schema(
                    topic.type, SCHEMA_ENCODING, definition(topic.type).encode()
                )
            channels[name] = self._mcap.register_channel(
                topic.name,
                MESSAGE_ENCODING,
                schemas[topic.type],
                channel_metadata(topic),
            )
        return channels

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far, by topic."""
        return dict(self._counts)

    def write_raw(
        self, topic: str, data: bytes, log_time: int, publish_time: int | None = None
    ) -> None:
        """Write one serialised message.

        Parameters
        ----------
        topic : one of the topics of the bag.
        data : CDR with its encapsulation.
        log_time : reception (ns since the epoch).
        publish_time : at the source (ns since the epoch); without it `log_time`.
        """
        channel = self._channels.get(topic)
        if channel is None:
            raise UsageError(
                f"topic {topic!r} is not in the bag: it holds {', '.join(self._channels)}"
            )
        if self.closed:
            raise UsageError(f"{self.path}: the bag is closed; nothing can be added")
        if not 4 <= len(data) <= MAX_MESSAGE_BYTES:
            raise UsageError(
                f"{topic}: message of {len(data)} bytes, expected 4 to {MAX_MESSAGE_BYTES}"
            )
        publish_time = log_time if publish_time is None else publish_time
        if not (0 <= log_time < 1 << 63 and 0 <= publish_time < 1 << 63):
            raise UsageError(
                f"{topic}: times {log_time} and {publish_time} must be ns since the epoch, >= 0"
            )
        self._counts[topic] += 1
        self._first = min(self._first, log_time)
        self._last = max(self._last, log_time)
        try:
            self._mcap.add_message(
                channel, log_time, data, publish_time, sequence=self._counts[topic] & 0xFFFFFFFF
            )
        except OSError as error:
            raise self._failed(error) from None
        if self._flush_interval is not None:
            now = time.monotonic()
            if self._waiting_since is None:
                self._waiting_since = now
            self._waiting_bytes += len(data)
            if (
                now - self._waiting_since >= self._flush_interval
                or self._waiting_bytes >= FLUSH_BYTES
            ):
                self.flush()

    def flush(self) -> None:
        """End the chunk in progress and hand all bytes to the operating system.

        What was written before survives the death of this process; without it up to
        `CHUNK_SIZE` bytes of messages are lost.
        """
        self._waiting_since = None
        self._waiting_bytes = 0
        try:
            self._mcap.flush()
            put_back(self.file, self._stream.fileno())
        except OSError as error:
            raise self._failed(error) from None

    def finish(
        self, records: Mapping[str, Mapping[str, str]], custom_data: Mapping[str, str]
    ) -> Path:
        """Write the last metadata records and the file's end, and return the directory.

        Parameters
        ----------
        records : values by name, as at the beginning.
        custom_data : for ``metadata.yaml``.
        """
        self.closed = True
        information = bagfile_information(
            self.file.name, [(topic, self._counts[name]) for name, topic in self._topics.items()],
            min(self._first, self._last), self._last, custom_data,
        )
        try:
            for name, values in {**records, ROSBAG2: rosbag2_record(information)}.items():
                self._mcap.add_metadata(name, dict(values))
            self._mcap.finish()
            self._stream.flush()
            os.fsync(self._stream.fileno())
            self._stream.close()
        except OSError as error:
            raise self._failed(error) from None
        with new_file(self.path / METADATA_FILE) as temporary:
            temporary.write_text(metadata_yaml(information), encoding="utf-8")
        return self.path

    @contextlib.contextmanager
    def whole(self) -> Iterator[None]:
        """Write all of it here: whatever ends that early leaves no part of the bag behind."""
        try:
            yield
        except BaseException:
            self.closed = True
            with contextlib.suppress(OSError):  # what a full disk did not take
                self._stream.close()
            with contextlib.suppress(OSError):
                self.file.unlink(missing_ok=True)
                self.path.rmdir()
            raise

    def _failed(self, error: OSError) -> OutputError:
        """Return the error for a bag that cannot be continued, and give its file up."""
        self.closed = True
        with contextlib.suppress(OSError):  # the same failure again, from its buffer
            self._stream.close()
        return cannot_write(self.file, error)


class BagWriter(RawBag):
    """A new bag of a test, open for writing.

    As a context manager it closes the bag as ``interrupted`` unless `close` was called.

    Parameters
    ----------
    path : see `RawBag`.
    profile : the test that is recorded.
    provenance : serial number, software version, start time, namespace and hash of the actuator;
        its status and source are not used.
    flush_interval, topics
        See `RawBag`.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        profile: Profile,
        provenance: Provenance,
        flush_interval: float | None = FLUSH_INTERVAL,
        topics: Sequence[Topic] = BAG_TOPICS,
    ) -> None:
        """Make the directory, and begin the file in it with what is known of the test."""
        self.profile = profile
        self.provenance = provenance
        super().__init__(
            path, records={START: start_record(profile, provenance)}, topics=topics,
            namespace=provenance.namespace, flush_interval=flush_interval,
        )
        if flush_interval is not None:
            self.flush()

    def close(
        self,
        status: Status = "complete",
        *,
        start_time: int | None = None,
        recovery: Mapping[str, str] | None = None,
    ) -> Path:
        """Finish the bag and return the directory; a second call does nothing.

        Parameters
        ----------
        status : how the test ended: ``complete``, ``aborted`` or ``interrupted``.
        start_time : acceptance of the command (ns since the epoch), where it is known better than
            at the beginning.
        recovery : what was lost of the bag that this one was recovered from.
        """
        if self.closed:
            return self.path
        if status not in STATUSES:
            raise UsageError(f"status {status!r} is none of {', '.join(STATUSES)}")
        self.closed = True
        self.flush()
        begin = self.provenance.start_time if start_time is None else start_time
        records = {END: end_record(status, begin, self.counts)}
        if recovery is not None:
            records = {RECOVERY: dict(recovery), **records}
        return self.finish(records, {
            "serial_number": self.provenance.serial_number,
            "software_version": self.provenance.software_version,
            **({"actuator": self.provenance.actuator} if self.provenance.actuator else {}),
            **({"namespace": self.provenance.namespace} if self.provenance.namespace else {}),
            "test_profile": self.profile.name,
            "status": status,
            **({"recovered": "true"} if recovery is not None else {}),
        })

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        """Close the bag as interrupted unless it is closed."""
        self.close("interrupted")
