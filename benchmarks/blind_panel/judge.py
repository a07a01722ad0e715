"""One answer against the truth: what is right, wrong, or does not count."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks.blind_panel.truth.bags import truth_of
from benchmarks.blind_panel.truth.cases import Case
from benchmarks.blind_panel.truth.foreign import FOREIGN
from benchmarks.blind_panel.truth.visible import THRESHOLD
from ema_sim.effects import EFFECTS

LARGEST_SET = 3
SHOWS = 1.5
BALANCES = {
    "winding": "electrical", "supply": "electrical", "commutation": "electrical",
    "motor torque": "mechanical", "friction": "mechanical", "load": "mechanical",
    "transmission": "mechanical", "sensor": "sensor", "controller": "controller",
}
"""The port's balance: the lenient reading of "right port"."""
Visible = Mapping[str, tuple[float, str]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """One unit. None: the question does not arise."""

    id: str
    group: str
    names: tuple[str, ...]
    size: str
    visible: bool
    gap: float
    """Of the least visible hidden effect, in noise floors of the truth program."""
    right: bool | None = None
    """Named, or in a set of at most three, and nothing else named."""
    wrong: bool | None = None
    """Some finding that holds no hidden effect."""
    named: bool = False
    """Any finding."""
    unknown_port: bool | None = None
    unknown_balance: bool | None = None
    both: bool | None = None
    closed: float | None = None
    covered: tuple[bool, ...] = ()
    set_size: int = 0
    """Of the finding that holds the truth."""
    resolved: bool | None = None
    """A set, by the proposed next test; None where it says that no test would do."""
    without_test: bool | None = None
    """A set: whether it says that no test would do."""
    seconds: float = 0.0
    answer: str = ""
    error: bool = False


def sets_of(answer: Mapping[str, Any]) -> list[set[str]]:
    """Return the names of each finding."""
    return [{f["effect"], *f["equivalent"]} for f in answer["findings"]]


def judge(
    case: Case, answer: Mapping[str, Any], visible: Visible, again: Mapping[str, Any] | None = None
) -> Judgement:
    """Judge one answer.

    Parameters
    ----------
    case : the truth.
    answer : JSON object of the workflow.
    visible : gap of each hidden thing by itself (noise floors), with its block.
    again : answer with the proposed test beside the first record, if that was run.
    """
    sets = sets_of(answer)
    gap = min((g for g, _ in visible.values()), default=0.0)
    seen = bool(visible) and gap >= THRESHOLD
    found: dict[str, Any] = {
        "id": case.id, "group": case.group,
        "names": case.names or ((case.foreign,) if case.foreign else ()), "size": case.size,
        "visible": seen, "gap": gap, "named": bool(sets),
        "seconds": float(answer["seconds"]), "error": answer["verdict"] == "error",
        "answer": describe(answer),
    }
    hidden = set(case.names) - set(case.without)
    if hidden:
        found["wrong"] = any(not names & hidden for names in sets)
        found["closed"] = closed_share(answer)
    if case.group == "effect":
        holding = [names for names in sets if names & hidden and len(names) <= LARGEST_SET]
        found["right"] = bool(holding) and not found["wrong"]
        found["set_size"] = len(holding[0]) if holding else 0
        found["covered"] = coverage(case, answer)
        if found["set_size"] > 1:
            found["without_test"] = not answer.get("next_profile")
        if again is not None and (found["set_size"] > 1 or not sets):
            found["resolved"] = {*case.names} in sets_of(again)
    elif case.group == "pair":
        found["both"] = not found["wrong"] and _each_in_one(case.names, sets)
        found["covered"] = coverage(case, answer)
    elif case.group == "stranger":
        ports = (FOREIGN[case.foreign].ports if case.foreign
                 else tuple(EFFECTS[name].port for name in case.names))
        found |= _unknown(answer, ports, bool(sets))
    return Judgement(**found)


def _each_in_one(names: tuple[str, ...], sets: list[set[str]]) -> bool:
    """Whether the two names are in two findings, each a set of at most three."""
    small = [s if len(s) <= LARGEST_SET else set() for s in sets]
    return any(names[0] in a and names[1] in b
               for i, a in enumerate(small) for j, b in enumerate(small) if i != j)


def _unknown(answer: Mapping[str, Any], ports: tuple[str, ...], named: bool) -> dict[str, bool]:
    shape = answer["unknown"]
    said = shape is not None and answer["verdict"] == "unknown effect" and not named
    told = [part.strip() for part in shape["port"].split(",")][:2] if said else []
    balances = {BALANCES[port] for port in ports}
    return {
        "unknown_port": said and any(port in ports for port in told),
        "unknown_balance": said and any(BALANCES.get(port) in balances for port in told),
    }


def closed_share(answer: Mapping[str, Any]) -> float | None:
    """Return the share of the gap above the floor that was closed (the workflow's own numbers).

    None where the held-out record hardly shows a gap (below `SHOWS` floors): no share is
    meaningful there.
    """
    before, after, floor = (answer.get(k) for k in ("gap_before", "gap_after", "noise_floor"))
    if before is None or after is None or floor is None or not before >= SHOWS * floor:
        return None
    return float((before - after) / (before - floor))


def coverage(case: Case, answer: Mapping[str, Any]) -> tuple[bool, ...]:
    """Return for each severity that was estimated whether the interval holds the true value.

    Only of findings whose own name is right. The sign of an eccentricity is free (it turns the
    angle by half a turn); a constant surface load is left out (the unit's own load adds to it).
    """
    _, effects = truth_of(case)
    inside = []
    for finding in answer["findings"]:
        name = finding["effect"]
        if name not in case.names or name in case.without:
            continue
        for parameter in finding["parameters"]:
            field = parameter["name"].rpartition(".")[2]
            if field not in EFFECTS[name].severity or parameter["name"] == "surface_load.constant":
                continue
            value = getattr(getattr(effects, name), field)
            low, high = parameter["interval"]
            holds = low <= value <= high
            if name == "rotor_eccentricity":
                holds = holds or low <= -value <= high
            inside.append(bool(holds))
    return tuple(inside)


def describe(answer: Mapping[str, Any]) -> str:
    """Return an answer in a few words."""
    names = ["/".join([f["effect"], *f["equivalent"]]) for f in answer["findings"]]
    if answer["unknown"] is not None:
        names.append(f"unknown ({answer['unknown']['port']})")
    return "; ".join(names) or str(answer["verdict"])
