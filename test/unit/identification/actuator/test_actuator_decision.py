"""The decision on units that are linear: which names, how many, and when none."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from linear_unit import FEATURES, MODEL, UNITS, features_of, library, term, unit

from ema_identification.actuator.measure.tolerances import N_TOLERANCES, draw_tolerances
from ema_identification.actuator.naming import next_test
from ema_identification.actuator.naming.contest import Arena
from ema_identification.actuator.naming.criteria import Case
from ema_identification.actuator.naming.decision import decide, each_alone, with_second
from ema_identification.actuator.naming.estimates import estimate_again
from ema_identification.actuator.naming.gap import gap_of
from ema_identification.actuator.naming.optimiser import descend
from ema_identification.actuator.naming.proposal import challengers, pairs_of, propose, rescaled
from ema_identification.actuator.surrogate.calibration import scale_of
from ema_identification.actuator.surrogate.fit import Start, run_point
from ema_identification.actuator.surrogate.likelihood import LAST_RUNS, recalibrate
from ema_identification.actuator.surrogate.screening import (
    bounded_gains,
    residual,
    screen_catalogue,
)

VISCOUS, BACKLASH = UNITS["viscous_friction", "coefficient"], UNITS["backlash", "increase"]


def names(fit):
    return {t.variant.effect for t in fit.terms}


def arena_of(ev):
    return Arena(ev, recalibrate(ev))


def case_of(ev):
    arena = arena_of(ev)
    return Case(arena, None, 0.0, 0.0, ())


def fitted(arena, name, u):
    (found,) = arena.fits([Start((term(name, u),), np.zeros(N_TOLERANCES))], first=2)
    return found


@pytest.mark.parametrize(("hidden", "verdict", "expected"), [
    ({}, "no disagreement", set()),
    ({"viscous_friction": 1.0}, "explained", {"viscous_friction"}),
    ({"viscous_friction": 0.4}, "explained", {"viscous_friction"}),
    ({"viscous_friction": 1.0, "backlash": 2.0}, "explained", {"viscous_friction", "backlash"}),
    ({"strange": 2.0}, "unknown effect", set()),
])
def test_what_is_hidden_is_decided(hidden, verdict, expected):
    ev = unit(**hidden)
    found = decide(ev, recalibrate(ev))
    assert found.verdict == verdict
    assert (set() if found.fit is None else names(found.fit)) == expected
    for t in () if found.fit is None else found.fit.terms:
        (field,) = (f for e, f in UNITS if e == t.variant.effect)
        size = UNITS[t.variant.effect, field] * hidden[t.variant.effect]
        assert t.u[0] == pytest.approx(size, rel=0.1)


def test_a_name_that_is_left_out_is_not_given():
    ev = unit(viscous_friction=1.0)
    found = decide(ev, recalibrate(ev), without=["viscous_friction"])
    assert found.verdict == "unknown effect"
    assert all("viscous_friction" not in names(f) for f in found.fits)


@pytest.mark.parametrize(("second", "expected"), [(0.0, 1), (2.0, 2)])
def test_a_second_effect_is_named_where_the_first_leaves_one(second, expected):
    ev = unit(viscous_friction=2.0, backlash=second)
    case = case_of(ev)
    found = with_second(case, [fitted(case.arena, "viscous_friction", VISCOUS)])
    assert len(found.fit.terms) == expected
    if expected == 2:
        assert max(found.p_value) < 1e-6
        assert [names(f) for f in found.alone] == [{"viscous_friction"}, {"backlash"}]


def test_each_effect_of_a_pair_alone_leaves_the_other_one():
    ev = unit(viscous_friction=1.0, backlash=2.0)
    case = case_of(ev)
    (pair,) = case.arena.fits([Start(
        (term("viscous_friction", VISCOUS), term("backlash", 2.0 * BACKLASH)),
        np.zeros(N_TOLERANCES))], first=2)
    alone = each_alone(case, pair)
    assert [names(f) for f in alone] == [{"backlash"}, {"viscous_friction"}]  # the larger first
    assert case.complete(pair)
    assert not case.complete(alone[0])
    assert case.helps(pair, alone)
    assert case.surely(pair, alone)
    assert case.distinct(pair, alone)


def test_an_imitation_in_a_crowd_does_not_stand_out():
    case = SimpleNamespace(usual=100.0, arena=SimpleNamespace(null_cost=2000.0))
    fits = [SimpleNamespace(cost=c, terms=(term(n, 0.0),)) for n, c in (
        ("viscous_friction", 200.0), ("backlash", 900.0), ("load_dependent_friction", 250.0))]
    assert Case.stands_out(case, fits[0], fits[1:2])
    assert not Case.stands_out(case, fits[0], fits[1:])  # another one leaves hardly more
    assert not Case.stands_out(case, SimpleNamespace(cost=801.0, terms=fits[0].terms), ())
    case.arena.null_cost = 400.0
    assert not Case.stands_out(case, fits[0], fits[1:2])  # little was explained


def test_the_largest_gain_is_that_of_what_is_hidden_and_tolerances_have_none():
    ev = unit(backlash=1.0)
    null = recalibrate(ev)
    found = screen_catalogue(ev, residual(ev, null.centre, null.mean, runs=null.runs))
    gains = bounded_gains(ev, null.centre, null.mean, null.runs, found)
    best = found[int(np.argmax(gains))]
    assert best.variant.effect == "backlash"
    assert best.u[0] == pytest.approx(BACKLASH, rel=0.2)
    proposal = propose(ev, null)
    assert proposal.gain == max(gains) > 300.0
    assert "backlash" in names(proposal.starts[0])
    plain = unit(z=np.full(N_TOLERANCES, 0.7))
    null = recalibrate(plain)
    found = screen_catalogue(plain, residual(plain, null.centre, null.mean, runs=null.runs))
    assert max(bounded_gains(plain, null.centre, null.mean, null.runs, found)) < 25.0


def test_challengers_are_the_effects_that_were_not_fitted_the_nearest_first():
    ev = unit(backlash=1.0)
    arena = arena_of(ev)
    found = challengers(ev, [fitted(arena, "viscous_friction", VISCOUS)])
    assert names(found[0]) == {"backlash"}
    tried = [n for start in found for n in names(start)]
    assert sorted(tried) == sorted({e for e, _ in UNITS} - {"viscous_friction"})


def test_other_sizes_lead_to_the_one_that_is_hidden():
    ev = unit(backlash=8.0)
    arena = arena_of(ev)
    found = rescaled(ev, arena.metrics[0], [fitted(arena, "backlash", 0.1 * BACKLASH)])
    sizes = [s.terms[0].u[0] for s in found[1:]]
    assert names(found[0]) == {"backlash"}
    assert min(abs(u - 8.0 * BACKLASH) for u in sizes) < 2.0 * BACKLASH


def test_pairs_hold_the_one_that_is_hidden_and_no_effect_twice():
    ev = unit(viscous_friction=2.0, backlash=2.0)
    arena = arena_of(ev)
    found = pairs_of(ev, [fitted(arena, "viscous_friction", VISCOUS)])
    assert names(found[0]) == {"viscous_friction", "backlash"}
    assert all(len(names(start)) == 2 for start in found)
    assert len({frozenset(names(start)) for start in found}) == len(found)


def test_a_descent_ends_at_the_lowest_point_of_a_linear_unit():
    z = np.full(N_TOLERANCES, 0.3)
    ev = unit(backlash=1.0, z=z)
    rule = arena_of(ev).metrics[-1]
    start = run_point(ev, (term("backlash", 0.3 * BACKLASH),), np.zeros(N_TOLERANCES),
                      runs=rule.runs, seed=0)
    end = descend(ev, rule, start, steps=6, seed=0)
    assert end.terms[0].u[0] == pytest.approx(BACKLASH, rel=0.1)
    cost, before = (rule.cost(ev, p.mean, p.z) for p in (end, start))
    assert cost < 1.2 * ev.size < before
    assert descend(ev, rule, end, steps=0, seed=0) is end


def test_the_gap_falls_to_the_floor_where_the_effect_is_there_and_grows_where_it_is_not():
    ev = unit(backlash=1.0)
    null, arena = recalibrate(ev), arena_of(ev)
    fit = fitted(arena, "backlash", BACKLASH)
    here = gap_of(ev, None, null, [fit], seed=0)
    assert not here.held
    assert here.values[1] < here.bound < here.values[0]
    rng = np.random.default_rng([1, 99])
    z = rng.uniform(-0.8, 0.8, N_TOLERANCES)
    same = gap_of(ev, unit(seed=2, backlash=1.0, z=z), null, [fit], seed=0)
    assert same.held
    assert same.values[1] <= same.bound < same.values[0]
    other = gap_of(ev, unit(seed=2, z=z), null, [fit], seed=0)
    assert other.values[1] > max(other.values[0], other.bound)


def test_an_estimate_again_holds_the_truth_and_costs_no_more():
    ev = unit(viscous_friction=2.0)
    arena = arena_of(ev)
    fit = fitted(arena, "viscous_friction", VISCOUS)
    found = estimate_again(ev, arena.last, fit, seed=3)
    deviation = float(np.sqrt(found.covariance[0, 0]))
    assert abs(found.terms[0].u[0] - 2.0 * VISCOUS) < 3.0 * found.inflation * deviation
    assert 0.0 < deviation < 0.1 * VISCOUS
    again = run_point(ev, fit.terms, np.clip(fit.z, -1.0, 1.0), runs=arena.last.runs, seed=3)
    assert found.cost <= arena.last.cost(ev, again.mean, again.z)


def test_the_scale_of_fresh_units_is_one_where_the_noise_is_as_assumed():
    own, rows = library(), []
    for k in range(24):
        rng = np.random.default_rng([5, k])
        z = draw_tolerances(rng)
        measured = features_of(z, MODEL.effects) + rng.normal(size=len(own.fmap.features))
        mean = features_of(z, MODEL.effects)
        rows.append(np.concatenate([measured, mean, z, [20.0, 0.0, 1.0, 0.0]]))
    found = scale_of(own, np.array(rows))
    assert np.median(found.factor) == pytest.approx(1.0, abs=0.1)
    left = (1.0 - N_TOLERANCES / FEATURES) / (1.0 + 1.0 / LAST_RUNS)  # the means have no noise
    assert np.exp(found.fit[0]) == pytest.approx(left, abs=0.1)
    assert 0.0 < found.gain[0] < 15.0
    loud = np.array(rows)
    loud[:, 0] += 5.0 * np.random.default_rng(0).normal(size=len(rows))
    assert scale_of(own, loud).factor[0] > 8.0


def test_no_command_is_proposed_where_none_would_tell_or_all_were_run():
    short, eccentric = (SimpleNamespace(
        terms=(SimpleNamespace(variant=SimpleNamespace(effect=name)),),
        effects=lambda base, values=values: base._replace(**values))
        for name, values in (
            ("turn_short", {"turn_short": MODEL.effects.turn_short._replace(fraction=0.04)}),
            ("rotor_eccentricity", {"rotor_eccentricity": MODEL.effects.rotor_eccentricity
                                    ._replace(zeta=0.027, mode=3, angle=np.pi)})))
    found = next_test.separating_test(unit(), [short, eccentric])
    assert found.profile is None
    assert "measure the resistance" in found.text
    ev = unit()
    points = [next_test.load_profile(name).points for name in next_test.PROFILES]
    blocks = tuple(replace(ev.blocks[0], record=SimpleNamespace(
        profile=SimpleNamespace(points=p))) for p in points)
    assert next_test.separating_test(replace(ev, blocks=blocks), [short, short]) is None
