"""Whether what is hidden is visible, judged apart from the workflow.

As in the blind panel (`benchmarks.blind_panel.truth.visible`, its views and its three noise
floors): the first test with what is hidden and without, less what any move of the unit's numbers
and of the day's within the kit's bands gives back. Floor and sensitivities are of effect-free
units of our own simulator, squares of the moves taken off too; a unit of the second simulator is
taken to stand in the middle of its bands. Units of the default kit, with one effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.blind_panel.truth.views import view
from benchmarks.blind_panel.truth.visible import (
    PAIRS,
    THRESHOLD,
    Floor,
    Null,
    floor_of,
    largest_gap,
)
from benchmarks.decisions.judging import Row, outcome
from benchmarks.decisions.units import HiddenUnit
from ema_identification.actuator.fleet.units import (
    draw_fleet_conditions,
    draw_fleet_unit,
    fleet_unit,
    of_day,
    start_of,
)
from ema_record.actuator import load_actuator
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_record.spread import load_spread
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate

UNITS, SEED = 1500, 880_001
"""Effect-free units: fifteen times the numbers of the regression."""


def make_floor(path: Path, test: str) -> Floor:
    """Return the floor on a test, from `path` if it was made before (a minute)."""
    model, spread, profile = load_model_file(), load_spread(), load_profile(test)

    def null(k: int) -> Null:
        rng = np.random.default_rng([SEED, k])
        z, day = draw_fleet_unit(rng, model.actuator), draw_fleet_conditions(rng, spread)
        actuator, effects = fleet_unit(model, spread, z, day)
        record = simulate(profile, actuator=actuator, effects=effects, seed=k,
                          start_angle=day.start_angle, start=start_of(model.actuator, profile, z))
        bus, warm = _known(record)
        return view(record), z, np.array(
            [bus, warm, bus * bus, warm * warm, bus * warm, *z**2])

    return floor_of(path, null, UNITS)


def _known(record: Record) -> tuple[float, float]:
    """Return bus and winding temperature as -1 to 1 of the kit's conditions."""
    c, nominal = load_spread().conditions, load_actuator().inverter.bus_voltage
    bus, warm = np.median(record.dc_bus[:, 1]), np.mean(record.winding_temperature[:, 1])
    middle = 0.5 * (c.temperature_least + c.temperature_most)
    return float((bus / nominal - 1.0) / c.bus), float(
        (warm - middle) / (c.temperature_most - middle))


def gap_of(unit: HiddenUnit, floor: Floor) -> tuple[float, str]:
    """Return the largest gap that is left of what is hidden (noise floors), and its block."""
    shifts, where = [], (0.0, 0.0)
    for k in range(PAIRS):
        records = unit.both(SEED + k)
        where = _known(records[0])
        one, other = (np.concatenate(list(view(record).values())) for record in records)
        shifts.append(one - other)
    width = floor.slopes.shape[1]
    place = np.zeros(width) if unit.place is None else np.clip(
        np.where(of_day(width), 0.0, unit.place), -1.0, 1.0)
    return largest_gap(shifts, floor, floor.sensitivity(*where), place)


def visible_table(rows: Sequence[tuple[str, Row, float]]) -> list[Sequence[object]]:
    """Return by stratum how many are visible, how many of these are right, what is not seen.

    `rows` : stratum, answer and gap of each unit.
    """
    lines: list[Sequence[object]] = []
    for stratum in dict.fromkeys(stratum for stratum, *_ in rows):
        own = [(row, gap) for name, row, gap in rows if name == stratum]
        seen = [row for row, gap in own if gap >= THRESHOLD]
        lines.append((
            stratum, len(own), len(seen), sum(outcome(row) == "right" for row in seen),
            "; ".join(f"{'+'.join(row['names'])} {gap:.1f} {outcome(row)}" for row, gap in own
                      if outcome(row) != "right") or "-"))
    return lines
