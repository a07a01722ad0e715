"""The decision of `ema identify` in its own world and outside: ``python -m benchmarks.decisions``.

The panel is declared before it is run: `--seed` and `--each`, the units of each of `STRATA`. One
line a unit is kept, nothing is done twice, and `--table` prints what there is: a panel that is cut
short has as many units of each stratum, in the order of their numbers. Effects are of medium and
large size (`benchmarks.blind_panel.truth.hidden`). Strata of accepted units ask what has changed
since their acceptance (`--baseline`). Strata of another drive are of a described machine with a
carrier (`benchmarks.any_actuator`), whose library is built on first use as any kit's.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import beta

from benchmarks.any_actuator.cases import _stranger
from benchmarks.any_actuator.described import Damage
from benchmarks.any_actuator.machines import FOLDER
from benchmarks.any_actuator.records import record_of
from benchmarks.any_actuator.units import draw_test
from benchmarks.blind_panel.truth.hidden import HIDEABLE, draw_effect, draw_pair
from benchmarks.ledger import Ledger
from ema_identification.actuator.decision.fleet import (
    OF_DAY,
    UNLISTED,
    draw_fleet_conditions,
    draw_fleet_unit,
    fleet_unit,
)
from ema_identification.identify import identify
from ema_record.actuator import load_actuator
from ema_record.kit import using_kit
from ema_record.profile import Profile, load_profile
from ema_record.profiles.design import default_profiles
from ema_record.record import Record
from ema_record.spread import load_spread
from ema_sim.effects import parse_effects
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate

DAMAGES: dict[str, tuple[str, float | None]] = {
    "turn_short": ("short", 0.03), "rotor_eccentricity": ("eccentricity", 0.03),
    "motor_friction": ("motor_friction", 0.6), "surface_friction": ("surface_friction", 0.6),
    "backlash": ("backlash", 1e-3), "cogging_torque": ("cogging", None),
    "torque_constant_drop": ("demagnetisation", 0.15), "bus_voltage_sag": ("sag", None),
    "phase_resistance_imbalance": ("resistance", 0.5), "hall_misalignment": ("hall", 0.1),
    "gear_mesh_ripple": ("mesh", None),
}
"""Effect: field of `Damage` and its size; None: as the benchmark of the kit draws it."""
STRANGE = tuple(name for name, hidden in HIDEABLE.items() if hidden.without is not None)
STRANGE_DAMAGES = tuple(name for name in DAMAGES if name in STRANGE)
LISTED_SIZE = len(UNLISTED)
PWM = FOLDER / "joint_48v"
"""Kit of a machine whose currents are controlled by a carrier."""
RANGE = 1.3
"""Of bands that are wider than the description says."""


class HiddenUnit(NamedTuple):
    """A unit under test: what is hidden, what the catalogue lacks, its records."""

    names: tuple[str, ...]
    without: tuple[str, ...]
    records: tuple[Record, ...]
    accepted: tuple[Record, ...] = ()
    """From before something was hidden, of the first test."""
    kit: Path | None = None
    """Of another machine than the default one."""


def own_unit(
    seed: int, k: int, tests: tuple[str, ...], *, hidden: int = 0, listed: bool = False,
    strange: bool = False, bands: float = 1.0, accepted: bool = False, kit: Path | None = None,
) -> HiddenUnit:
    """Return a unit of our own simulator with `hidden` effects.

    `listed` : only what recalibration lists is off, latencies and the rest as given.
    """
    model, spread = load_model_file(), load_spread()
    rng = np.random.default_rng([seed, 77, k])
    z = bands * draw_fleet_unit(rng)
    if listed:
        z[-LISTED_SIZE:] = [-1.0 if "latency" in name else 0.0 for name in UNLISTED]
    pool = STRANGE if strange else tuple(HIDEABLE)
    order = np.random.default_rng([seed, 76]).permutation(len(pool))
    names: tuple[str, ...] = ()
    if hidden:
        names = draw_pair(rng) if hidden == 2 else (pool[order[k % len(pool)]],)
    settings: dict[str, float | str] = {}
    for name in names:
        settings |= draw_effect(name, 1 + int(rng.integers(2)), rng)
    records = []
    for n, test in enumerate((*tests[:accepted], *tests)):
        z = np.where(OF_DAY, rng.uniform(-1.0, 1.0, len(z)), z)
        day = draw_fleet_conditions(rng, spread)
        given = {} if n < accepted else settings
        actuator, effects = fleet_unit(model, spread, z, day, parse_effects(
            [f"{a}={b}" for a, b in given.items()], model.effects))
        records.append(simulate(
            test_of(test, kit), actuator=actuator, effects=effects, noise=day.noise,
            seed=int(rng.integers(2**31)), start_angle=day.start_angle))
    return HiddenUnit(names, (HIDEABLE[names[0]].without or ()) if strange else (),
                      tuple(records[accepted:]), tuple(records[:accepted]), kit)


def test_of(name: str, kit: Path | None) -> Profile:
    """Return a test by its name, as the product makes it for the machine of a kit."""
    return load_profile(name) if kit is None else default_profiles(load_actuator())[name]


def second_unit(
    seed: int, k: int, tests: tuple[str, ...], *, hidden: int = 0, strange: bool = False,
    accepted: bool = False, kit: Path | None = None,
) -> HiddenUnit:
    """Return a unit of the second simulator, all of the kit's `tolerances` off."""
    a, spread = load_actuator(), load_spread()
    rng = np.random.default_rng([seed, 78, k])
    names: tuple[str, ...] = ()
    damage = Damage()
    if hidden:
        pool = STRANGE_DAMAGES if strange else tuple(DAMAGES)
        order = np.random.default_rng([seed, 75]).permutation(len(pool))
        names = (pool[order[k % len(pool)]],)
        field, size = DAMAGES[names[0]]
        if kit is not None and field == "backlash":  # in the machine's own measure
            size = a.wind_up / a.gear.ratio
        fields: dict[str, Any] = {field: size, "phase": int(rng.integers(3)),
                                  "angle": float(rng.uniform(-3.0, 3.0))}
        damage = _stranger(a, field, rng) if size is None else Damage(**fields)
    without = (HIDEABLE[names[0]].without or ()) if strange else ()

    def tested(n: int, test: str, given: Damage) -> Record:
        return record_of(draw_test(
            a, spread.tolerances, spread.conditions, (seed + hidden + strange, k), n, given,
            own=False), test_of(test, kit))

    return HiddenUnit(
        names, without, tuple(tested(n, test, damage) for n, test in enumerate(tests)),
        (tested(len(tests), tests[0], Damage()),) * accepted, kit)


def of_kit(kit: Path, make: Callable[..., HiddenUnit], *which: object, **how: object
           ) -> HiddenUnit:
    """Return a unit of the machine of a kit."""
    with using_kit(kit):
        return make(*which, kit=kit, **how)


STRATA: dict[str, Callable[..., HiddenUnit]] = {
    "own, nothing": partial(own_unit, listed=True),
    "own, one effect": partial(own_unit, listed=True, hidden=1),
    "own, unlisted off, nothing": own_unit,
    "own, unlisted off, one effect": partial(own_unit, hidden=1),
    "own, bands x 1.3, nothing": partial(own_unit, bands=RANGE),
    "second, nothing": second_unit,
    "second, one effect": partial(second_unit, hidden=1),
    "second, outside the catalogue": partial(second_unit, hidden=1, strange=True),
    "own, two effects": partial(own_unit, listed=True, hidden=2),
    "own, outside the catalogue": partial(own_unit, listed=True, hidden=1, strange=True),
    "own, accepted, nothing": partial(own_unit, accepted=True),
    "own, accepted, then one effect": partial(own_unit, hidden=1, accepted=True),
    "second, accepted, nothing": partial(second_unit, accepted=True),
    "second, accepted, then one effect": partial(second_unit, hidden=1, accepted=True),
    "pwm, own, nothing": partial(of_kit, PWM, own_unit),
    "pwm, second, nothing": partial(of_kit, PWM, second_unit),
    "pwm, second, one effect": partial(of_kit, PWM, second_unit, hidden=1),
}


def answered(unit: HiddenUnit) -> dict[str, Any]:
    """Return what is said of a unit: what it has, or since its acceptance."""
    started = time.process_time()
    with nullcontext() if unit.kit is None else using_kit(unit.kit):
        whole = identify(unit.records[:1], validate=unit.records[1:], without=unit.without,
                         baseline=unit.accepted)
    found = whole if whole.since is None else whole.since
    return {"names": unit.names, "strange": bool(unit.without), "verdict": found.verdict,
            "reasons": list(found.reasons),
            "named": [[f.effect, *f.equivalent] for f in found.findings],
            "gap": [found.gap_before, found.gap_after, found.noise_floor],
            "whole": [whole.verdict, [[f.effect, *f.equivalent] for f in whole.findings]],
            "seconds": time.process_time() - started}


def outcome(row: dict[str, Any]) -> str:
    """Return right, part, wrong, unknown or silent.

    Right: sets of at most three names, each of another effect that is hidden, all hidden ones
    named. Part: of two effects one is named, and nothing else. A name of a stranger is wrong.
    """
    if row["verdict"] not in ("explained", "partly explained") or not row["named"]:
        return "silent" if row["verdict"] == "no disagreement" else "unknown"
    left, wrong = set(() if row["strange"] else row["names"]), False
    for names in row["named"]:
        hit = next((n for n in names[:3] if n in left), None)
        wrong |= hit is None
        left.discard(hit or "")
    if wrong:
        return "wrong"
    return "part" if left else "right"


def interval(count: int, of: int) -> str:
    """Return a share with the bounds of Clopper and Pearson (1934), 90 %."""
    low = beta.ppf(0.05, count, of - count + 1) if count else 0.0
    high = beta.ppf(0.95, count + 1, of - count) if count < of else 1.0
    return f"{count} ({100 * low:.0f}-{100 * high:.0f} %)"


def table(rows: dict[str, list[dict[str, Any]]]) -> str:
    """Return the table of all rows by stratum; seconds are the median."""
    said = ("right", "part", "wrong", "unknown", "silent")
    lines = [f"| stratum | units | {' | '.join(said)} | s |", "|---" * (len(said) + 3) + "|"]
    for stratum, found in rows.items():
        counts = [sum(outcome(r) == k for r in found) for k in said]
        lines.append(f"| {stratum} | {len(found)} | " + " | ".join(
            interval(c, len(found)) for c in counts)
            + f" | {np.median([r['seconds'] for r in found]):.1f} |")
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--each", type=int, required=True, help="units of each stratum")
    parser.add_argument("--tests", default="extended,step",
                        help="profile of the record, and of the held-out one if there is one")
    parser.add_argument("--strata", default="", help="only those that begin with this")
    parser.add_argument("--table", action="store_true", help="run nothing")
    given = parser.parse_args()
    tests = tuple(given.tests.split(","))
    given.out.mkdir(parents=True, exist_ok=True)
    ledger = Ledger(given.out / "decisions.jsonl")
    rows: dict[str, list[dict[str, Any]]] = {
        stratum: [] for stratum in STRATA if stratum.startswith(given.strata)}
    for k in range(given.each):
        for stratum, found in rows.items():
            key = f"{given.seed}/{given.tests}/{stratum}/{k}/likelihood"
            if key not in ledger.keys:
                if given.table:
                    continue
                unit = STRATA[stratum](given.seed, k, tests)
                row = ledger.run(key, partial(answered, unit))
                print(key, row["names"], row["verdict"], row["named"], flush=True)
            found.append(ledger.run(key, dict))
    print(table({key: found for key, found in rows.items() if found}))


if __name__ == "__main__":
    main()
