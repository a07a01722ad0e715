"""What a bag says about itself: rosbag2's ``metadata.yaml`` and our own metadata records.

Our records are MCAP metadata: `START` is written before the first message, `END` after the
last one. Neither has a place for what was injected into the actuator.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import yaml

from ema_record.errors import InvalidRecordError, RigRecordError, UsageError
from ema_record.limits import MAX_TEXT
from ema_record.profile import Profile, load_profile_dict
from ema_record.record import UNKNOWN_SERIAL, Provenance, Status
from ema_record.wire.topics import Qos, Topic
from ema_record.wire.types import MESSAGE_ENCODING, type_hash

ROSBAG2_VERSION = 9
ROS_DISTRO = "jazzy"
ROSBAG2 = "rosbag2"
"""Name of rosbag2's own MCAP metadata record."""
START = "ema_phm.start"
END = "ema_phm.end"
RECOVERY = "ema_phm.recovery"
"""In a bag that 'ema recover' made: what was lost."""
RIG = "ema_phm.rig"
"""In a bag that 'ema import' made of a rig's file: the axis."""
CHECKSUM = "crc32"
"""Key of the checksum over the other values of our own records (a cut file has no other)."""

STATUSES: tuple[Status, ...] = get_args(Status)


def _infinite() -> dict[str, int]:
    """Return the longest duration of the middleware, which stands for "none"."""
    return {"sec": 9223372036, "nsec": 854775807}


def qos_dict(qos: Qos) -> dict[str, Any]:
    """Return one profile in the form and the order of ``metadata.yaml``."""
    return {
        "history": qos.history,
        "depth": qos.depth,
        "reliability": qos.reliability,
        "durability": qos.durability,
        "deadline": _infinite(),
        "lifespan": _infinite(),
        "liveliness": "automatic",
        "liveliness_lease_duration": _infinite(),
        "avoid_ros_namespace_conventions": False,
    }


def channel_metadata(topic: Topic) -> dict[str, str]:
    """Return the metadata of a topic's MCAP channel."""
    offered = yaml.safe_dump([qos_dict(topic.qos)], sort_keys=False).strip()
    return {"offered_qos_profiles": offered, "topic_type_hash": type_hash(topic.type)}


def topic_row(topic: Topic, count: int) -> dict[str, Any]:
    """Return a topic's entry in rosbag2's metadata, with its number of messages."""
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.type,
            "serialization_format": MESSAGE_ENCODING,
            "offered_qos_profiles": [qos_dict(topic.qos)],
            "type_description_hash": type_hash(topic.type),
        },
        "message_count": count,
    }


def bagfile_information(
    file_name: str, counts: Sequence[tuple[Topic, int]], first: int, last: int,
    custom_data: Mapping[str, str],
) -> dict[str, Any]:
    """Return the content of rosbag2's metadata, version 9, in its order, for one file.

    Parameters
    ----------
    file_name : in the directory of the bag.
    counts : topics in the order of the file, with their numbers of messages.
    first, last : earliest and latest log time (ns since the epoch).
    custom_data : what the bag says of itself.
    """
    message_count = sum(count for _, count in counts)
    return {
        "version": ROSBAG2_VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": last - first},
        "starting_time": {"nanoseconds_since_epoch": first},
        "message_count": message_count,
        "topics_with_message_count": [topic_row(topic, count) for topic, count in counts],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file_name],
        "files": [
            {
                "path": file_name,
                "starting_time": {"nanoseconds_since_epoch": first},
                "duration": {"nanoseconds": last - first},
                "message_count": message_count,
            }
        ],
        "custom_data": dict(custom_data) or None,
        "ros_distro": ROS_DISTRO,
    }


def metadata_yaml(information: Mapping[str, Any]) -> str:
    """Return the text of ``metadata.yaml``."""
    return _dump({"rosbag2_bagfile_information": dict(information)})


def rosbag2_record(information: Mapping[str, Any]) -> dict[str, str]:
    """Return the values of the MCAP metadata record `ROSBAG2`."""
    return {"serialized_metadata": _dump(dict(information)).strip()}


def _dump(data: object) -> str:
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=1000)


def start_record(profile: Profile, provenance: Provenance) -> dict[str, str]:
    """Return the values of the record `START`."""
    return _sealed({
        "serial_number": provenance.serial_number,
        "software_version": provenance.software_version,
        "start_time": str(provenance.start_time),
        "profile": profile.model_dump_json(),
        **({"actuator": provenance.actuator} if provenance.actuator else {}),
    })


def end_record(status: Status, start_time: int, counts: Mapping[str, int]) -> dict[str, str]:
    """Return the values of the record `END`; `counts` are messages by topic of the table."""
    return _sealed({
        "status": status,
        "start_time": str(start_time),
        "messages": json.dumps(dict(counts)),
    })


def _checksum(values: Mapping[str, str]) -> str:
    text = json.dumps({k: v for k, v in values.items() if k != CHECKSUM}, sort_keys=True)
    return f"{zlib.crc32(text.encode()):08x}"


def _sealed(values: dict[str, str]) -> dict[str, str]:
    """Return values with their checksum."""
    return {**values, CHECKSUM: _checksum(values)}


def is_intact(values: Mapping[str, str]) -> bool:
    """Return whether the checksum of one of our records is right, or absent."""
    return values.get(CHECKSUM) in (None, _checksum(values))


@dataclass(frozen=True, slots=True, kw_only=True)
class TestMetadata:
    """Our own metadata of a bag, as far as it has them."""

    __test__ = False

    profile: Profile | None
    provenance: Provenance
    counts: Mapping[str, int]
    """Messages by topic as the recorder counted them; empty where it did not."""


def read_test_metadata(records: Mapping[str, Mapping[str, str]], source: str) -> TestMetadata:
    """Return what the records `START` and `END` say; either may be missing.

    A bag with a start and no end was interrupted. A bag of another recorder has neither; it
    is taken to be complete, of an unknown actuator, its profile None.

    Raises
    ------
    InvalidRecordError
        A value is damaged or out of bounds, or the bag is a rig's.
    """
    if RIG in records:
        raise RigRecordError(
            f"{source}: holds the record of a rig, not the actuator's own test: 'ema identify' "
            "says what its model lacks"
        )
    start, end = records.get(START), records.get(END)
    for name, values in ((START, start), (END, end)):
        if values is not None and not is_intact(values):
            raise _wrong(source, CHECKSUM + " of " + name, values[CHECKSUM], _checksum(values))
    status: Status = "complete" if start is None else "interrupted"
    if end is not None:
        found = end.get("status", "")
        if found not in STATUSES:
            raise _wrong(source, "status", found, f"one of {', '.join(STATUSES)}")
        status = found
    start = start or {}
    text = (end or {}).get("start_time", start.get("start_time", "0"))
    if not (text.isascii() and text.isdigit() and len(text) <= 19 and int(text) < 1 << 63):
        raise _wrong(source, "start_time", text, "ns since the epoch")
    provenance = Provenance(
        serial_number=start.get("serial_number", UNKNOWN_SERIAL)[:MAX_TEXT],
        software_version=start.get("software_version", "unknown")[:MAX_TEXT],
        start_time=int(text),
        status=status,
        source=source,
        actuator=start.get("actuator", "")[:MAX_TEXT],
    )
    return TestMetadata(
        profile=_profile(start.get("profile"), source), provenance=provenance,
        counts=_counts((end or {}).get("messages"), source),
    )


def _counts(text: str | None, source: str) -> dict[str, int]:
    if text is None:
        return {}
    try:
        counts = json.loads(text)
    except (ValueError, RecursionError):
        counts = None
    if not isinstance(counts, dict) or not all(type(n) is int for n in counts.values()):
        raise _wrong(source, "messages", text, "JSON of numbers of messages")
    return counts


def _profile(text: str | None, source: str) -> Profile | None:
    if text is None:
        return None
    try:
        return load_profile_dict(json.loads(text), f"{source}: test profile")
    except UsageError as error:
        raise InvalidRecordError(str(error)) from None
    except (ValueError, RecursionError):
        raise _wrong(source, "profile", text, "JSON") from None


def _wrong(source: str, key: str, value: str, expected: str) -> InvalidRecordError:
    return InvalidRecordError(
        f"{source}: {key} in its metadata is {value[:60]!r}, expected {expected}: the bag was "
        "edited or damaged"
    )
