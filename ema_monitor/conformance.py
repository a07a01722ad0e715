"""What a driver is held to: docs/driver.md line by line, from what was heard of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from ema_record.actuator import Actuator
from ema_record.channels import CHANNELS, TIME, recorded_columns, what_lacks
from ema_record.wire.topics import (
    COMMAND,
    DC_BUS,
    DEADMAN,
    SAMPLES,
    TOPICS,
    WEIGHT_ON_WHEELS,
    WINDING_TEMPERATURE,
)
from ema_record.wire.types import NANOSECONDS

Outcome = Literal["ok", "absent", "untested", "WRONG"]
STATUS_PERIOD = 1.2
"""Longest silence of the status (s): one a second, and some jitter."""
STOP_LIMIT = 1.0
"""Longest time from an open interlock to a status that says idle (s)."""
CLOCKS = 1.0
"""By how much two clocks may differ (s)."""
PUBLISHED = {
    DC_BUS: "the bus voltage is then no known condition",
    WINDING_TEMPERATURE: "20 degC is then assumed",
}
"""Topics that a driver may leave out, and what that costs."""
FOLLOWED = {
    COMMAND: "", WEIGHT_ON_WHEELS: "", DEADMAN: "the surface goes on when who commands it dies",
}
"""Topics that it follows; those that it may leave out, and what that costs."""


class Line(NamedTuple):
    """One line of the report."""

    item: str
    outcome: Outcome
    text: str


class Endpoint(NamedTuple):
    """A publisher or subscription of a node."""

    node: str
    type: str
    reliable: bool


@dataclass
class DriverRun:
    """What followed one command."""

    stamp: int = 0
    """Of the command (ns since the epoch)."""
    sent: int = 0
    """When it was sent (ns since the epoch)."""
    duration: float = 0.0
    """Of what was commanded (s)."""
    blocks: list[np.ndarray] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    """Blocks that cannot be read."""
    statuses: list[Mapping[str, str]] = field(default_factory=list)
    opened: float | None = None
    """Clock when the interlock was opened (s)."""
    idle: float | None = None
    """Clock at the first idle status after that (s)."""


@dataclass
class Heard:
    """All that was heard of a driver."""

    namespace: str
    publishers: dict[str, list[Endpoint]] = field(default_factory=dict)
    subscribers: dict[str, list[Endpoint]] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    """Of statuses that might be the driver's."""
    hardware_id: str = ""
    values: Mapping[str, str] = field(default_factory=dict)
    problem: str = "no status of that name"
    """What the last status lacks; empty: nothing."""
    gaps: list[float] = field(default_factory=list)
    """Between statuses while nothing was commanded (s)."""
    skew: float = 0.0
    """Of the stamp of the last status to this host's clock (s)."""
    bus: tuple[float, float] | None = None
    """Voltage (V) and current as sent (A)."""
    held: DriverRun | None = None
    refused: DriverRun | None = None
    stopped: DriverRun | None = None


def report(heard: Heard, actuator: Actuator) -> list[Line]:
    """Return the report, line by line, in the order of docs/driver.md."""
    lines = [*_topics(heard), *_status(heard)]
    if heard.bus is not None:
        voltage, current = heard.bus
        drawn = "no current" if np.isnan(current) else f"{current:.4g} A"
        good = np.isfinite(voltage) and voltage > 0.0 and not current > 0.0
        lines.append(Line("dc_bus values", "ok" if good else "WRONG",
                          f"{voltage:.4g} V, {drawn}; voltage is positive, current negative "
                          "while the drive takes it, NaN where it is not measured"))
    if heard.held is None:
        return [*lines, Line("command", "untested", "no status to command by")]
    lines += _run(heard.held, actuator)
    lines += _interlock(heard)
    return lines


def _topics(heard: Heard) -> Iterator[Line]:
    """Publishers and subscriptions: how many, type, reliability."""
    for topic in (SAMPLES, *PUBLISHED):
        yield _endpoint(topic, "publishes", heard.publishers.get(topic, []), PUBLISHED.get(topic))
    for topic, cost in FOLLOWED.items():
        yield _endpoint(topic, "follows", heard.subscribers.get(topic, []), cost or None)


def _endpoint(topic: str, verb: str, found: Sequence[Endpoint], cost: str | None) -> Line:
    item, wanted = f"{verb} {topic.removeprefix('/')}", TOPICS[topic].type
    if not found:
        return Line(item, "WRONG" if cost is None else "absent",
                    "no node does" if cost is None else f"no node does: {cost}")
    if len(found) > 1:
        names = ", ".join(endpoint.node for endpoint in found)
        return Line(item, "WRONG", f"{len(found)} nodes do ({names}), expected one")
    (endpoint,) = found
    if endpoint.type != wanted:
        return Line(item, "WRONG", f"type {endpoint.type}, expected {wanted}")
    if not endpoint.reliable and topic == SAMPLES:
        return Line(item, "WRONG", "best effort: samples would be lost; offer reliable")
    return Line(item, "ok", f"{endpoint.node}, {wanted}")


def _status(heard: Heard) -> Iterator[Line]:
    """The status on `/diagnostics`."""
    namespace = heard.namespace
    wanted = f"{namespace}/<node>: actuator" if namespace else "<node>: actuator"
    if heard.problem:
        others = f"; heard: {', '.join(sorted(set(heard.names))[:4])}" if heard.names else ""
        yield Line("status", "WRONG", f"{heard.problem}, expected '{wanted}' on /diagnostics "
                   f"with its five keys{others}")
        return
    yield Line("status", "ok", ", ".join(f"{k}={v}" for k, v in sorted(heard.values.items())))
    longest = max(heard.gaps, default=float("inf"))
    yield Line("status rate", "ok" if longest <= STATUS_PERIOD else "WRONG",
               f"at most {longest:.2f} s apart, expected {STATUS_PERIOD:g} s or less")
    yield Line("serial number", "ok" if heard.hardware_id else "WRONG",
               heard.hardware_id or "hardware_id is empty: the record would name no actuator")
    yield Line("stamp", "ok" if abs(heard.skew) <= CLOCKS else "WRONG",
               f"{heard.skew:+.3f} s from this host's clock, expected {CLOCKS:g} s at most")


def _run(run: DriverRun, actuator: Actuator) -> Iterator[Line]:
    """The command to stay where it is: accepted, sampled, counted, ended."""
    mine = [v for v in run.statuses if v["command_stamp"] == str(run.stamp)]
    if not mine:
        said = run.statuses[-1].get("message", "") if run.statuses else ""
        yield Line("command accepted", "WRONG", "no status with the stamp of the command"
                   + (f"; it says: {said}" if said else ""))
        return
    yield Line("command accepted", "ok", "its stamp is in the status")
    active = any(v["state"] != "idle" for v in mine)
    yield Line("state while it runs", "ok" if active else "WRONG",
               "not idle" if active else "never other than idle")
    late = (int(mine[0]["start_time"]) - run.sent) / NANOSECONDS
    yield Line("start_time", "ok" if -0.01 <= late <= CLOCKS + 0.5 else "WRONG",
               f"{late:+.3f} s after the command was sent")
    if run.errors:
        yield Line("samples", "WRONG", run.errors[0])
        return
    if not run.blocks:
        yield Line("samples", "WRONG", "none came")
        return
    yield from _samples(np.concatenate(run.blocks), run, actuator)
    count, last = sum(map(len, run.blocks)), mine[-1]
    ended = last["state"] == "idle"
    yield Line("end", "ok" if ended else "WRONG",
               "idle after the last sample" if ended else "still not idle")
    said = last["samples_published"]
    yield Line("samples_published", "ok" if said == str(count) else "WRONG",
               f"{said}, and {count} arrived")


def _samples(samples: np.ndarray, run: DriverRun, actuator: Actuator) -> Iterator[Line]:
    columns, rate = recorded_columns(samples), actuator.acquisition.rate
    lacks = what_lacks(columns)
    infinite = [CHANNELS[c].name for c in columns if not np.isfinite(samples[:, c]).all()]
    if infinite:
        lacks = f"number in {', '.join(infinite)} at some samples"
    yield Line("channels", "WRONG" if lacks else "ok",
               f"no {lacks}" if lacks else f"{len(columns)} of {samples.shape[1]}")
    time = samples[:, TIME]
    steps = np.diff(time)
    rising = bool(len(steps)) and bool((steps > 0.0).all())
    yield Line("time order", "ok" if rising else "WRONG",
               "increases" if rising else "does not increase strictly")
    if not rising:
        return
    interval = float(np.median(steps))
    off = abs(interval * rate - 1.0)
    yield Line("rate", "ok" if off <= 0.01 else "WRONG",
               f"{1.0 / interval:.6g} a second, the kit says {rate:g}")
    covers = time[0] <= 2.0 / rate and time[-1] >= run.duration - 2.0 / rate
    yield Line("time of samples", "ok" if covers else "WRONG",
               f"{time[0]:.6f} to {time[-1]:.6f} s, expected from acceptance to "
               f"{run.duration:g} s")
    gaps = int((steps > 1.5 * interval).sum())
    yield Line("gaps", "WRONG" if gaps else "ok", f"{gaps}")


def _interlock(heard: Heard) -> Iterator[Line]:
    if heard.refused is None or heard.stopped is None:
        why = "another node publishes weight on wheels, or the driver obeys nothing"
        yield Line("obeys on the wheels alone", "untested", why)
        yield Line("stops off the wheels", "untested", why)
        return
    obeyed = any(v["command_stamp"] == str(heard.refused.stamp) for v in heard.refused.statuses)
    yield Line("obeys on the wheels alone", "WRONG" if obeyed else "ok",
               "it obeyed without weight on wheels" if obeyed else
               "a command without weight on wheels was refused")
    run = heard.stopped
    if run.opened is None or run.idle is None:
        yield Line("stops off the wheels", "WRONG", "it goes on without weight on wheels")
        return
    took = run.idle - run.opened
    yield Line("stops off the wheels", "ok" if took <= STOP_LIMIT else "WRONG",
               f"idle {took:.2f} s after weight on wheels ended, expected {STOP_LIMIT:g} s")
