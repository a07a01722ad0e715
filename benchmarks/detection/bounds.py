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
from scipy.optimize import brentq
from scipy.special import ndtri
from scipy.stats import chi2, ncx2

from ema_prognostics.robust.features import extract
from ema_record.channels import MOTOR_SPEED, PHASE_CURRENTS, REFERENCE_CURRENTS
from ema_record.files import new_file
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_sim.actuator import load_actuator
from ema_sim.effects.settings import effects_from_mapping
from ema_sim.parameters import Actuator
from ema_sim.simulate import simulate

FALSE_ALARMS, FOUND = 0.01, 0.90
USED = ("quarter_even_m", "full_even_m", "torque_", "gap_width", "gap_torque", "gap_load",
        "load_", "shaft_slope", "lag_", "rise_", "overshoot", "speed_full")
"""Beginnings of the names of the features that take part."""
DERIVED = "_over_"
"""In the names of those that are differences of others, left out."""
FOLDS = 6
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
    path: tuple[str, ...] = ()
    """Parameters of the actuator that it multiplies by 1 + u; deviations are added."""
    effects: tuple[str, ...] = ()
    """Or settings of effects that get the value."""


UNIT = (
    Unknown("resistance", 0.1, ("motor.phase_resistance",)),
    Unknown("inductance", 0.1, ("motor.phase_inductance",)),
    Unknown("back_emf", 0.03, ("motor.back_emf_constant",)),
    *(Unknown(f"back_emf_{p}", 0.005, (f"motor.back_emf_deviation_{p}",)) for p in "abc"),
    Unknown("motor_friction", 0.1, ("motor.dynamic_friction", "motor.static_friction")),
    Unknown("surface_friction", 0.1, ("surface.dynamic_friction", "surface.static_friction")),
    Unknown("inertia", 0.1, ("motor.inertia",)),
    Unknown("stiffness", 0.1, ("shaft.stiffness",)),
)
CONDITIONS = (
    Unknown("temperature", 55.0, effects=("winding_temperature.temperature",)),
    Unknown("bus", 0.1, effects=("bus_voltage_change.change",)),
    Unknown("load", 19.0, effects=("surface_load.constant",)),
    *(Unknown(f"gain_{p}", 0.01, effects=(f"current_sensor_gain.phase_{p}",)) for p in "abc"),
    *(Unknown(f"offset_{p}", 0.05, effects=(f"current_sensor_offset.phase_{p}",))
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


def shifted(actuator: Actuator, unknown: Unknown, value: float) -> Actuator:
    """Return `actuator` with one parameter (or some tied ones) moved."""
    for path in unknown.path:
        part, name = path.split(".")
        group = getattr(actuator, part)
        old = getattr(group, name)
        new = value if "deviation" in name else old * (1.0 + value)
        actuator = actuator._replace(**{part: group._replace(**{name: new})})
    return actuator


def needed_shift(directions: int = 1, freedoms: int = 1) -> float:
    """Return the shift (standard deviations) that is found at the stated rates.

    Parameters
    ----------
    directions : tests made at once; each may raise its part of the false alarms.
    freedoms : of a shift whose direction in the plane is not known; 1: known, one-sided.
    """
    rate = FALSE_ALARMS / directions
    if freedoms == 1:
        return float(ndtri(1.0 - rate) + ndtri(FOUND))
    limit = chi2.isf(rate, freedoms)
    return float(np.sqrt(brentq(lambda c: ncx2.sf(limit, freedoms, c) - FOUND, 1e-3, 400.0)))


def own_spread_bound(half: float) -> float:
    """Return the increase that stands out of a factor uniform within 1 ± `half`, exactly."""
    top = 1.0 + half * (1.0 - 2.0 * FALSE_ALARMS)
    low = 1.0 - half * (1.0 - 2.0 * (1.0 - FOUND))
    return top / low - 1.0


def runs(effects: dict[str, float | str], actuator: Actuator, seeds: Iterable[int]
         ) -> list[Record]:
    """Simulate one setting over seeds, at nominal noise."""
    profile = load_profile("extended")
    merged = {"winding_temperature.temperature": TEMPERATURE, **effects}
    parsed = effects_from_mapping(merged)
    return [simulate(profile, actuator=actuator, effects=parsed, seed=s) for s in seeds]


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
        self.records = runs({}, self.nominal, range(FIRST_SEED, FIRST_SEED + base_repeats))
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
        difference = self.features(runs(effects, actuator, seeds)) - self.base[:self.repeats]
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
        shift, error = self.derivative(
            dict.fromkeys(unknown.effects, value), shifted(self.nominal, unknown, value), 1.0
        )
        return np.where(np.abs(shift) > SIGNIFICANT * error, shift, 0.0)


def inverse_covariance(samples: np.ndarray) -> np.ndarray:
    """Return the inverse covariance, shape (d, d), freed of the bias of few samples."""
    n, d = samples.shape
    scale = samples.std(axis=0, ddof=1) + 1e-12
    correlation = np.cov(samples / scale, rowvar=False)
    unbiased = (n - d - 2) / (n - 1)  # of an inverse Wishart matrix
    return unbiased * np.linalg.inv(correlation) / np.outer(scale, scale)


def noise_bound(signature: np.ndarray, inverse: np.ndarray, shift: float, records: int) -> float:
    """Return the severity whose shift against the noise of `records` records is `shift`."""
    return float(shift * np.sqrt(records / (signature @ inverse @ signature)))


def projected_noise(
    samples: np.ndarray, spread: np.ndarray, signature: np.ndarray, records: int
) -> tuple[np.ndarray, float]:
    """Return the weights of the best linear test, and the noise's deviation under them.

    The deviation is that of samples that the weights were not made from, in `FOLDS` parts:
    otherwise weights for as many features as there are samples would seem free of noise.

    Parameters
    ----------
    samples : ndarray, shape (n, d). Repeats of one test.
    spread : ndarray, shape (d, d). Covariance of what is not known.
    signature : ndarray, shape (d,). The weights are scaled to give 1 with it.
    records : over which the noise counts.
    """

    def weights(chosen: np.ndarray) -> np.ndarray:
        total = records * np.cov(chosen, rowvar=False) + spread
        scale = np.sqrt(np.diag(total)) + 1e-12
        w = np.linalg.solve(total / np.outer(scale, scale), signature / scale) / scale
        return w / (w @ signature)

    squares = 0.0
    for k in range(FOLDS):
        out = np.arange(len(samples)) % FOLDS == k
        center = samples[~out].mean(axis=0)
        squares += float(np.sum(((samples[out] - center) @ weights(samples[~out])) ** 2))
    return weights(samples), float(np.sqrt(records * squares / len(samples)))


def linear_bound(
    signature: np.ndarray, samples: np.ndarray, conditions: np.ndarray, unit: np.ndarray,
    fault: Fault, draws: int = 200_000,
) -> float:
    """Return the severity that the best linear test finds against noise and uniform spreads.

    Parameters
    ----------
    signature : ndarray, shape (d,). Shift by severity.
    samples : ndarray, shape (n, d). Repeats of one test.
    conditions : ndarray, shape (m, d). Shift by each condition, at the edge of its spread.
    unit : ndarray, shape (k, d). Shift by each parameter of the unit; none: it is known from
        a baseline, which has noise and conditions of its own.
    fault : its directions and freedoms.
    """
    records = 1 if len(unit) else 2
    shifts = np.concatenate([*([conditions] * records), unit])
    weight, noise = projected_noise(samples, shifts.T @ shifts / 3.0, signature, records)
    rng = np.random.default_rng(990_001)
    score = noise * rng.standard_normal(draws)
    for shift in shifts @ weight:
        score += rng.uniform(-shift, shift, draws) if shift > 0 else rng.uniform(
            shift, -shift, draws)
    rate = FALSE_ALARMS / fault.directions
    found = float(np.quantile(score, 1.0 - rate) - np.quantile(score, 1.0 - FOUND))
    # A direction that is not known costs what it costs in Gaussian noise.
    known = needed_shift(fault.directions)
    return found * needed_shift(fault.directions, fault.freedoms) / known


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
        shift = needed_shift(fault.directions, fault.freedoms)
        found.append(Bound(
            fault=fault.name, noise=noise_bound(signature, inverse, shift, 2),
            conditions=linear_bound(signature, samples, conditions, none, fault),
            fleet=linear_bound(signature, samples, conditions, unit, fault),
            own_spread=None if half is None else own_spread_bound(half),
            target_baseline=fault.target[0], target_fleet=fault.target[1],
        ))
    return found


def print_table(title: str, found: list[Bound]) -> None:
    """Print the bounds beside the targets; percent, backlash in µrad."""
    print(f"\n{title}")
    print(f"{'fault':<22}{'noise':>9}{'conditions':>12}{'target':>9}{'fleet':>12}{'target':>9}"
          f"{'own ±10 %':>11}")
    scales = {f.name: f.scale for f in FAULTS}
    for b in found:
        s = scales[b.fault]
        own = f"{s * b.own_spread:.1f}" if b.own_spread is not None else "-"
        print(f"{b.fault:<22}{s * b.noise:>9.3g}{s * b.conditions:>12.3g}"
              f"{s * b.target_baseline:>9.3g}{s * b.fleet:>12.3g}{s * b.target_fleet:>9.3g}"
              f"{own:>11}")


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
