"""What else befalls actuators: drawn for training, learned, and said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ema_prognostics.cascade.classes import KINDS_FOUND
from ema_prognostics.cascade.find import Cascade
from ema_prognostics.cascade.guard import STRANGER_RATE, StrangerFilters
from ema_prognostics.training.evaluation import outcome_of
from ema_prognostics.training.faults import Stranger, draw_stranger, kinds_of
from ema_prognostics.training.fleet import FleetFeatures, simulate_fleets
from ema_prognostics.training.stranger_training import train_strangers
from ema_prognostics.training.view_training import train_view
from ema_prognostics.verdict.report import verdict_of_guard
from ema_record.actuator import load_actuator
from ema_record.kit import using_kit
from ema_sim.effects import EFFECTS, parse_effects

NAMES = [*(f"x{k}" for k in range(7)), "constants_unlike"]
MACHINES = Path(__file__).parents[4] / "benchmarks" / "any_actuator" / "machines"


@pytest.mark.parametrize("machine", ["", "valve_12v", "spoiler_270v"])
def test_every_stranger_is_an_effect_that_no_class_owns(machine: str) -> None:
    with using_kit(MACHINES / machine if machine else None):
        rng = np.random.default_rng(3)
        for _ in range(200):
            found = draw_stranger(rng)
            effects = parse_effects(found.settings)
            active = [e for e in EFFECTS.values() if not e.is_neutral(getattr(effects, e.name))]
            assert len(active) == 1, found
            assert active[0].fault_class is None
            assert found.severity == {}


def test_kinds_are_drawn_alike() -> None:
    rng = np.random.default_rng(5)
    drawn = [found.stranger.kind for found in (draw_stranger(rng) for _ in range(900))
             if found.stranger is not None]
    kinds = kinds_of(load_actuator())
    assert set(drawn) == set(kinds)
    assert min(drawn.count(name) for name in kinds) > 30  # 82 expected, less six deviations


def test_sign_and_phase_are_those_of_the_settings() -> None:
    rng = np.random.default_rng(6)
    seen = set()
    for _ in range(400):
        found = draw_stranger(rng)
        assert found.stranger is not None
        kind, sign, phase = found.stranger
        name, _, value = found.settings[0].partition("=")
        assert np.sign(float(value)) == sign
        if kind in {"current_gain", "current_offset"}:
            assert name.endswith("_abc"[phase + 1])
        elif kind == "phase_resistance":
            assert found.settings[1].endswith("=" + "abc"[phase])
        else:
            assert phase == 0
        seen.add((kind, sign, phase))
    assert len(seen) == 7 * 1 + 2 + 3 + 6 + 6


def turned(rows: np.ndarray) -> list[np.ndarray]:
    """Return rows as seen from each phase: three blocks of two, and two that are of no phase."""
    return [np.hstack([np.roll(rows[:, :6], -2 * k, axis=1), rows[:, 6:]]) for k in range(3)]


def test_filters_tell_as_much_as_the_best_linear_detector() -> None:
    """Scatter is known, so is the best distance: d² = s' C⁻¹ s (Fisher 1936)."""
    rng = np.random.default_rng(8)
    mixed = np.eye(8) + 0.9 * np.eye(8, k=1)[:, [0, 1, 2, 3, 4, 5, 7, 6]]
    root = np.kron(np.eye(4), mixed[:2, :2])  # alike for each phase
    shift = {"phase_resistance": np.array([1.0, -1.2, 0, 0, 0, 0, 0, 0]),
             "sag": np.array([0, 0, 0, 0, 0, 0, 0.8, 1.5])}

    def known(n: int) -> np.ndarray:
        return rng.standard_normal((n, 8)) @ root.T

    what = [Stranger("phase_resistance", (-1.0, 1.0)[k % 2], k % 3) for k in range(90)]
    what += [Stranger("sag")] * 60
    of_phase_a = np.array([3.0 * one.sign * shift[one.kind] for one in what])
    strange = known(150) + np.array([
        np.concatenate([np.roll(row[:6], 2 * one.phase), row[6:]])
        for row, one in zip(of_phase_a, what)])
    kinds = np.arange(4000) % len(KINDS_FOUND)
    part = train_strangers(NAMES, turned, known(4000), kinds, strange, what, known(4000),
                           known(4000), kinds)
    assert part is not None
    assert {name: (one.turns, one.both) for name, one in part.filters.items()} == {
        "phase_resistance": (3, True), "sag": (1, False), "current_scale": (1, False)}
    filters = StrangerFilters(part)
    kind = np.zeros(20_000, dtype=int)
    assert np.mean(filters(turned(known(20_000)), kind).score > 1.0) == pytest.approx(
        STRANGER_RATE, abs=0.002)
    healthy = turned(known(20_000))[0]
    for name, along in shift.items():
        best = np.linalg.norm(np.linalg.solve(root, along))
        for weights in np.array(part.filters[name].weights):
            distance = weights @ along / (healthy @ weights).std()
            assert 0.95 * best < distance < 1.02 * best
    for phase in range(3):
        moved = -2.5 * np.concatenate([np.roll(shift["phase_resistance"][:6], 2 * phase), [0, 0]])
        found = filters(turned(0.1 * known(50) + moved), kind[:50])
        assert set(found.kind) == {"phase_resistance"}
        assert (found.score > 1.0).all() and (found.rate < STRANGER_RATE).all()
    # No supply sags upwards; an input that nothing known moves tells by itself, upwards.
    last, alone = list(part.filters)[1:], np.array([0.0, 0, 0, 0, 0, 0, 0, 8.0])
    assert last == ["sag", "current_scale"]
    rows = 0.1 * known(50)
    found = np.arcsinh(filters.outputs(turned(rows + alone), 0)[:, 2])
    assert found == pytest.approx(8.0, abs=1.0)
    with np.errstate(all="raise"):  # however far off all other inputs are
        filters.outputs(turned(rows + 1e4 * np.array([1.0, 1, 1, 1, 1, 1, 1, 0])), 0)
    for k, less in ((1, -3.0 * shift["sag"]), (2, -alone)):
        assert (filters.outputs(turned(rows + less), 0)[:, k] == 0.0).all()


def test_where_a_fault_is_found_its_size_is_left_out() -> None:
    """A fault of any size scatters along its own direction: there no stranger can be told."""
    rng = np.random.default_rng(9)
    fault, stranger = np.array([0.0, 0, 0, 0, 0, 0, 1, 1]), np.array([0.0, 0, 0, 0, 0, 0, 2, 1])

    def records(kind: np.ndarray) -> np.ndarray:
        size = 20.0 * rng.uniform(size=(len(kind), 1)) * (kind[:, None] == 2)
        return rng.standard_normal((len(kind), 8)) + size * fault

    kind = np.repeat(np.arange(len(KINDS_FOUND)), 2000)
    strange = rng.standard_normal((60, 8)) + 3.0 * stranger
    part = train_strangers(NAMES, turned, records(kind), kind, strange, [Stranger("sag")] * 60,
                           records(np.zeros(4000, dtype=int)), records(kind), kind)
    assert part is not None
    healthy, mechanical = np.array(part.filters["sag"].weights)[[0, 2]]
    assert abs(mechanical @ fault) < 0.05 * abs(mechanical @ stranger)
    assert healthy @ fault > 0.5 * healthy @ stranger  # nothing is found: it is told in full
    filters = StrangerFilters(part)
    both = turned(records(kind) + 12.0 * stranger)
    assert (filters(both, kind).score > 1.0).mean() > 0.99
    known = filters(turned(records(kind)), kind).score > 1.0
    assert known.mean() < 2.0 * STRANGER_RATE


def shifted(fleet: FleetFeatures, name: str, by: float) -> FleetFeatures:
    """Return a fleet whose records have one feature off, in its own healthy spreads."""
    record = fleet.record.copy()
    k = fleet.names.index(name)
    record[:, k] += by * np.std(fleet.baseline[:, k])
    return replace(fleet, record=record,
                   strangers=(Stranger("weak_magnets"),) * len(fleet))


@pytest.fixture(scope="module")
def fleets() -> tuple[FleetFeatures, FleetFeatures, FleetFeatures]:
    """Return small fleets; the strangers are healthy records whose inertia is off."""
    faults = simulate_fleets(("step",), 24, 31)["step"]
    healthy = simulate_fleets(("step",), 24, 32, healthy=True)["step"]
    return faults, healthy, shifted(simulate_fleets(("step",), 24, 33, healthy=True)["step"],
                                    "inertia_error", 12.0)


@pytest.mark.slow
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
    told = replace(told, guard=np.zeros_like(told.guard))  # what the filters alone say
    assert outcome_of(told) == "unknown"
    assert told.known < 0.5
    assert told.stranger_kind == "weak_magnets"
    verdict = verdict_of_guard(cascade, told)
    assert verdict is not None
    assert verdict.outcome == "unknown"
    assert "weak magnets" in " ".join(verdict.reasons)
    assert verdict.reasons[-1].startswith("next: ")
    assert verdict_of_guard(cascade, told, 1.25) is None  # the guard of the baseline judges
