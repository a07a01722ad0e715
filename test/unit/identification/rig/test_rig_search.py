"""The search over laws on a bench whose laws are known: added, located, given up."""

from dataclasses import replace

import numpy as np
import pytest

from ema_identification.rig.fit.balance import Design
from ema_identification.rig.fit.known import known_balance
from ema_identification.rig.fit.model import DEFAULT_MODEL, Settings
from ema_identification.rig.fit.regression import autocorrelation, fit, make_blocks
from ema_identification.rig.laws import LAWS
from ema_identification.rig.laws.base import Term
from ema_identification.rig.prepare import prepare
from ema_identification.rig.search.remainder import main_shape, mimics, portrait
from ema_identification.rig.search.search import forward
from ema_identification.rig.search.selection import Look, located, prune
from ema_identification.rig.search.shapes import (
    freest_columns,
    smooth_shapes,
    waves_in_time,
)

FEW = {"coulomb_friction", "offset", "quadratic_drag", "spring", "drive_lag"}


def known(record):
    """Return the default model's balance on a record, what the search looks with, and shapes."""
    design = Design(prepare([record], Settings()))
    start, _ = known_balance(DEFAULT_MODEL, design)
    shapes = smooth_shapes(design.trajectory)
    freest = freest_columns(start.columns, shapes)
    blocks = make_blocks(design.trajectory, fit(freest, design.trajectory.target).residual)
    look = Look(blocks=blocks, hidden=frozenset(), report=lambda _line: None, smooth=shapes,
                freest=freest)
    return start, look, shapes


@pytest.mark.parametrize("level", [0.5, 0.0])
def test_the_law_that_is_hidden_is_added_and_none_to_noise(bench, level):
    start, look, _ = known(bench(lambda t, q, v, a: level * np.sign(v), duration=8.0))
    look = replace(look, hidden=frozenset(LAWS) - {*start.names, *FEW})
    stages, choices, _, dropped = forward(start, look)
    assert stages[0] is start
    assert [c.trial.name for c in choices] == ["coulomb_friction"] * (level > 0.0)
    assert len(stages) == 1 + len(choices)
    assert dropped == []


@pytest.mark.parametrize(("lag", "expected"), [(0.05, True), (0.0, False)])
def test_a_lag_is_located_where_it_is_and_not_where_its_interval_holds_none(bench, lag, expected):
    def behind(t, q, v, a):  # the input that a drive needs that follows it with this lag
        return lag * np.gradient(0.05 * a + 0.4 * v, t)

    start, look, _ = known(bench(behind))
    joined = start.joined(Term(law=LAWS["drive_lag"]))
    assert located(joined, look.blocks) == expected
    friction = start.joined(Term(law=LAWS["coulomb_friction"]))
    assert located(friction, look.blocks)  # a law that filters nothing stands where it stands


def test_a_law_that_stands_in_for_a_nameless_shape_is_given_up(bench):
    def strange(t, q, v, a):  # of the speed, and no law: high at a middle speed only
        return 0.6 * np.sign(v) * np.exp(-((np.abs(v) - 1.8) / 0.35)**2)

    start, look, shapes = known(bench(strange))
    stand_in = start.joined(Term(law=LAWS["coulomb_friction"]))
    left = main_shape(portrait(stand_in, look.blocks, shapes))
    assert left.shape.against == "speed"
    assert mimics(stand_in, look.blocks, left, len(start.terms)) == [len(start.terms)]
    start, look, shapes = known(bench(lambda *x: 0.6 * np.sign(x[2]) + 0.2 * strange(*x)))
    real = start.joined(Term(law=LAWS["coulomb_friction"]))
    left = portrait(real, look.blocks, shapes)[0]
    assert mimics(real, look.blocks, left, len(start.terms)) == []


@pytest.mark.parametrize(("stiffness", "stays"), [(0.002, False), (0.1, True)])
def test_a_law_below_a_hundredth_of_the_input_is_pruned(bench, stiffness, stays):
    record = bench(lambda t, q, v, a: 0.5 * np.sign(v) + stiffness * q, noise=1e-5)
    start, look, _ = known(record)
    whole = start.joined(Term(law=LAWS["coulomb_friction"])).joined(
        Term(law=LAWS["spring"], shape=(0.0,)))
    without = np.sum(whole.without(len(start.terms) + 1).held_out(look.blocks)**2)
    assert without > 1.1 * np.sum(whole.held_out(look.blocks)**2)  # yet more than chance
    dropped = prune(whole, look.blocks, len(start.terms))
    assert [term.law.name for term in dropped] == ["spring"] * (not stays)


def test_a_law_that_stood_in_for_a_later_one_is_given_up(bench):
    def stops(t, q, v, a):
        return 0.5 * np.sign(v) + 3.0 * (q - np.clip(q, -0.7, 0.7))

    start, look, _ = known(bench(stops))
    look = replace(look, hidden=frozenset(LAWS) - {
        *start.names, "coulomb_friction", "hardening_spring", "end_stops"})
    stages, choices, _, _ = forward(start, look)
    assert sorted(c.trial.name for c in choices) == ["coulomb_friction", "end_stops"]
    assert np.isclose(abs(stages[-1].terms[-1].shape[1]), 0.7, atol=0.03) or np.isclose(
        abs(stages[-1].terms[-2].shape[1]), 0.7, atol=0.03)


def test_the_image_of_a_wave_that_the_motion_has_too_is_marked(axis, recorded):
    t = np.arange(12_000) / 400.0  # moves of 0.5 s with rests as long: rows at regular times
    rng = np.random.default_rng(3)
    s = (np.arange(200) + 0.5) / 200.0
    bell = (s * (1.0 - s))**3 / np.sum((s * (1.0 - s))**3) * 400.0
    v = np.concatenate([np.r_[rng.uniform(-1, 1) * bell, np.zeros(200)] for _ in range(30)])
    q, a = np.cumsum(v) / 400.0, np.gradient(v, 1 / 400.0)
    wave = np.sin(2 * np.pi * 2.3 * t)
    start, look, _ = known(recorded(t, 0.05 * a + 0.4 * v + 0.3 * wave, axis, position=q, speed=v))
    residual = start.fit.residual
    found = waves_in_time(start.design.trajectory, residual, look.freest)
    assert found[0].order == pytest.approx(2.3, abs=0.05)
    assert found[0].of_motion  # in the band of the moves
    images = [wave for wave in found[1:4] if abs((wave.order - 2.3) % 1.0 - 0.5) > 0.45]
    assert images
    assert all(wave.of_motion for wave in images)


def test_the_autocorrelation_is_that_of_its_definition():
    x = np.random.default_rng(0).normal(3.0, 1.0, 101)
    own = x - x.mean()
    found = autocorrelation(x, 5)
    assert found == pytest.approx([float(own[k:] @ own[:len(own) - k]) for k in range(5)])
