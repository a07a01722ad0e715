"""A first map of a file: what each column is by its name, its unit, and how the columns agree.

A message that lists joints is known by its definition (REP 103: rad, rad/s, N m). Elsewhere names
and units of the header are read, and a position in an unknown unit is tried against the speed.
What is a mere guess is said, and has to be confirmed.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ema_record.bag.any_topic import AnyTopic, is_bag, list_topics, messages_of
from ema_record.errors import UsageError, unknown_name
from ema_rig.column_names import OTHER, QUANTITIES, REFERENCE, ROLES, split_unit, words_of
from ema_rig.import_file import read_table
from ema_rig.map import TextFormat
from ema_rig.ros_bag import (
    DYNAMIC_JOINT_STATE,
    FIELDS,
    JOINTS,
    STAMP,
    decoded,
    decoder_of,
    joints_of,
    listed,
    numbers_in,
    of_joint,
)
from ema_rig.table import Table, TextColumn
from ema_rig.times import time_form
from ema_rig.units import SI_OF, UNITS, find_unit

LOOKED_AT = 200_000
"""Rows from which is guessed."""
AGREE = 0.05
"""Of the derivative of the position and the speed, relative."""


@dataclass(kw_only=True)
class Guess:
    """A map as data, and what of it is not known but supposed."""

    data: Any
    supposed: list[str] = field(default_factory=list)
    """One line each: key, value and why; these are to be confirmed."""
    remarks: list[str] = field(default_factory=list)
    """What was concluded from the data."""

    def text(self, source: str) -> str:
        """Return the map as YAML with what was supposed as comments above it."""
        head = [f"Guessed from {source}; check it, then: ema import {source} --map THIS --out BAG",
                *(f"supposed: {line}" for line in self.supposed), *self.remarks]
        return "".join(f"# {line}\n" for line in head) + yaml.safe_dump(
            self.data, sort_keys=False, allow_unicode=True, width=90)


def guess_map(
    path: Path, topic: str | None = None, joint: str | None = None,
    given: Mapping[str, str] | None = None,
) -> Guess:
    """Return a first map of a file or of a topic of a bag.

    `given` holds what is known of the map, by dotted keys: ``axis``, ``input.column``.

    Raises
    ------
    UsageError, InvalidRecordError
        As `import_file`; the topic or the joint has to be chosen, or no column looks like what
        drives the axis or how it moves: the error lists what there is.
    """
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", path.name.split(".")[0])[:64].strip("-") or "rig"
    if is_bag(path):
        return _of_bag(path, topic, joint, name, given or {})
    if topic is not None or joint is not None:
        raise UsageError(f"{path}: --topic and --joint are for bags of ROS 2: leave them out")
    form = {key.removeprefix("format."): value for key, value in (given or {}).items()
            if key.startswith("format.")}
    table = read_table(path, TextFormat.model_validate(form), None)
    return _of_table(table, name, None, given or {})


def _of_bag(
    path: Path, topic: str | None, joint: str | None, name: str, given: Mapping[str, str]
) -> Guess:
    topics = list_topics(path)
    if topic is None:
        found = [t.name for t in topics.values() if t.type in JOINTS and t.messages]
        if len(found) != 1:
            raise UsageError(f"{path}: give --topic, one of {listed(topics) or 'none'}")
        topic = found[0]
    if topic not in topics:
        raise unknown_name("topic", topic, topics, f"{path}: the bag has {listed(topics)}")
    chosen = topics[topic]
    if chosen.type in JOINTS:
        return _of_joint(path, chosen, joint, given)
    if joint is not None:
        raise UsageError(f"{path}: --joint {joint}: {topic} is {chosen.type}, which lists no "
                         "joints: leave it out")
    rows: dict[str, list[float]] = {}
    for message in _messages(path, chosen):
        for label, value in numbers_in(message).items():
            rows.setdefault(label, []).append(value)
    table = Table(columns={label: np.array(values) for label, values in rows.items()},
                  source=f"{path}: {topic}")
    return _of_table(table, name, {"topic": topic}, given)


def _messages(path: Path, topic: AnyTopic) -> Iterator[Any]:
    """Yield the messages of a topic that are looked at."""
    decode = decoder_of(topic, str(path))
    looked_at = itertools.islice(messages_of(path, frozenset({topic.name})), LOOKED_AT)
    for number, (_, _, data) in enumerate(looked_at, start=1):
        yield decoded(decode, data, topic, number, str(path))


def _of_joint(path: Path, topic: AnyTopic, joint: str | None, given: Mapping[str, str]) -> Guess:
    """Return the map of a joint; fields that the recorder left empty or NaN are left out."""
    messages = list(_messages(path, topic))
    joints = sorted({name for message in messages for name in joints_of(message)})
    if joint is None and len(joints) == 1:
        joint = joints[0]
    if joint is None or joint not in joints:
        shown = ", ".join(joints[:12]) + (" ..." if len(joints) > 12 else "")
        if joint is not None:
            raise unknown_name("joint", joint, joints, f"{path}: {topic.name} has {shown}")
        raise UsageError(f"{path}: {topic.name}: give --joint, one of {shown or 'none'}")
    fields: tuple[str, ...] = FIELDS
    if topic.type == DYNAMIC_JOINT_STATE:
        fields = tuple(dict.fromkeys(
            str(kind) for message in messages for place, name in enumerate(message.joint_names)
            if name == joint and place < len(message.interface_values)
            for kind in message.interface_values[place].interface_names))
    measured = {}
    for kind in fields:
        read = of_joint(joint, kind)
        values = [np.nan if (v := read(m)) is None else v for m in messages if joint in
                  joints_of(m)]
        if np.isfinite(values).mean() > 0.5:
            measured[kind] = np.array(values)
    missing = [kind for kind in FIELDS if kind not in measured]
    guess = Guess(data={})
    if missing:
        guess.remarks.append(f"{topic.name} has no {', '.join(missing)} of {joint}")
    for kind in measured:
        if np.ptp(measured[kind][np.isfinite(measured[kind])]) == 0.0:
            guess.remarks.append(f"{kind} of {joint} is constant")
    linear = given.get("axis") == "linear"
    length, speed, load = ("m", "m/s", "N") if linear else ("rad", "rad/s", "N m")
    drives = {"effort": load, "torque": load, "force": load, "current": "A",
              "motor_current": "A", "iq": "A", "voltage": "V"}
    drive = next((kind for kind in drives if kind in measured), None)
    entry = {"column": given.get("input.column", drive),
             "unit": given.get("input.unit", drives.get(drive or "", ""))}
    moves = {"position", "velocity"} & measured.keys() or {
        "position.column", "speed.column"} & given.keys()
    if not (entry["column"] and entry["unit"] and moves):
        raise UsageError(
            f"{path}: joint {joint!r} has {', '.join(measured) or 'no numbers'}: an effort (or "
            "current) and a position or velocity are needed: give the missing one from another "
            "topic, as --set input.column=/motor:current --set input.unit=A")
    guess.data = {
        "name": re.sub(r"[^A-Za-z0-9_.-]+", "-", joint)[:64],
        "axis": "linear" if linear else "rotary",
        "bag": {"topic": topic.name, "joint": joint}, "time": {"column": STAMP, "unit": "s"},
        "input": entry,
        **({"position": {"column": "position", "unit": length}} if "position" in measured else {}),
        **({"speed": {"column": "velocity", "unit": speed}} if "velocity" in measured else {}),
        "duplicates": "drop",
    }
    guess.remarks.append(
        f"a sliding joint in m, m/s and {entry['unit']}" if linear else
        f"a rotary joint in rad, rad/s and {entry['unit']} (for a sliding one: --set axis=linear)")
    return guess


def _of_table(
    table: Table, name: str, bag: dict[str, str] | None, given: Mapping[str, str]
) -> Guess:
    """Return the map of named columns."""
    units: dict[str, str | None] = {}
    ranked: dict[str, dict[str, tuple[float, str]]] = {"": {}}
    alike: dict[str, list[str]] = {}
    for label in table.columns:
        base, unit = split_unit(label, table.units.get(label))
        units[label] = unit
        words = words_of(base)
        if not words or set(words) & OTHER:
            continue
        for role, known in ROLES.items():
            if unit is not None and UNITS[unit][0] not in QUANTITIES[role]:
                continue
            rank = max((2.0 - k / len(known) for k, word in enumerate(known) if word in words),
                       default=0.0) + (0.5 if unit is not None else 0.0)
            real = "reference_" + role if set(words) & REFERENCE and role in (
                "position", "speed") else role
            best = ranked.setdefault(label.rpartition(".")[0], {})
            if rank < 1.0:
                continue
            if role == "input" and set(words) & REFERENCE:
                rank -= 1.0  # what was asked for is not what drove
            if rank == best.get(real, (0.0, ""))[0]:
                alike.setdefault(best[real][1], []).append(label)
            if rank > best.get(real, (-1.0, ""))[0]:
                best[real] = rank, label
    of_group = max(ranked.values(), key=lambda best: (len(best), sum(r for r, _ in best.values())))
    taken = {role: label for role, (_, label) in {**ranked[""], **of_group}.items()}
    for role in ROLES:
        if f"{role}.column" in given:
            taken[role] = given[f"{role}.column"]
        if role in taken and find_unit(given.get(f"{role}.unit", "")) is not None:
            units[taken[role]] = find_unit(given[f"{role}.unit"])
    guess = Guess(data={})
    guess.supposed += [f"{role}.column: {label}, not {', '.join(alike[label])}"
                       for role, label in taken.items()
                       if label in alike and f"{role}.column" not in given]
    if bag is not None:
        taken["time"] = STAMP
        units[STAMP] = "s"
    if "input" not in taken or not {"position", "speed"} & taken.keys():
        missing = "input" if "input" not in taken else "position or speed"
        shown = ", ".join(str(label)[:30] for label in list(table.columns)[:20])
        raise UsageError(
            f"{table.source}: no column looks like the {missing} by its name (it has {shown}): "
            f"give it by --set {'position' if missing != 'input' else missing}.column=NAME")
    measured = {UNITS[u][0] for label in taken.values() if (u := units.get(label)) is not None}
    axis = given.get("axis") or (
        "linear" if measured & {"length", "linear speed", "force"} else "rotary")
    guess.data = {"name": name, "axis": axis, **({} if bag is None else {"bag": bag})}
    guess.data["time"] = _time(table, taken.get("time"), units, guess)
    for role in ("input", "position", "speed", "reference_position", "reference_speed"):
        if role in taken:
            guess.data[role] = {"column": taken[role], "unit": given.get(
                f"{role}.unit", units.get(taken[role]))}
    seen = (units.get(taken[role]) for role in ("position", "speed", "input") if role in taken)
    if "axis" not in given and not any(seen):
        guess.supposed.append("axis: rotary")
    _fill_units(table, guess)
    return guess


def _time(table: Table, label: str | None, units: dict[str, str | None], guess: Guess) -> dict[
        str, Any]:
    """Return the entry of the time."""
    if label is None:
        guess.supposed.append("time.rate: no column looks like time; 1000 1/s is a mere example")
        return {"rate": 1000.0}
    values = table.columns.get(label)
    if isinstance(values, TextColumn):
        form = time_form(next(values.words())[1])
        if form is not None:
            return {"column": label, "unit": form}
    unit = units.get(label)
    if unit is None:
        numbers = table.column(label, "time")[:LOOKED_AT]
        step = float(np.median(np.abs(np.diff(numbers)))) if len(numbers) > 1 else 0.0
        unit = "s" if step < 0.5 else "ms" if step < 300.0 else "us" if step < 3e5 else "ns"
        guess.supposed.append(f"time.unit: {unit}, as its steps are {step:.3g}")
    return {"column": label, "unit": unit}


def _fill_units(table: Table, guess: Guess) -> None:
    """Fill units that the file does not give: by the other column of the motion, or SI."""
    data, axis = guess.data, 0 if guess.data["axis"] == "rotary" else 1
    position, speed = data.get("position"), data.get("speed")
    if position and speed and None in (position["unit"], speed["unit"]) and "bag" not in data:
        fits = _agreeing(table, guess, axis)
        if fits is not None:
            position["unit"], speed["unit"] = fits
            guess.remarks.append(f"position in {fits[0]} and speed in {fits[1]}: so the speed is "
                                 "the slope of the position")
    for role in ("position", "speed", "reference_position", "reference_speed"):
        entry = data.get(role)
        if entry is not None and entry["unit"] is None:
            same = data.get(role.removeprefix("reference_"), entry)["unit"]
            entry["unit"] = same or SI_OF[QUANTITIES[role.removeprefix("reference_")][axis]]
            guess.supposed.append(f"{role}.unit: {entry['unit']}")
    if data["input"]["unit"] is None:
        words = words_of(str(data["input"]["column"]))
        unit = "A" if set(words) & {"current", "i", "iq", "amps", "strom"} else "V" if set(
            words) & {"voltage", "volt", "u", "vir", "spannung"} else ("N m", "N")[axis]
        data["input"]["unit"] = unit
        guess.supposed.append(f"input.unit: {unit}")


def _agreeing(table: Table, guess: Guess, axis: int) -> tuple[str, str] | None:
    """Return the units of position and speed under which one is the slope of the other."""
    data = guess.data
    if "column" not in data["time"] or data["time"]["unit"] not in UNITS:
        return None
    t = table.column(data["time"]["column"], "time")[:LOOKED_AT] * UNITS[data["time"]["unit"]][1]
    x, v = (table.column(data[k]["column"], k)[:LOOKED_AT] for k in ("position", "speed"))
    if len(t) < 20 or not len(t) == len(x) == len(v):
        return None
    good = np.isfinite(t) & np.isfinite(x) & np.isfinite(v)
    t, x, v = t[good], x[good], v[good]
    way = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
    lag = max(1, len(t) // 200)
    dx, dw = x[lag:] - x[:-lag], way[lag:] - way[:-lag]
    if not len(dx) or not dx @ dx or not abs(dx @ dw) > 0.9 * np.sqrt((dx @ dx) * (dw @ dw)):
        return None
    ratio = float(dx @ dw / (dx @ dx))
    choices = (("rad", "deg", "rev"), ("rad/s", "rpm", "deg/s", "rev/s")) if axis == 0 else (
        ("m", "mm"), ("m/s", "mm/s", "m/min"))
    fits = [(p, s) for p in choices[0] for s in choices[1]
            if data["position"]["unit"] in (None, p) and data["speed"]["unit"] in (None, s)
            and abs(abs(ratio) * UNITS[s][1] / UNITS[p][1] - 1.0) < AGREE]
    if not fits:
        return None
    if ratio < 0.0:
        data["speed"]["scale"] = -1.0
        guess.remarks.append("the speed counts against the position: scale -1")
    if len(fits) > 1 and data["position"]["unit"] is None and data["speed"]["unit"] is None:
        guess.supposed.append(f"position.unit: {fits[0][0]} and speed.unit: {fits[0][1]}, or "
                              + ", or ".join(f"{p} and {s}" for p, s in fits[1:]))
    return fits[0]
