"""Whether a hidden effect is visible: after recalibration within the kit's bands, 3 noise floors.

Judged by simulation, apart from the workflow, on the first test:

1. *Floor*: `UNITS` effect-free units of our own simulator; every number of `views.view` is
   regressed on what a recalibration may move (numbers of the unit and of the day; each also
   times the measured bus and temperature), and on the squares of the moves. The standard
   deviation of what is left is the noise floor of that number.
2. *Shift*: the same unit on the same day with all that is hidden and without the effect, same
   noise, `PAIRS` times; the difference of the views.
3. *Recalibration*: the shift is fitted by moves within the bounds of the bands (bounded least
   squares), a unit of the second simulator standing in the middle of them, and by any share of
   the other effect's shift where two are hidden; what is left, in floors, squared and averaged
   over a block (one curve over time, or one line in rotor angle), is the block's gap. Squares are
   products of two halves of the pairs, so noise adds nothing.

Visible: the gap of some block is at least `THRESHOLD` floors, of two effects that of each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import lsq_linear

from benchmarks.blind_panel.tasks import on_kit
from benchmarks.blind_panel.truth.units import HiddenUnit, test_of
from benchmarks.blind_panel.truth.views import view
from ema_identification.actuator.fleet.units import (
    draw_fleet_conditions,
    draw_fleet_unit,
    fleet_unit,
    of_day,
)
from ema_record.actuator import load_actuator
from ema_record.profile import Profile
from ema_record.record import Record
from ema_record.spread import load_spread
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate, start_of

UNITS, SEED = 1500, 880_001
"""Effect-free units: fifteen times the numbers of the regression."""
PAIRS = 4
THRESHOLD = 3.0


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


def make_floor(path: Path, test: str, kit: Path | None = None) -> Floor:
    """Return the floor on a test of a kit, from `path` if it was made before (a minute)."""
    if not path.exists():
        views, moves, known = [], [], []
        for k in range(UNITS):
            with on_kit(kit):
                found, place, conditions = _effect_free(k, test_of(test, kit))
            views.append(np.concatenate(list(found.values())))
            moves.append(place)
            known.append(conditions)
        p, c = np.array(moves), np.array(known)
        design = np.hstack([p, p * c[:, :1], p * c[:, 1:2], c, np.ones((UNITS, 1))])
        y = np.array(views)
        slopes, *_ = np.linalg.lstsq(design, y, rcond=None)
        left = y - design @ slopes
        sigma = np.sqrt(np.sum(left**2, axis=0) / (UNITS - design.shape[1]))
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
        for block in blocks.values():
            sigma[block] = np.maximum(sigma[block], 0.3 * np.median(sigma[block]))
        slopes = data["slopes"]
        return Floor(blocks, np.maximum(sigma, 1e-9),
                     slopes.reshape(3, len(slopes) // 3, -1))


def _effect_free(
    k: int, profile: Profile
) -> tuple[Mapping[str, np.ndarray], np.ndarray, np.ndarray]:
    """Return the view of the `k`-th unit, its moves, what is known of it: bus and warmth first."""
    model, spread = load_model_file(), load_spread()
    rng = np.random.default_rng([SEED, k])
    z, day = draw_fleet_unit(rng, model.actuator), draw_fleet_conditions(rng, spread)
    actuator, effects = fleet_unit(model, spread, z, day)
    record = simulate(profile, actuator=actuator, effects=effects, seed=k,
                      start_angle=day.start_angle, start=start_of(model.actuator, profile, z[-2:]))
    bus, warm = _known(record)
    return view(record), z, np.array([bus, warm, bus * bus, warm * warm, bus * warm, *z**2])


def _known(record: Record) -> tuple[float, float]:
    """Return bus and winding temperature as -1 to 1 of the kit's conditions."""
    c, nominal = load_spread().conditions, 2.0 * load_actuator().inverter.bus_voltage
    bus, warm = np.median(record.dc_bus[:, 1]), np.mean(record.winding_temperature[:, 1])
    middle = 0.5 * (c.temperature_least + c.temperature_most)
    return float((bus / nominal - 1.0) / c.bus), float(
        (warm - middle) / (c.temperature_most - middle))


def gap_of(unit: HiddenUnit, floor: Floor) -> tuple[float, str]:
    """Return the largest gap that is left of a hidden effect (noise floors), and its block.

    Of two effects that of the one which is seen worse, its name before the block.
    """
    shifts: dict[str, list[np.ndarray]] = {name: [] for name in unit.names}
    with on_kit(unit.kit):
        for k in range(PAIRS):
            for name, found in shifts.items():
                records = unit.both(SEED + k, name)
                one, other = (np.concatenate(list(view(record).values())) for record in records)
                found.append(one - other)
        where = _known(records[0])
    slopes = floor.sensitivity(*where)
    place = np.zeros(len(slopes)) if unit.place is None else np.clip(
        np.where(of_day(len(slopes)), 0.0, unit.place), -1.0, 1.0)
    gaps = []
    for name, found in shifts.items():
        beside = [np.mean(other, axis=0) for at, other in shifts.items() if at != name]
        gap, block = largest_gap(found, floor, slopes, place, beside)
        gaps.append((gap, f"{name}: {block}" if beside else block))
    return min(gaps)


def largest_gap(
    shifts: Sequence[np.ndarray], floor: Floor, sensitivity: np.ndarray, place: np.ndarray,
    beside: Sequence[np.ndarray] = (),
) -> tuple[float, str]:
    """Return what recalibration leaves of a shift in its worst block, and the block's name.

    Parameters
    ----------
    shifts : of repeats, shape (numbers,) each.
    sensitivity : ndarray, shape (free, numbers).
    place : ndarray, shape (free,). Where the unit is in its bands, -1 to 1.
    beside : shifts by other effects, shape (numbers,) each, of which any share may be had.
    """
    halves = [np.mean(shifts[k::2], axis=0) / floor.sigma for k in range(2)]
    slopes = np.vstack([sensitivity, *beside]).T / floor.sigma[:, None]
    free = np.full(len(beside), np.inf)
    low = np.append(np.minimum(-1.0 - place, -1e-9), -free)
    high = np.append(np.maximum(1.0 - place, 1e-9), free)
    # The recalibration takes away what the bands can give back.
    fit = lsq_linear(slopes, 0.5 * (halves[0] + halves[1]), bounds=(low, high))
    left = [half - slopes @ fit.x for half in halves]
    energy = {name: float(np.mean(left[0][s] * left[1][s])) for name, s in floor.blocks.items()}
    worst = max(energy, key=lambda name: energy[name])
    return float(np.sqrt(max(0.0, energy[worst]))), worst
