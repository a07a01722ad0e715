"""The topics of the graph: names, message types, offered quality of service.

One table for the nodes, the recorder and the files; nodes turn `Qos` into the profile of
their client library. The names are those of a graph with one actuator. Where there are several
each has a namespace, and its topics stand under it; `AIRCRAFT_WIDE` ones stay as they are.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple

from ema_record.errors import UsageError

SAMPLES = "/ema/samples"
JOINT_STATES = "/ema/joint_states"
PHASE_CURRENTS = "/ema/phase_currents"
DC_BUS = "/ema/dc_bus"
WINDING_TEMPERATURE = "/ema/winding_temperature"
COMMAND = "/ema/command"
DEADMAN = "/ema/deadman"
WEIGHT_ON_WHEELS = "/aircraft/weight_on_wheels"
BIT_RECORD = "/ema/bit/record"
VERDICT = "/ema/verdict"
SEVERITY = "/ema/severity"
DIAGNOSTICS = "/diagnostics"

SELF_TEST_SERVICE = "/ema_monitor/self_test"

AIRCRAFT_WIDE = frozenset({WEIGHT_ON_WHEELS, DIAGNOSTICS})
"""Topics that all actuators of an aircraft share."""

JOINT_MOTOR = "motor"
JOINT_SURFACE = "surface"


@dataclass(frozen=True, slots=True, kw_only=True)
class Qos:
    """What a publisher offers."""

    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    history: Literal["keep_last", "keep_all"] = "keep_last"
    depth: int = 10
    """Messages kept; without meaning for ``keep_all``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """One row of the table."""

    name: str
    type: str
    """Message type, e.g. ``std_msgs/msg/Bool``."""
    qos: Qos = Qos()
    in_bag: bool = False
    """Whether a record holds this topic."""


_LATCHED = Qos(durability="transient_local", depth=1)

_TABLE = (
    Topic(
        name=SAMPLES, type="std_msgs/msg/Float64MultiArray",
        qos=Qos(history="keep_all", depth=0), in_bag=True,
    ),
    Topic(
        name=JOINT_STATES, type="sensor_msgs/msg/JointState", qos=Qos(depth=1000), in_bag=True,
    ),
    Topic(
        name=PHASE_CURRENTS, type="geometry_msgs/msg/Vector3Stamped", qos=Qos(depth=1000),
        in_bag=True,
    ),
    Topic(name=DC_BUS, type="sensor_msgs/msg/BatteryState", in_bag=True),
    Topic(name=WINDING_TEMPERATURE, type="sensor_msgs/msg/Temperature", in_bag=True),
    Topic(name=COMMAND, type="trajectory_msgs/msg/JointTrajectory", in_bag=True),
    Topic(name=DEADMAN, type="std_msgs/msg/Header"),
    Topic(name=WEIGHT_ON_WHEELS, type="std_msgs/msg/Bool", qos=_LATCHED, in_bag=True),
    Topic(name=BIT_RECORD, type="std_msgs/msg/String", qos=_LATCHED),
    Topic(name=VERDICT, type="diagnostic_msgs/msg/DiagnosticStatus", qos=_LATCHED),
    Topic(name=SEVERITY, type="std_msgs/msg/Float64", qos=_LATCHED),
    Topic(name=DIAGNOSTICS, type="diagnostic_msgs/msg/DiagnosticArray"),
)

TOPICS: dict[str, Topic] = {topic.name: topic for topic in _TABLE}
"""All topics by name."""

BAG_TOPICS: tuple[Topic, ...] = tuple(topic for topic in _TABLE if topic.in_bag)
"""The topics that a record holds."""

_NAME = re.compile(r"/?([A-Za-z]\w*)(/[A-Za-z]\w*)*", re.ASCII)
_LONGEST_NAME = 80


class GraphName(NamedTuple):
    """A topic as it is called on a graph."""

    namespace: str
    """Of the actuator, with its slash; empty: none."""
    topic: str
    """The name in the table."""


@lru_cache(maxsize=4096)
def split_name(name: str) -> GraphName:
    """Return namespace and topic of a name on a graph or in a bag.

    A name that is none of the table's, or is aircraft-wide, comes back as it is.
    """
    at = name.rfind("/ema/")
    known = at > 0 and name[at:] in TOPICS
    return GraphName(name[:at], name[at:]) if known else GraphName("", name)


def name_on_graph(topic: str, namespace: str) -> str:
    """Return the absolute name of a topic of the table under a namespace."""
    return topic if topic in AIRCRAFT_WIDE else namespace + topic


def relative_name(topic: str) -> str:
    """Return the name that a node in the namespace of its actuator uses for a topic."""
    return topic if topic in AIRCRAFT_WIDE else topic.removeprefix("/")


def checked_namespace(name: str) -> str:
    """Return the namespace of an actuator's name: ``left_aileron`` is ``/left_aileron``.

    Raises
    ------
    UsageError
        ROS has no such names.
    """
    if not name or name == "/":
        return ""
    if len(name) > _LONGEST_NAME or not _NAME.fullmatch(name) or "__" in name:
        raise UsageError(
            f"actuator {name[:60]!r}: not the name of a ROS namespace: give letters, digits and "
            "single underscores, a letter first, such as left_aileron"
        )
    return "/" + name.removeprefix("/")
