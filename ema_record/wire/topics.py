"""The topics of the graph: names, message types, offered quality of service.

One table for the nodes, the recorder and the files; nodes turn `Qos` into the profile of
their client library.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

SAMPLES = "/ema/samples"
JOINT_STATES = "/ema/joint_states"
PHASE_CURRENTS = "/ema/phase_currents"
DC_BUS = "/ema/dc_bus"
WINDING_TEMPERATURE = "/ema/winding_temperature"
COMMAND = "/ema/command"
WEIGHT_ON_WHEELS = "/aircraft/weight_on_wheels"
BIT_RECORD = "/ema/bit/record"
VERDICT = "/ema/verdict"
SEVERITY = "/ema/severity"
DIAGNOSTICS = "/diagnostics"

SELF_TEST_SERVICE = "/ema_monitor/self_test"

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
