"""One unit of the panel: what is said of it, and whether that is right."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from benchmarks.decisions.units import HiddenUnit
from ema_identification.actuator.laws.catalogue import OF_THE_ROTOR
from ema_identification.actuator.library.build import fleet_library
from ema_identification.identify import identify
from ema_identification.result import Identification
from ema_record.actuator import load_actuator
from ema_record.errors import RecordError
from ema_record.kit import ACTUATOR, LIBRARY, PROFILES, using_kit
from ema_record.profile import load_profile
from ema_record.profiles.text import write_profiles
from ema_sim.effects import EFFECTS
from ema_sim.effects.base import Choice
from ema_sim.model_file import load_model_file

Row = dict[str, Any]
NAMES_ALONE = ("explained", "partly explained")
LARGEST_SET = 3


def made_kit(kit: Path, work: Path) -> Path:
    """Return where the kit of a machine is kept in `work`, with its profiles and libraries."""
    return work / "kits" / kit.name


def make_kit(kit: Path, work: Path, tests: Sequence[str]) -> None:
    """Make in `work` what is missing of a machine's kit: profiles, libraries of the tests."""
    made = made_kit(kit, work)
    if not (made / ACTUATOR).exists():
        made.mkdir(parents=True, exist_ok=True)
        with using_kit(kit):
            if not (made / PROFILES).exists():
                write_profiles(load_model_file().actuator, made / PROFILES)
        shutil.copyfile(kit / ACTUATOR, made / ACTUATOR)
    with using_kit(made):
        for n, test in enumerate(tests):
            if not (made / LIBRARY / f"{test}.built").exists():
                with threadpool_limits(limits=1):  # as `identify` makes it
                    fleet_library(load_model_file(), load_profile(test), signatures=n == 0,
                                  folder=made / LIBRARY)
                (made / LIBRARY / f"{test}.built").touch()


def kit_of_unit(unit: HiddenUnit, work: Path) -> AbstractContextManager[object]:
    """Use the kit of a unit's machine, once it is made."""
    return nullcontext() if unit.kit is None else using_kit(made_kit(unit.kit, work))


def answered(unit: HiddenUnit, work: Path) -> Row:
    """Return what is said of a unit: what it has, or since its acceptance."""
    with kit_of_unit(unit, work):
        started = time.process_time(), time.perf_counter()
        try:
            whole = identify(unit.records[:1], validate=unit.records[1:], without=unit.without,
                             baseline=unit.accepted)
        except RecordError as error:  # a unit that no longer follows its test
            whole = Identification(
                verdict="unknown effect", reasons=(str(error),), gap_before=float("nan"),
                gap_after=float("nan"), noise_floor=float("nan"), gap_unit="")
        seconds = time.process_time() - started[0], time.perf_counter() - started[1]
    found = whole if whole.since is None else whole.since
    return {"names": unit.names, "strange": bool(unit.without), **said(found),
            "whole": [whole.verdict, names_of(whole)], "sizes": sizes_of(found, unit),
            "ports": [EFFECTS[name].port for name in unit.names],
            "next": None if found.next_profile is None else found.next_profile.name,
            "proposed": found.next_test, "seconds": seconds[0], "wall": seconds[1]}


def answered_again(unit: HiddenUnit, work: Path, profile: str) -> Row:
    """Return what is said of a unit once the proposed test is recorded too."""
    with kit_of_unit(unit, work):
        both = (unit.records[0], unit.again(load_profile(profile)))
        started = time.process_time(), time.perf_counter()
        found = identify(both, validate=unit.records[1:], without=unit.without)
        seconds = time.process_time() - started[0], time.perf_counter() - started[1]
    return {"names": unit.names, "strange": bool(unit.without), **said(found),
            "sizes": sizes_of(found, unit), "seconds": seconds[0], "wall": seconds[1]}


def said(found: Identification) -> Row:
    """Return an answer as it is kept."""
    return {"verdict": found.verdict, "reasons": list(found.reasons), "named": names_of(found),
            "port": "" if found.unknown is None else found.unknown.port,
            "gap": [found.gap_before, found.gap_after, found.noise_floor]}


def names_of(found: Identification) -> list[list[str]]:
    """Return the set of names of each finding."""
    return [[f.effect, *f.equivalent] for f in found.findings]


def sizes_of(found: Identification, unit: HiddenUnit) -> list[Row]:
    """Return each number of the laws that are named and hidden: true, estimated, interval.

    ``inside`` is None where the law is named in another mode, phase or number of periods: its
    numbers mean something else there.
    """
    rows: list[Row] = []
    for finding in found.findings:
        if finding.effect not in unit.names or unit.without:
            continue
        truth = as_written(unit.truth, finding.effect)
        fitted = [p for p in finding.parameters if p.high > p.low]
        fixed = {p.name: p.value for p in finding.parameters if p not in fitted}
        alike = all(truth.get(name) == value
                    for name, value in (*finding.choices.items(), *fixed.items()))
        turn = turn_of(unit, finding.effect, fixed)
        for p in fitted:
            true, turning = truth.get(p.name), p.name.rpartition(".")[2] in ("phase", "angle")
            rows.append({
                "name": p.name, "true": true, "value": p.value, "low": p.low, "high": p.high,
                "inside": holds(p.low, p.high, true, turn if turning and p.unit == "rad" else 0.0)
                if alike and isinstance(true, float) else None})
    return rows


def turn_of(unit: HiddenUnit, effect: str, fixed: Mapping[str, float]) -> float:
    """Return by what angles of a law differ that a record cannot tell apart (rad).

    Of `periods` a mechanical turn, which the rotor may begin in any of its electrical ones.
    """
    if effect not in OF_THE_ROTOR:
        return 2.0 * math.pi
    with nullcontext() if unit.kit is None else using_kit(unit.kit):
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
