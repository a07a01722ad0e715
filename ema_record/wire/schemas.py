"""Definition texts and type hashes of messages, as a bag carries them."""

from __future__ import annotations

from functools import cache

from ema_record.wire.types import typestore

SCHEMA_ENCODING = "ros2msg"
MESSAGE_ENCODING = "cdr"


@cache
def definition(message_type: str) -> str:
    """Return the definition of a type, those of the types that it uses joined to it."""
    text, _ = typestore().generate_msgdef(message_type, ros_version=2)
    return text


@cache
def type_hash(message_type: str) -> str:
    """Return the RIHS01 hash of a type (REP 2011)."""
    return typestore().hash_rihs01(message_type)
