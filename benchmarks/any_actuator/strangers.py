"""Whether anything could tell a stranger from what the kit knows: a bound beside the guard.

Of healthy tests of the type the features have covariance Σ; a stranger moves them by s, each known
fault k by a multiple of f_k. A detector that knew the stranger beforehand, and its size, could at
best tell it by the distance d² = min over a of (s − F a)ᵀ Σ⁻¹ (s − F a), healthy alone with a = 0
(Neyman and Pearson 1933; the faults that might be there instead are nuisance). It finds the part
Φ(d − z(1 − u)) where u of the known may be called unknown. One that knew all of them and their
sizes, but not which one comes, has to share u: the most that it finds of them on average is by the
likelihood ratio of their mixture, here as often as in the benchmark. The guard knows no stranger's
size, so it finds less. Shifts are means over pairs of runs of one unit, with and without. Units
are those of the type, as if it were known, or as commissioned, of what the records leave open of
it.

    python -m benchmarks.any_actuator.strangers KIT...
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from rich.console import Console
from threadpoolctl import threadpool_limits

from benchmarks.any_actuator.cases import SENSOR_FAULTS, STRANGERS, usual_sizes
from benchmarks.any_actuator.machines import load_machine, machine_names
from benchmarks.any_actuator.stages import TESTED
from benchmarks.detection.report import make_table
from ema_prognostics.cascade.model_file import load_model
from ema_prognostics.features.extract import extract
from ema_prognostics.training.conditions import actuator_of, draw_conditions, draw_unit, effects_of
from ema_prognostics.training.faults import HEALTHY, InjectedFault
from ema_record.actuator import Actuator, load_actuator
from ema_record.errors import RecordError
from ema_record.kit import CASCADE, using_kit
from ema_record.profile import load_profile
from ema_record.spread import UnitTolerances, load_spread
from ema_sim.effects import Effects
from ema_sim.simulate import simulate

KIND, SEED = "extended", 660_000
UNKNOWN = 0.03
"""Part of the known records that may be called unknown: the requirement."""
LEAST_SPREAD = 1e-2
"""Floor of a feature's spread: what never varies in a simulation does in a machine."""
RIDGE = 1e-6
LEAST_UNITS = 4
"""Healthy tests a feature, for the covariance."""
STEP = 0.5
"""Size of the faults whose direction is taken, of the usual ones."""
GAIN = "current gain"
"""The one of the sensor faults: what a recorder without the third current hides."""
TESTS = TESTED.strangers + TESTED.sensor_faults
OFTEN = {**{name: len(range(k, TESTED.strangers, len(STRANGERS)))
            for k, name in enumerate(STRANGERS)}, GAIN: TESTED.sensor_faults // len(SENSOR_FAULTS)}
"""How often each comes in the benchmark."""
FARTHEST = 40.0
"""Distance beyond which a stranger is told whatever else there is."""
DRAWS = 400_000
"""Of healthy tests, for the limit of the likelihood ratio."""


def strangers_of(a: Actuator) -> dict[str, list[str]]:
    """Return the strangers of the benchmark as effects of the product's own simulator."""
    m, x = a.motor, a.surface
    speed, slew = a.control.speed_limit, a.slew_speed
    power = speed * (m.dynamic_friction + m.viscous_friction * speed) + slew * (
        x.dynamic_friction + x.viscous_friction * slew)
    found = {
        "cogging": [f"cogging_torque.amplitude={0.15 * m.dynamic_friction!r}",
                    f"cogging_torque.periods={6 * m.pole_pairs}"],
        "demagnetisation": ["torque_constant_drop.drop=0.15"],
        "sag": ["bus_voltage_sag.resistance="
                f"{min(0.05 * (2.0 * a.inverter.bus_voltage) ** 2 / power, 2.0)!r}"],
        "resistance": ["phase_resistance_imbalance.increase=0.5"],
        "hall": ["hall_misalignment.angle=0.1"],
        "mesh": ["gear_mesh_ripple.amplitude="
                 f"{0.2 * x.dynamic_friction / a.shaft.stiffness!r}"],
    }
    return {**{name: found[name] for name in STRANGERS},
            GAIN: ["current_sensor_gain.phase_a=0.1"]}


def known_of(a: Actuator) -> dict[str, list[str]]:
    """Return small faults of each known class, one for each direction that they may have."""
    size = {name: STEP * value for name, value in usual_sizes(a).items()}
    short, gap = size["turn_short"], size["rotor_eccentricity"]
    return {
        **{f"short {p}": [f"turn_short.fraction={short!r}", f"turn_short.phase={p}"]
           for p in "abc"},
        **{f"eccentricity {mode} {angle}": [
            f"rotor_eccentricity.zeta={gap!r}", f"rotor_eccentricity.mode={mode}",
            f"rotor_eccentricity.angle={angle}"]
           for mode in ("common", "shifted", "static") for angle in (0.0, 1.5708)},
        "motor friction": [f"motor_friction.increase={size['motor_friction']!r}"],
        "surface friction": [f"surface_friction.increase={size['surface_friction']!r}"],
        "backlash": [f"backlash.increase={size['backlash']!r}"],
    }


def _test(seed: np.random.SeedSequence, cases: list[list[str]], kit: Path,
          tolerances: UnitTolerances) -> np.ndarray | None:
    """Return the features of one unit in one test, healthy and with each case, (1 + cases, d)."""
    with using_kit(kit), threadpool_limits(limits=1):
        rng, nominal = np.random.default_rng(seed), load_actuator()
        unit, conditions = draw_unit(rng, tolerances), draw_conditions(
            rng, load_spread().conditions)
        rows = []
        try:
            for settings in ([], *cases):
                fault = InjectedFault(severity={}, settings=tuple(settings)) if settings else (
                    HEALTHY)
                record = simulate(
                    load_profile(KIND), actuator=actuator_of(nominal, unit, conditions),
                    effects=effects_of(nominal, unit, conditions, fault, Effects()),
                    seed=conditions.seed)
                rows.append(list(extract(record, KIND, nominal).values()))
        except RecordError:
            return None
    return np.array(rows)


def whitened_shifts(healthy: np.ndarray, shifts: np.ndarray, faults: np.ndarray,
                    more: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far shifts are from healthy, and from healthy or any fault, shape (k, d) each.

    Each has the length that the halves of the pairs have in common: the length of a mean holds
    its own error too, which at two deviations is as large. The inverse of a covariance that is
    estimated is too large by (n - 1)/(n - d - 2) (the mean of the inverse Wishart law).

    Parameters
    ----------
    healthy : ndarray, shape (n, d). Features of healthy tests.
    shifts : ndarray, shape (p, k, d). Of the strangers, in each pair of runs.
    faults : ndarray, shape (p, f, d). Of small faults, the same; their means are directions.
    more : ndarray, shape (d,). Standard deviation that the kit adds to each feature.
    """
    n, d = healthy.shape
    scale = np.maximum(np.sqrt(healthy.var(axis=0) + more**2), LEAST_SPREAD)
    covariance = np.cov((healthy / scale).T) + np.diag((more / scale) ** 2 + RIDGE)
    root = np.linalg.cholesky(np.linalg.inv(covariance) * (n - d - 2) / (n - 1))
    f = faults.mean(axis=0) / scale @ root

    def across(s: np.ndarray) -> np.ndarray:
        return np.asarray(s - (np.linalg.lstsq(f.T, s.T, rcond=None)[0].T @ f))

    found = []
    for of in (np.asarray, across):
        one, other, all_of_them = (
            of(s.mean(axis=0) / scale @ root) for s in (shifts[::2], shifts[1::2], shifts))
        length = np.sqrt(np.maximum((one * other).sum(axis=1), 0.0))
        found.append(all_of_them * (length / np.linalg.norm(all_of_them, axis=1))[:, None])
    return found[0], found[1]


def told_together(shifts: np.ndarray, often: np.ndarray, unknown: float) -> np.ndarray:
    """Return the part of each stranger that the best test of all of them tells, shape (k,).

    No test that calls `unknown` of the healthy tests finds more on average, since the likelihood
    ratio of a mixture is most powerful against it (Neyman and Pearson 1933).

    Parameters
    ----------
    shifts : ndarray, shape (k, d). In deviations that are independent.
    often : ndarray, shape (k,). How often each comes.
    unknown : part of the healthy tests that may be called unknown.
    """
    from scipy.special import logsumexp

    size = np.linalg.norm(shifts, axis=1)
    near = size < FARTHEST
    told = np.ones(len(shifts))
    if not near.any():
        return told
    # Coordinates within the strangers' span: all else is noise to every one of them.
    basis = np.linalg.svd(shifts[near], full_matrices=False)[2]
    at, half = shifts[near] @ basis.T, 0.5 * size[near] ** 2
    rng, weights = np.random.default_rng(SEED), np.log(often[near] / often[near].sum())

    def ratio(x: np.ndarray) -> np.ndarray:
        return np.asarray(logsumexp(x @ at.T - half + weights, axis=1))

    noise = rng.standard_normal((DRAWS, len(basis)))
    limit = np.quantile(ratio(noise), 1.0 - unknown)
    told[near] = [np.mean(ratio(noise[:DRAWS // 4] + one) > limit) for one in at]
    return told


def rows_of(kit: Path, units: int, pairs: int, jobs: int, *, commissioned: bool = False,
            unknown: float = UNKNOWN) -> list[list[str]]:
    """Return the rows of the table for one kit."""
    with using_kit(kit):
        a, discrepancy = load_actuator(), load_model().body.discrepancy.get(KIND)
        # Of a machine of this benchmark those of its units alone, as if its type were known.
        name = kit.parent.name
        described = name in machine_names() and not commissioned
        spread = load_machine(name).spread if described else load_spread()
        tolerances = spread.tolerances
    strangers, known = strangers_of(a), known_of(a)
    cases = [*strangers.values(), *known.values()]
    streams = np.random.SeedSequence(SEED).spawn(units + pairs)
    found = Parallel(n_jobs=jobs)(
        delayed(_test)(s, cases if k < pairs else [], kit, tolerances)
        for k, s in enumerate(streams))
    tests = [t for t in found if t is not None]
    paired = np.array([t for t in tests if len(t) > 1])
    shifts = paired[:, 1:] - paired[:, :1]
    healthy = np.array([t[0] for t in tests])
    if len(healthy) < LEAST_UNITS * healthy.shape[1]:
        raise SystemExit(f"{len(healthy)} healthy tests for {healthy.shape[1]} features: "
                         f"{LEAST_UNITS} times as many or more (--units)")
    more = np.zeros(healthy.shape[1]) if discrepancy is None else np.array(discrepancy.spread)
    found = whitened_shifts(
        healthy, shifts[:, :len(strangers)], shifts[:, len(strangers):], more)
    from scipy.stats import norm

    limit = norm.ppf(1.0 - unknown)
    often = np.array([OFTEN[name] for name in strangers])
    together = told_together(found[1], often, unknown)
    rows = [[kit.parent.name, name, *("> 99" if d > 99.0 else f"{d:.1f}" for d in both),
             *(f"{100 * norm.cdf(d - limit):.0f} %" for d in both), f"{100 * share:.0f} %"]
            for name, *both, share in zip(
                strangers, *(np.linalg.norm(s, axis=1) for s in found), together)]
    missed = float((1.0 - together) @ often)
    return [*rows, [kit.parent.name, f"not told of {TESTS}", "", "", "", "", f"{missed:.1f}"]]


def main() -> None:
    """Simulate and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("kit", nargs="+", type=Path)
    parser.add_argument("--units", type=int, default=1500)
    parser.add_argument("--pairs", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--commissioned", action="store_true",
                        help="units as the kit draws them, not as if the type were known")
    parser.add_argument("--unknown", type=float, default=UNKNOWN,
                        help="part of the known that may be called unknown")
    o = parser.parse_args()
    for kit in o.kit:
        if not (kit / CASCADE).is_file():
            parser.error(f"{kit}: no kit with trained networks: 'ema commission' makes one")
    table = make_table(f"strangers, {o.units + o.pairs} healthy tests, {o.pairs} pairs",
                       "kit", "stranger", "d, healthy", "d, known", "told, healthy",
                       "told, known", "together")
    for kit in o.kit:
        for row in rows_of(kit.resolve(), o.units, o.pairs, o.jobs,
                           commissioned=o.commissioned, unknown=o.unknown):
            table.add_row(*row)
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
