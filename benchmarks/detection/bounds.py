"""What physics allows: the smallest severity that any test of these features could find.

Found means: 90 % of records announced at 1 % false alarms, each fault by itself. The features'
mean and covariance are taken from repeated simulations (noise, start angle), their derivatives
by finite differences over common seeds. Three bounds:

* noise: the unit is known from one record of its own under the same conditions, so the noise
  counts twice (Neyman and Pearson's test of a known shift in Gaussian noise, the limit of
  Cramér and Rao);
* conditions: the same, but the two records differ in temperature, bus, load, sensor errors;
* fleet: no baseline; the unit's parameters are anywhere within their tolerances.

The last two use the best linear test and the true uniform spreads. A direction that is not
known (phase, angle) costs as many tests as there are directions, or degrees of freedom.

    python -m benchmarks.detection.bounds --out bounds.json
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from benchmarks.detection.detectability import (
    FALSE_ALARMS,
    FOUND,
    inverse_covariance,
    linear_bound,
    needed_shift,
    noise_bound,
    own_spread_bound,
)
from benchmarks.detection.report import make_table
from benchmarks.units import UNIT_SPREAD, actuator_of
from ema_prognostics.features.extract import extract
from ema_record.actuator import Actuator, load_actuator
from ema_record.channels import MOTOR_SPEED, PHASE_CURRENTS, REFERENCE_CURRENTS
from ema_record.files import new_file
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_record.spread import UnitTolerances, load_spread
from ema_sim.effects.settings import effects_from_mapping
from ema_sim.simulate import simulate

USED = ("quarter_even_m", "full_even_m", "torque_", "gap_width", "gap_torque", "gap_load",
        "load_", "shaft_slope", "lag_", "rise_", "overshoot", "speed_full", "winding_back_emf")
"""Beginnings of the names of the features that take part."""
DERIVED = "_over_"
"""In the names of those that are differences of others, left out."""
FIRST_SEED = 990_000
PAPER_LEVEL, PAPER_RATE = 0.05, 1e6
PAPER_WINDOW = (0.06, 0.36)
"""The paper's noise: a part of the largest value in its window (s after the command)."""
SIGNIFICANT = 4.0
"""Standard errors below which a derivative by an unknown parameter counts as zero."""


class Fault(NamedTuple):
    """A fault: how it is injected with severity x, and how many directions it may have."""

    name: str
    effects: dict[str, float | str]
    """`x` stands for the severity."""
    severity: float
    """At which the derivative is taken."""
    directions: int
    freedoms: int
    target: tuple[float, float]
    """Of the issue: with own baseline, with the fleet model only."""
    own: str = ""
    """Parameter of the unit that the fault cannot be told from."""
    scale: float = 100.0


ECCENTRIC = {"rotor_eccentricity.zeta": "x", "rotor_eccentricity.angle": 0.7}
FAULTS = (
    *(Fault(f"turn_short_{mode}", {"turn_short.fraction": "x", "turn_short.mode": mode}, 0.02,
            3, 1, (0.005, 0.015)) for mode in ("paper", "physical")),
    *(Fault(f"eccentricity_{mode}", {**ECCENTRIC, "rotor_eccentricity.mode": mode}, 0.01,
            3 if mode == "paper" else 1, 2, (0.006, 0.008))
      for mode in ("paper", "common", "shifted")),
    Fault("motor_friction", {"motor_friction.increase": "x"}, 0.1, 1, 1, (0.05, 0.30),
          "motor_friction"),
    Fault("surface_friction", {"surface_friction.increase": "x"}, 0.2, 1, 1, (0.05, 0.30),
          "surface_friction"),
    Fault("backlash", {"backlash.increase": "x"}, 1.5e-4, 1, 1, (1.5e-4, 2e-4), scale=1e6),
)


class Unknown(NamedTuple):
    """A parameter that is uniform within ± `half` of nominal."""

    name: str
    half: float
    effects: tuple[str, ...] = ()
    """Settings of effects that get the value; none: `name` is one of `units.UNIT_SPREAD`."""


def _unlisted(t: UnitTolerances, a: Actuator) -> dict[str, tuple[str, str, float]]:
    """Return section, parameter and relative half width of what no record measures by itself."""
    grease = 0.5 * (t.viscous_factor - 1.0 / t.viscous_factor)
    return {
        "motor_viscous": ("motor", "viscous_friction", grease),
        "surface_viscous": ("surface", "viscous_friction", grease),
        "motor_static": ("motor", "static_friction", t.static_ratio),
        "surface_static": ("surface", "static_friction", t.static_ratio),
        "flat_top": ("motor", "flat_top", t.flat_top / a.motor.flat_top),
        "damping": ("shaft", "damping", t.damping),
        "hysteresis": ("inverter", "hysteresis", t.hysteresis),
        **{f"{n}_gain": ("control", f"{n}_gain", t.control_gain)
           for n in ("position", "proportional", "integral")},
    }


UNLISTED = _unlisted(load_spread().tolerances, load_actuator())
"""Spread of what grease, adjustment and shaping make of a type."""
UNIT = (*(Unknown(n, half) for n, half in UNIT_SPREAD.items() if n != "surface_inertia"),
        *(Unknown(n, half) for n, (_, _, half) in UNLISTED.items()))
CONDITIONS = (
    Unknown("temperature", 55.0, ("winding_temperature.temperature",)),
    Unknown("bus", 0.1, ("bus_voltage_change.change",)),
    Unknown("load", 19.0, ("surface_load.constant",)),
    *(Unknown(f"gain_{p}", 0.01, (f"current_sensor_gain.phase_{p}",)) for p in "abc"),
    *(Unknown(f"offset_{p}", 0.05, (f"current_sensor_offset.phase_{p}",))
      for p in "abc"),
)
TEMPERATURE = 15.0
"""Middle of −40 to +70 °C."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """Smallest severities that can be found, in the unit of the fault."""

    fault: str
    noise: float
    conditions: float
    fleet: float
    own_spread: float | None
    """Of the unit's own tolerance alone, exact; None where there is none."""
    target_baseline: float
    target_fleet: float


def runs(effects: dict[str, float | str], actuator: Actuator, seeds: Iterable[int]
         ) -> list[Record]:
    """Simulate one setting over seeds."""
    profile = load_profile("extended")
    merged = {"winding_temperature.temperature": TEMPERATURE, **effects}
    parsed = effects_from_mapping(merged)
    return [simulate(profile, actuator=actuator, effects=parsed, seed=s)
            for s in seeds]


def paper_noise(record: Record, rng: np.random.Generator, rate: float) -> Record:
    """Return `record` with the paper's 5 % noise, its level taken to hold at `rate` (1/s)."""
    samples = record.samples.copy()
    t = record.time - record.profile.command_time
    window = (t > PAPER_WINDOW[0]) & (t < PAPER_WINDOW[1])
    level = PAPER_LEVEL / np.sqrt(rate / record.rate)
    for columns in (slice(MOTOR_SPEED, MOTOR_SPEED + 1), PHASE_CURRENTS, REFERENCE_CURRENTS):
        block = samples[:, columns]
        block += rng.standard_normal(block.shape) * (level * np.abs(block[window]).max())
    return replace(record, samples=samples)


class Library:
    """Features of repeated runs: the noise's covariance, and derivatives."""

    def __init__(self, repeats: int, base_repeats: int) -> None:
        """Simulate the nominal unit; the rest when asked for."""
        self.nominal = load_actuator()
        self.repeats = repeats
        seeds = range(FIRST_SEED, FIRST_SEED + base_repeats)
        self.records = runs({}, self.nominal, seeds)
        first = extract(self.records[0], "extended")
        self.names = [n for n in first if n.startswith(USED) and DERIVED not in n]
        self.base = self.features(self.records)

    def features(self, records: Iterable[Record]) -> np.ndarray:
        """Return the features of records, shape (n, d)."""
        found = (extract(r, "extended", self.nominal) for r in records)
        return np.array([[f[n] for n in self.names] for f in found])

    def derivative(
        self, effects: dict[str, float | str], actuator: Actuator, step: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return mean difference / step and its standard error, shape (d,) each."""
        seeds = range(FIRST_SEED, FIRST_SEED + self.repeats)
        found = self.features(runs(effects, actuator, seeds))
        difference = found - self.base[:self.repeats]
        error = difference.std(axis=0, ddof=1) / np.sqrt(self.repeats)
        return difference.mean(axis=0) / step, error / abs(step)

    def signature(self, fault: Fault) -> np.ndarray:
        """Return the derivative by a severity, shape (d,)."""
        effects = {k: fault.severity if v == "x" else v for k, v in fault.effects.items()}
        return self.derivative(effects, self.nominal, fault.severity)[0]

    def sensitivity(self, unknown: Unknown) -> np.ndarray:
        """Return the shift by an unknown parameter at the edge of its spread, shape (d,)."""
        value = unknown.half
        if unknown.name == "temperature":
            value += TEMPERATURE
        if unknown.effects:
            actuator = self.nominal
        elif unknown.name in UNLISTED:
            section, name, _ = UNLISTED[unknown.name]
            part = getattr(self.nominal, section)
            part = part._replace(**{name: getattr(part, name) * (1.0 + value)})
            actuator = self.nominal._replace(**{section: part})
        else:
            actuator = actuator_of({unknown.name: value})
        shift, error = self.derivative(dict.fromkeys(unknown.effects, value), actuator, 1.0)
        return np.where(np.abs(shift) > SIGNIFICANT * error, shift, 0.0)


def bounds_at(
    samples: np.ndarray, signatures: dict[str, np.ndarray], unknown: dict[str, np.ndarray]
) -> list[Bound]:
    """Return the bounds of all faults for the noise of `samples`, shape (n, d)."""
    inverse = inverse_covariance(samples)
    conditions = np.array([unknown[u.name] for u in CONDITIONS])
    none = np.empty((0, samples.shape[1]))
    found = []
    for fault in FAULTS:
        signature = signatures[fault.name]
        # The unit's own deviation is the fault's, with the same signature.
        unit = np.array([u.half * signature if u.name == fault.own else unknown[u.name]
                         for u in UNIT])
        half = next((u.half for u in UNIT if u.name == fault.own), None)
        ways = {"directions": fault.directions, "freedoms": fault.freedoms}
        shift = needed_shift(**ways)
        found.append(Bound(
            fault=fault.name, noise=noise_bound(signature, inverse, shift, 2),
            conditions=linear_bound(signature, samples, conditions, none, **ways),
            fleet=linear_bound(signature, samples, conditions, unit, **ways),
            own_spread=None if half is None else own_spread_bound(half),
            target_baseline=fault.target[0], target_fleet=fault.target[1],
        ))
    return found


def print_table(title: str, found: list[Bound]) -> None:
    """Print the bounds beside the targets; percent, backlash in µrad."""
    table = make_table(title, "fault", "noise", "conditions", "target", "fleet", "target",
                       "own ±10 %")
    scales = {f.name: f.scale for f in FAULTS}
    for b in found:
        s = scales[b.fault]
        table.add_row(
            b.fault, *(f"{s * x:.3g}" for x in (b.noise, b.conditions, b.target_baseline, b.fleet,
                                                b.target_fleet)),
            "-" if b.own_spread is None else f"{s * b.own_spread:.1f}")
    Console(width=100).print(table)


def measured(repeats: int, base_repeats: int) -> tuple[
        list[str], dict[str, np.ndarray], dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return names, signatures of the faults, shifts by unknowns, and repeats by noise."""
    library = Library(repeats, base_repeats)
    signatures = {f.name: library.signature(f) for f in FAULTS}
    unknown = {u.name: library.sensitivity(u) for u in (*UNIT, *CONDITIONS)}
    rng = np.random.default_rng(FIRST_SEED)
    tables = {"nominal noise": library.base}
    for rate, text in ((PAPER_RATE, "5 % noise at 1 MS/s"), (20e3, "5 % noise at 20 kHz")):
        tables[text] = library.features(paper_noise(r, rng, rate) for r in library.records)
    return library.names, signatures, unknown, tables


def main() -> None:
    """Compute and print all bounds."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=32, help="runs a derivative")
    parser.add_argument("--base-repeats", type=int, default=200, help="runs of the nominal unit")
    parser.add_argument("--out", type=Path, help="JSON file with all numbers")
    options = parser.parse_args()
    begin = time.perf_counter()
    names, signatures, unknown, tables = measured(options.repeats, options.base_repeats)
    found = {title: bounds_at(samples, signatures, unknown)
             for title, samples in tables.items()}
    print(f"{len(names)} features, {options.base_repeats} runs of the nominal unit, "
          f"{options.repeats} a derivative; {FOUND:.0%} found at {FALSE_ALARMS:.0%} false alarms"
          "\npercent (of turns, air gap, friction); backlash in µrad")
    for title, table in found.items():
        print_table(title, table)
    print(f"\n{time.perf_counter() - begin:.0f} s")
    if options.out is not None:
        with new_file(options.out) as temporary:
            temporary.write_text(json.dumps({
                "features": names, "repeats": options.repeats,
                "base_repeats": options.base_repeats,
                "bounds": {t: [asdict(b) for b in table] for t, table in found.items()},
            }, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
