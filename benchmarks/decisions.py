"""Both decisions of `ema identify` on the same units: ``python -m benchmarks.decisions``.

Units differ in everything that the kit's `tolerances` name. Half of them are of our own simulator
(`own`), half of the second one (`second`, `benchmarks.any_actuator`); the first ones of each are
healthy. A record of the test `extended` is explained, one of `step` judges. One line a unit and
decision is kept, and nothing is done twice; the table counts names.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.any_actuator.cases import _stranger
from benchmarks.any_actuator.described import Damage
from benchmarks.any_actuator.records import record_of
from benchmarks.any_actuator.units import draw_test
from benchmarks.blind_panel.truth.hidden import HIDEABLE, draw_effect
from benchmarks.ledger import Ledger
from ema_identification.actuator.decision.fleet import (
    draw_fleet_conditions,
    draw_fleet_unit,
    fleet_unit,
)
from ema_identification.actuator.decision.gap import OF_DAY
from ema_identification.identify import identify
from ema_record.actuator import load_actuator
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_record.spread import load_spread
from ema_sim.effects import parse_effects
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate

TESTS = ("extended", "step")
DAMAGES: dict[str, tuple[str, float | None]] = {
    "turn_short": ("short", 0.03), "rotor_eccentricity": ("eccentricity", 0.03),
    "motor_friction": ("motor_friction", 0.6), "surface_friction": ("surface_friction", 0.6),
    "backlash": ("backlash", 1e-3), "cogging_torque": ("cogging", None),
    "torque_constant_drop": ("demagnetisation", 0.15), "bus_voltage_sag": ("sag", None),
    "phase_resistance_imbalance": ("resistance", 0.5), "hall_misalignment": ("hall", 0.1),
    "gear_mesh_ripple": ("mesh", None),
}
"""Effect: field of `Damage` and its size; None: as the benchmark of the kit draws it."""


class HiddenUnit(NamedTuple):
    """A unit under test: what is hidden, and its two records."""

    key: str
    name: str
    """Empty: nothing."""
    records: tuple[Record, ...]


def own_units(seed: int, healthy: int, effects: int, rate: float = 2e4) -> Iterator[HiddenUnit]:
    """Yield units of our own simulator, effects of medium and large size."""
    model, spread, names = load_model_file(), load_spread(), list(HIDEABLE)
    for k in range(healthy + effects):
        rng = np.random.default_rng([seed, 77, k])
        z, name = draw_fleet_unit(rng), ""
        settings: dict[str, float | str] = {}
        if k >= healthy:
            name = names[(k - healthy) % len(names)]
            settings = draw_effect(name, 1 + int(rng.integers(2)), rng)
        records = []
        for test in TESTS:
            z = np.where(OF_DAY, rng.uniform(-1.0, 1.0, len(z)), z)
            day = draw_fleet_conditions(rng, spread)
            actuator, hidden = fleet_unit(model, spread, z, day, parse_effects(
                [f"{a}={b}" for a, b in settings.items()], model.effects))
            records.append(simulate(
                load_profile(test), actuator=actuator, effects=hidden, noise=day.noise, rate=rate,
                seed=int(rng.integers(2**31)), start_angle=day.start_angle))
        yield HiddenUnit(f"own-{seed}-{k}", name, tuple(records))


def second_units(seed: int, healthy: int, effects: int) -> Iterator[HiddenUnit]:
    """Yield units of the second simulator."""
    a, spread = load_actuator(), load_spread()
    for k in range(healthy + effects):
        rng = np.random.default_rng([seed, 78, k])
        name, damage = "", Damage()
        if k >= healthy:
            name = list(DAMAGES)[(k - healthy) % len(DAMAGES)]
            field, size = DAMAGES[name]
            fields: dict[str, Any] = {field: size, "phase": int(rng.integers(3)),
                                      "angle": float(rng.uniform(-3.0, 3.0))}
            damage = _stranger(a, field, rng) if size is None else Damage(**fields)
        yield HiddenUnit(f"second-{seed}-{k}", name, tuple(
            record_of(draw_test(a, spread.tolerances, spread.conditions, (seed, k), n, damage,
                                own=False), load_profile(test)) for n, test in enumerate(TESTS)))


def answered(unit: HiddenUnit, by_fleet: bool) -> dict[str, Any]:
    """Return what is said of a unit."""
    started = time.process_time()
    found = identify(unit.records[:1], validate=unit.records[1:], by_fleet=by_fleet)
    return {"name": unit.name, "verdict": found.verdict, "reasons": list(found.reasons),
            "named": [[f.effect, *f.equivalent] for f in found.findings],
            "gap": [found.gap_before, found.gap_after, found.noise_floor],
            "seconds": time.process_time() - started}


def outcome(row: dict[str, Any]) -> str:
    """Return right, wrong, unknown or silent; of a healthy unit a name is wrong."""
    named = row["verdict"] in ("explained", "partly explained")
    if named:
        right = len(row["named"]) == 1 and row["name"] in row["named"][0]
        return "right" if right else "wrong"
    return "silent" if row["verdict"] == "no disagreement" else "unknown"


def main() -> None:
    """Run what is missing, print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--healthy", type=int, default=12)
    parser.add_argument("--effects", type=int, default=20)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    ledger = Ledger(given.out / "decisions.jsonl")
    counts: dict[tuple[str, str], dict[str, int]] = {}
    worlds: dict[str, Callable[[int, int, int], Iterator[HiddenUnit]]] = {
        "own": own_units, "second": second_units}
    for world, units in worlds.items():
        for unit in units(given.seed, given.healthy, given.effects):
            for by_fleet in (False, True):
                which = "likelihood" if by_fleet else "present"
                row = ledger.run(f"{which}/{unit.key}", partial(answered, unit, by_fleet))
                group = f"{world}, {'effect' if unit.name else 'healthy'}"
                said = counts.setdefault((group, which), {})
                said[outcome(row)] = said.get(outcome(row), 0) + 1
    print("| units | decision | right | wrong | unknown | silent |\n|---|---|---|---|---|---|")
    for (group, which), said in sorted(counts.items()):
        shown = " | ".join(str(said.get(k, 0)) for k in ("right", "wrong", "unknown", "silent"))
        print(f"| {group} | {which} | {shown} |")


if __name__ == "__main__":
    main()
