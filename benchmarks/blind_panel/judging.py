"""One answer of `ema identify` beside the truth: whether it is right, and its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.blind_panel.tasks import on_kit
from benchmarks.blind_panel.truth.answers import Answer
from ema_identification.actuator.laws.catalogue import OF_THE_ROTOR
from ema_record.actuator import load_actuator
from ema_sim.effects import EFFECTS
from ema_sim.effects.base import Choice

Row = dict[str, Any]
Said = Mapping[str, Any]
"""JSON object of `ema identify`, with seconds and the proposed test (`run.identified`)."""
NAMES_ALONE = ("explained", "partly explained")
LARGEST_SET = 3


def row_of(answer: Answer, said: Said) -> Row:
    """Return what is hidden in a unit beside what is said of it, or since its acceptance."""
    found = said.get("since_baseline", said)
    return {"k": answer.k, "names": answer.names, "strange": bool(answer.without),
            "verdict": found["verdict"], "named": names_of(found),
            "port": "" if found["unknown"] is None else found["unknown"]["port"],
            "ports": [EFFECTS[name].port for name in answer.names],
            "sizes": sizes_of(found, answer), "seconds": said["cpu"], "wall": said["wall"],
            "next": None if said["next_profile"] is None else said["next_profile"]["name"]}


def names_of(found: Said) -> list[list[str]]:
    """Return the set of names of each finding."""
    return [[f["effect"], *f["equivalent"]] for f in found["findings"]]


def in_question(said: Said) -> bool:
    """Whether an answer leaves several names, and proposes a test that would tell them apart."""
    return (said["verdict"] in NAMES_ALONE and said["next_profile"] is not None
            and any(len(names) > 1 for names in names_of(said)))


def sizes_of(found: Said, answer: Answer) -> list[Row]:
    """Return each number of the laws that are named and hidden: true, estimated, interval.

    ``inside`` is None where the law is named in another mode, phase or number of periods: its
    numbers mean something else there.
    """
    rows: list[Row] = []
    for finding in found["findings"]:
        effect = finding["effect"]
        if effect not in answer.names or answer.without:
            continue
        truth = as_written(answer.truth, effect)
        fitted = [p for p in finding["parameters"] if p["interval"][1] > p["interval"][0]]
        fixed = {p["name"]: p["value"] for p in finding["parameters"] if p not in fitted}
        alike = all(truth.get(name) == value
                    for name, value in (*finding["choices"].items(), *fixed.items()))
        turn = turn_of(answer.kit, effect, fixed)
        for p in fitted:
            true, (low, high) = truth.get(p["name"]), p["interval"]
            turning = p["name"].rpartition(".")[2] in ("phase", "angle") and p["unit"] == "rad"
            rows.append({
                "name": p["name"], "true": true, "value": p["value"], "low": low, "high": high,
                "inside": holds(low, high, true, turn if turning else 0.0)
                if alike and isinstance(true, float) else None})
    return rows


def turn_of(kit: Path | None, effect: str, fixed: Mapping[str, float]) -> float:
    """Return by what angles of a law differ that a record cannot tell apart (rad).

    Of `periods` a mechanical turn, which the rotor may begin in any of its electrical ones.
    """
    if effect not in OF_THE_ROTOR:
        return 2.0 * math.pi
    with on_kit(kit):
        pairs = load_actuator().motor.pole_pairs
    periods = round(fixed.get(f"{effect}.periods", 1.0))
    return 2.0 * math.pi * math.gcd(periods, pairs) / pairs


def as_written(truth: Mapping[str, float | str], effect: str) -> dict[str, float | str]:
    """Return the true parameters of a law as an answer would write them, dotted names.

    What is not said has its default; an eccentricity of the other sign points the other way.
    """
    given = {name: value for name, value in truth.items() if name.startswith(f"{effect}.")}
    if not given:
        return {}
    found: dict[str, float | str] = {
        f"{effect}.{f.name}": f.kind.options[int(f.default)]
        if isinstance(f.kind, Choice) else float(f.default) for f in EFFECTS[effect].fields}
    found |= given
    zeta, angle = (found.get(f"rotor_eccentricity.{name}") for name in ("zeta", "angle"))
    if isinstance(zeta, float) and isinstance(angle, float) and zeta < 0.0:
        found |= {"rotor_eccentricity.zeta": -zeta, "rotor_eccentricity.angle": angle + math.pi}
    return found


def holds(low: float, high: float, true: float, turn: float = 0.0) -> bool:
    """Return whether an interval holds a value; of an angle it is the same a `turn` further."""
    if turn:
        middle = 0.5 * (low + high)
        true = middle + math.remainder(true - middle, turn)
    return low <= true <= high


def outcome(row: Row) -> str:
    """Return right, part, wrong, unknown or silent.

    Right: sets of at most three names, each of another effect that is hidden, all hidden ones
    named. Part: of two effects one is named, and nothing else. A name of a stranger is wrong.
    """
    if row["verdict"] not in NAMES_ALONE or not row["named"]:
        return "silent" if row["verdict"] == "no disagreement" else "unknown"
    left, wrong = set(() if row["strange"] else row["names"]), False
    for names in row["named"]:
        hit = next((n for n in names[:LARGEST_SET] if n in left), None)
        wrong |= hit is None
        left.discard(hit or "")
    if wrong:
        return "wrong"
    return "part" if left else "right"


def is_set(row: Row) -> bool:
    """Whether the answer is right and leaves more than one name."""
    return outcome(row) == "right" and any(len(names) > 1 for names in row["named"])


def resolved(row: Row) -> bool:
    """Whether the answer is right and leaves one name for each effect."""
    return outcome(row) == "right" and not is_set(row)


def right_port(row: Row) -> bool:
    """Whether an unknown effect is said to be where it is: one of the first two ports named."""
    told = [part.strip() for part in row.get("port", "").split(",")][:2]
    return outcome(row) == "unknown" and any(port in told for port in row.get("ports", ()))
