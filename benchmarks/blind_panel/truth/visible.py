"""Whether an effect is visible: after recalibration within tolerance, 3 noise floors or more.

Defined by simulation, apart from the workflow:

1. *Floor*: `N_NULL` effect-free units and conditions on the first test; every number of
   `views.view` is regressed on what a recalibration may move (tolerances, conditions that
   nobody measures; each also times the measured bus and temperature). The standard deviation
   of what is left is the noise floor of that number.
2. *Shift*: the same unit with and without the effect, same noise and start angle, `PAIRS`
   times; the mean difference of the views.
3. *Recalibration*: the shift is fitted by moves within the bounds of the tolerances (bounded
   least squares); what is left, in floors, squared and averaged over a block (one curve over
   time, or one line in rotor angle), is the block's gap. Squares are products of two halves
   of the pairs, so noise adds nothing.

Visible: the gap of some block is at least `THRESHOLD` floors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import lsq_linear

from benchmarks.blind_panel.truth.bags import truth_of
from benchmarks.blind_panel.truth.cases import Case
from benchmarks.blind_panel.truth.foreign import foreign_record
from benchmarks.blind_panel.truth.views import view
from benchmarks.units import (
    CONDITION_SPREAD,
    TEMPERATURE,
    UNIT_SPREAD,
    Unit,
    actuator_of,
    draw_unit,
)
from ema_record.profile import load_profile
from ema_sim.effects.settings import effects_from_mapping
from ema_sim.simulate import simulate

N_NULL = 500
PAIRS = 4
THRESHOLD = 3.0
SEED = 990_001
FREE = {**UNIT_SPREAD, **CONDITION_SPREAD}
"""What a recalibration may move, with half widths."""
Null = tuple[Mapping[str, np.ndarray], np.ndarray, np.ndarray]
"""View of an effect-free unit, its moves, what is known of its conditions."""


def _moves(unit: Unit) -> np.ndarray:
    """Return the place of a unit in its tolerances, -1 to 1, shape (free,)."""
    values = {**unit.spread, **unit.conditions}
    return np.array([values[name] / half for name, half in FREE.items()])


def _known(unit: Unit) -> np.ndarray:
    """Return bus, temperature (as -1 to 1) and their squares."""
    middle, half = np.mean(TEMPERATURE), 0.5 * np.ptp(TEMPERATURE)
    bus = unit.conditions["bus_voltage_change.change"] / 0.1
    warm = (unit.conditions["winding_temperature.temperature"] - middle) / half
    return np.array([bus, warm, bus * bus, warm * warm, bus * warm])


@dataclass(frozen=True, slots=True)
class Floor:
    """Noise floor and sensitivities of all numbers of a view."""

    blocks: dict[str, slice]
    sigma: np.ndarray
    slopes: np.ndarray
    """Shape (3, free, numbers): of each move, and of each move times bus and temperature."""

    def sensitivity(self, bus: float, warm: float) -> np.ndarray:
        """Return the sensitivity to each move under a unit's conditions."""
        return np.asarray(self.slopes[0] + bus * self.slopes[1] + warm * self.slopes[2])


def make_floor(path: Path, first: str = "extended") -> Floor:
    """Return the floor on a test, from `path` if it was made before (some two minutes)."""
    profile = load_profile(first)

    def null(k: int) -> Null:
        unit = draw_unit(np.random.default_rng([SEED, k]))
        return view(simulate(
            profile, actuator=actuator_of(unit.spread), seed=k, noise=unit.noise,
            effects=effects_from_mapping(unit.conditions))), _moves(unit), _known(unit)

    return floor_of(path, null, N_NULL)


def floor_of(path: Path, null: Callable[[int], Null], units: int) -> Floor:
    """Return the floor of effect-free units, from `path` if it was made before.

    `null` : gives the view of a unit, its moves and what is known of it; of that bus and
    temperature come first, by which moves are multiplied too.
    """
    if not path.exists():
        views, moves, known = [], [], []
        for k in range(units):
            found, place, conditions = null(k)
            views.append(np.concatenate(list(found.values())))
            moves.append(place)
            known.append(conditions)
        p, c = np.array(moves), np.array(known)
        design = np.hstack([p, p * c[:, :1], p * c[:, 1:2], c, np.ones((units, 1))])
        y = np.array(views)
        slopes, *_ = np.linalg.lstsq(design, y, rcond=None)
        left = y - design @ slopes
        sigma = np.sqrt(np.sum(left**2, axis=0) / (units - design.shape[1]))
        temporary = path.with_suffix(".tmp.npz")
        np.savez(temporary, sigma=sigma, slopes=slopes[:3 * p.shape[1]],
                 names=np.array(list(found)), sizes=np.array([len(v) for v in found.values()]))
        temporary.replace(path)
    with np.load(path) as data:
        ends = np.cumsum(data["sizes"])
        blocks = {str(name): slice(int(end - size), int(end))
                  for name, size, end in zip(data["names"], data["sizes"], ends)}
        # A number that no noise moves (a saturated one) has the floor of its block.
        sigma = data["sigma"].copy()
        for place in blocks.values():
            sigma[place] = np.maximum(sigma[place], 0.3 * np.median(sigma[place]))
        slopes = data["slopes"]
        return Floor(blocks, np.maximum(sigma, 1e-9),
                     slopes.reshape(3, len(slopes) // 3, -1))


def _shift(case: Case, seed: int) -> np.ndarray:
    """Return view with what is hidden minus view without, same noise and start angle."""
    bare = replace(case, settings={}, foreign="")
    views = []
    for c in (case, bare):
        actuator, effects = truth_of(c)
        record = simulate(load_profile(case.first), actuator=actuator, effects=effects,
                          seed=seed, noise=case.unit.noise)
        found = view(foreign_record(c.foreign, record))
        views.append(np.concatenate(list(found.values())))
    return np.asarray(views[0] - views[1])


def gap(case: Case, floor: Floor) -> tuple[float, str]:
    """Return the largest gap of a block in noise floors, and the block's name."""
    shifts = [_shift(case, SEED + case.seed % 100_000 + k) for k in range(PAIRS)]
    return largest_gap(shifts, floor, floor.sensitivity(*_known(case.unit)[:2]),
                       _moves(case.unit))


def largest_gap(
    shifts: Sequence[np.ndarray], floor: Floor, sensitivity: np.ndarray, place: np.ndarray
) -> tuple[float, str]:
    """Return what recalibration leaves of a shift in its worst block, and the block's name.

    Parameters
    ----------
    shifts : of repeats, shape (numbers,) each.
    sensitivity : ndarray, shape (free, numbers).
    place : ndarray, shape (free,). Where the unit is in its tolerances, -1 to 1.
    """
    halves = [np.mean(shifts[k::2], axis=0) / floor.sigma for k in range(2)]
    slopes = (sensitivity / floor.sigma).T
    low, high = np.minimum(-1.0 - place, -1e-9), np.maximum(1.0 - place, 1e-9)
    # The recalibration takes away what the tolerances can give back.
    fit = lsq_linear(slopes, 0.5 * (halves[0] + halves[1]), bounds=(low, high))
    left = [half - slopes @ fit.x for half in halves]
    energy = {name: float(np.mean(left[0][s] * left[1][s])) for name, s in floor.blocks.items()}
    worst = max(energy, key=lambda name: energy[name])
    return float(np.sqrt(max(0.0, energy[worst]))), worst


def visible_parts(case: Case, floor: Floor) -> dict[str, tuple[float, str]]:
    """Return the gap of each hidden thing by itself, by its name."""
    if case.foreign:
        return {case.foreign: gap(case, floor)}
    found = {}
    for name in case.names:
        settings = {k: v for k, v in case.settings.items() if k.partition(".")[0] == name}
        found[name] = gap(replace(case, settings=settings), floor)
    return found
