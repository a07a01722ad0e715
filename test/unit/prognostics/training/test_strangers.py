"""What else befalls actuators: drawn for training, learned, and said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ema_prognostics.cascade.find import Cascade
from ema_prognostics.training.evaluation import outcome_of
from ema_prognostics.training.fleet import FleetFeatures, simulate_fleet
from ema_prognostics.training.strangers import KINDS, draw_stranger
from ema_prognostics.training.view_training import train_view
from ema_prognostics.verdict.report import verdict_of_guard
from ema_record.actuator import load_actuator
from ema_record.kit import using_kit
from ema_sim.effects import EFFECTS, parse_effects

MACHINES = Path(__file__).parents[4] / "benchmarks" / "any_actuator" / "machines"


@pytest.mark.parametrize("machine", ["", "valve_12v", "spoiler_270v"])
def test_every_stranger_is_an_effect_that_no_class_owns(machine: str) -> None:
    with using_kit(MACHINES / machine if machine else None):
        actuator = load_actuator()
        for name, draw in KINDS.items():
            rng = np.random.default_rng(3)
            for _ in range(20):
                effects = parse_effects(draw(actuator, rng))
                active = [e for e in EFFECTS.values()
                          if not e.is_neutral(getattr(effects, e.name))]
                assert len(active) == 1, name
                assert active[0].fault_class is None


def test_kinds_are_drawn_alike() -> None:
    rng = np.random.default_rng(5)
    drawn = [draw_stranger(rng).settings[0].partition(".")[0] for _ in range(1100)]
    counts = [drawn.count(name) for name in set(drawn)]
    assert len(counts) == len(KINDS)
    assert min(counts) > 60  # expected 100, six standard deviations are 57
    assert draw_stranger(rng).severity == {}


def shifted(fleet: FleetFeatures, name: str, by: float) -> FleetFeatures:
    """Return a fleet whose records have one feature off, in its own healthy spreads."""
    record = fleet.record.copy()
    k = fleet.names.index(name)
    record[:, k] += by * np.std(fleet.baseline[:, k])
    return replace(fleet, record=record)


@pytest.fixture(scope="module")
def fleets() -> tuple[FleetFeatures, FleetFeatures, FleetFeatures]:
    """Return small fleets; the strangers are healthy records whose inertia is off."""
    faults = simulate_fleet("step", 24, 31)
    healthy = simulate_fleet("step", 24, 32, healthy=True)
    return faults, healthy, shifted(simulate_fleet("step", 24, 33, healthy=True),
                                    "inertia_error", 12.0)


def test_a_stranger_is_told_and_the_verdict_says_why(
    fleets: tuple[FleetFeatures, FleetFeatures, FleetFeatures]
) -> None:
    faults, healthy, strange = fleets
    severity = np.zeros_like(faults.severity)
    rows = np.arange(len(faults))
    severity[rows, rows % 8] = 0.1
    severity[::9] = 0.0
    part = train_view(replace(faults, severity=severity, unit=rows), healthy, "step", "fleet",
                      seed=1, strangers=strange, hidden=4, iterations=30)
    cascade, without = Cascade(part), Cascade(part.model_copy(update={"strangers": None}))
    odd, sound = cascade.find(strange.record), cascade.find(healthy.record)
    assert np.mean([d.stranger > 1.0 for d in odd]) > 0.8
    assert np.mean([d.stranger > 1.0 for d in sound]) < 0.1
    assert all(d.stranger == 0.0 for d in without.find(strange.record))
    assert all(d.stranger == 0.0 for d in cascade.find(strange.record, exact=False))
    told = next(d for d in odd if d.stranger > 1.0)
    told = replace(told, guard=np.zeros_like(told.guard))  # what the network alone says
    assert outcome_of(told) == "unknown"
    assert told.known < 0.5
    verdict = verdict_of_guard(cascade, told)
    assert verdict is not None
    assert verdict.outcome == "unknown"
    assert "weak magnets" in " ".join(verdict.reasons)
    assert verdict.reasons[-1].startswith("next: ")
    assert verdict_of_guard(cascade, told, 1.25) is None  # the guard of the baseline judges
