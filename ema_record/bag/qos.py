"""Offered quality of service as rosbag2 (metadata version 9) writes it down."""

from __future__ import annotations

from typing import Any

import yaml

from ema_record.wire.topics import Qos


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


def offered_qos_profiles(qos: Qos) -> str:
    """Return the YAML text of the channel metadata ``offered_qos_profiles``."""
    return yaml.safe_dump([qos_dict(qos)], sort_keys=False).strip()
