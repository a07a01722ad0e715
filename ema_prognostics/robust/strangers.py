"""Effects of the catalogue that are no class of ours: what the guard learns to turn away."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ema_prognostics.robust.campaign import Campaign
from ema_prognostics.robust.chunks import chunk_file, load_chunk, save_chunk
from ema_prognostics.robust.classes import OUTPUTS
from ema_prognostics.robust.conditions import (
    HEALTHY,
    Conditions,
    Unit,
    actuator_of,
    draw_conditions,
    draw_unit,
    effects_of,
)
from ema_prognostics.robust.features import Kind, extract
from ema_record.errors import RecordError
from ema_record.profile import load_profile
from ema_sim.actuator import load_actuator
from ema_sim.effects import Effects
from ema_sim.effects.settings import effects_from_mapping
from ema_sim.simulate import simulate

RANGES: dict[str, tuple[float, float, bool]] = {
    "cogging_torque.amplitude": (0.005, 0.1, False),
    "gear_mesh_ripple.amplitude": (1e-5, 1e-4, False),
    "speed_sensor_runout.amplitude": (2e-3, 2e-2, False),
    "hall_misalignment.angle": (0.02, 0.15, True),
    "control_delay.delay": (1e-4, 1e-3, False),
    "stribeck_friction.increase": (0.15, 1.0, False),
    "viscous_friction.coefficient": (3e-5, 5e-4, False),
    "load_dependent_friction.coefficient": (0.03, 0.3, False),
    "shaft_compliance.increase": (0.3, 3.0, False),
    "inertia_change.motor": (0.3, 1.5, False),
    "magnetic_saturation.inverse_current": (0.01, 0.06, False),
    "back_emf_shape.fifth_harmonic": (0.02, 0.1, True),
    "back_emf_shape.flat_top_change": (0.1, 0.6, True),
    "phase_resistance_imbalance.increase": (0.2, 2.0, False),
    "position_sensor_offset.offset": (1e-3, 1e-2, True),
    "quantisation.speed_bits_lost": (2.0, 6.0, False),
    "quantisation.position_bits_lost": (2.0, 6.0, False),
    "torque_constant_drop.drop": (0.08, 0.4, False),
    "bus_voltage_sag.resistance": (0.3, 2.0, False),
    "inverter_voltage_drop.drop": (1.0, 8.0, False),
}
"""Least and largest size, drawn evenly in the logarithm, and whether of either sign."""
CHUNK = 10


def draw_stranger(rng: np.random.Generator) -> dict[str, float | str]:
    """Return the settings of a stranger."""
    names = list(RANGES)
    name = names[int(rng.integers(len(names)))]
    low, high, signed = RANGES[name]
    size = float(np.exp(rng.uniform(math.log(low), math.log(high))))
    if signed and rng.uniform() < 0.5:
        size = -size
    found: dict[str, float | str] = {name: size}
    if name == "phase_resistance_imbalance.increase":
        found["phase_resistance_imbalance.phase"] = "abc"[int(rng.integers(3))]
    return found


def _effects(unit: Unit, conditions: Conditions, settings: dict[str, float | str]) -> Effects:
    effects = effects_of(unit, conditions, HEALTHY)
    if not settings:
        return effects
    name = next(iter(settings)).partition(".")[0]
    strange = getattr(effects_from_mapping(settings), name)
    if name == "inertia_change":
        strange = strange._replace(motor=(1.0 + strange.motor) * (1.0 + unit.inertia) - 1.0)
    return effects._replace(**{name: strange})


def _pair(kind: Kind, seed: np.random.SeedSequence) -> tuple[dict[str, float], dict[str, float]]:
    """Return the features of a unit when new, and with a stranger; RecordError if none."""
    rng = np.random.default_rng(seed)
    unit, first, second = draw_unit(rng), draw_conditions(rng), draw_conditions(rng)
    nominal, found = load_actuator(), []
    settings: dict[str, float | str] = {}
    for conditions in (first, second):
        record = simulate(
            load_profile(kind), actuator=actuator_of(nominal, unit), seed=conditions.seed,
            effects=_effects(unit, conditions, settings), noise=conditions.noise,
        )
        found.append(extract(record, kind, nominal))
        settings = draw_stranger(rng)
    return found[0], found[1]


def _run(
    kind: Kind, seeds: list[np.random.SeedSequence], file: Path | None
) -> list[tuple[dict[str, float], dict[str, float]]]:
    from threadpoolctl import threadpool_limits

    kept = load_chunk(file)
    if kept is not None:
        return [(base, tests[0][1]) for base, tests in zip(*kept)]
    found = []
    with threadpool_limits(limits=1):
        for seed in seeds:
            try:
                found.append(_pair(kind, seed))
            except RecordError:
                continue  # the diagnosis answers "unknown" to such a record
    save_chunk(file, [base for base, _ in found], [[(0, later)] for _, later in found])
    return found


def run_strangers(
    kind: Kind, units: int, seed: int, *, jobs: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None, folder: Path | None = None,
) -> Campaign:
    """Simulate `units` units, new and with a stranger; parameters as of `run_campaign`."""
    from joblib import Parallel, delayed

    streams = np.random.SeedSequence([seed, 2]).spawn(units)
    parts = [(streams[i:i + CHUNK],
              chunk_file(folder, (kind, seed, "strangers", sorted(RANGES.items()), i)))
             for i in range(0, units, CHUNK)]
    found, done = [], 0
    for part in Parallel(n_jobs=jobs, return_as="generator")(
            delayed(_run)(kind, *p) for p in parts):
        found += part
        done = min(done + CHUNK, units)
        progress(done, units)
    names = tuple(found[0][0])
    base, record = (np.array([[pair[k][n] for n in names] for pair in found]) for k in (0, 1))
    return Campaign(
        names=names, baseline=base, record=record,
        severity=np.zeros((len(found), len(OUTPUTS))), unit=np.arange(len(found)),
    )
