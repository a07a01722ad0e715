"""Several records of one unit judged together, on linear units."""

import weakref
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from fleet_unit import (
    BASE,
    FEATURES,
    MODEL,
    OF_DAY,
    SIZE,
    STRANGE,
    TOLD,
    effects_of,
    features_of,
    judged,
    run,
    two_days_of,
    unit,
)
from scipy.optimize import lsq_linear

from ema_identification.actuator import gap
from ema_identification.actuator.decision import fit
from ema_identification.actuator.decision.answer import order_of, stages_of
from ema_identification.actuator.decision.decide import decide
from ema_identification.actuator.decision.intervals import measured
from ema_identification.actuator.decision.joint import DAYS, joint_unit
from ema_identification.actuator.decision.proposals import scores
from ema_identification.actuator.fleet import kept as kept_module
from ema_identification.actuator.fleet.surrogate import LARGEST_RESIDUAL
from ema_identification.actuator.laws.catalogue import Signature, variants
from ema_identification.actuator.laws.terms import EffectTerm, LawGap, Posterior, with_terms
from ema_identification.actuator.measure.tolerances import RecordConditions
from ema_identification.actuator.words import reasons_of
from ema_sim.machine import TURN

ROW = np.array(RecordConditions().row())
ASIDE = 480
two_days = partial(two_days_of, 15)


def record_of(library, seed, z, **sizes):
    """Return a test of a unit."""
    values = features_of(z, effects_of(**sizes)) + np.random.default_rng(
        [seed, 16]).normal(size=FEATURES)
    return fit.TestedUnit(
        library=library, values=values, seed=seed, simulator=run,
        conditions=RecordConditions(measured=frozenset({"temperature", "bus"})))


@pytest.fixture(scope="module")
def libraries():
    """Return the libraries of two tests whose healthy units are the same."""
    found = []
    for day in (0, 1):
        rows = [record_of(judged(), 1000 * day + k, two_days(k)[day]).values for k in range(ASIDE)]
        found.append(replace(judged(), aside=(np.tile(ROW, (ASIDE, 1)), np.array(rows))))
    return found


@pytest.fixture
def joint(libraries, tmp_path, monkeypatch):
    """Return a function that makes a unit of two records."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def make(seed, *, ranked=False, healthy=ASIDE, **sizes):
        known = [replace(x, aside=tuple(rows[:healthy] for rows in x.aside)) for x in libraries]
        return joint_unit([record_of(library, 7000 + 10 * seed + day, z, **sizes)
                           for day, (library, z) in enumerate(zip(known, two_days(seed)))],
                          scored=scores if ranked else None)
    return make


def test_one_record_is_itself():
    one = unit(seed=3)
    assert joint_unit([one]) is one
    assert one.parts == (one,)


def test_what_a_healthy_unit_works_out_is_not_kept_while_others_are_ranked(
        libraries, tmp_path, monkeypatch):
    """Covariances of all features of two tests are 30 MB each, and there are 480 units."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    seen, most, said = list[weakref.ref](), 0, []

    def scored(one):
        nonlocal most
        seen.append(weakref.ref(one.whitener(0)))
        most = max(most, sum(ref() is not None for ref in seen))
        return scores(one)

    both = joint_unit([record_of(replace(x, aside=tuple(rows[:6] for rows in x.aside)), 3, z)
                       for x, z in zip(libraries, two_days(3))], scored,
                      progress=lambda what, share: said.append(share))
    assert both.library.healthy.shape == (6, 4)
    assert (len(seen), most) == (6, 1)
    assert said == [pytest.approx((k + 1) / 6) for k in range(6)]
    held = gap.HeldOut(unit=both, fitted=both)
    monkeypatch.setattr(gap, "quadratic_gap", lambda held, fitted, null: (
        seen.append(weakref.ref(fitted.whitener(0))) or LawGap(
            values=(float(sum(ref() is not None for ref in seen)),), healthy=np.zeros(1))))
    assert held.kept(None) == pytest.approx(1.0)


def test_numbers_of_the_unit_are_shared_and_those_of_the_day_are_not(joint):
    both = joint(9001)
    assert len(both.centre) == SIZE + DAYS
    assert both.day.sum() == 2 * DAYS
    z = np.random.default_rng(1).uniform(-0.5, 0.5, SIZE + DAYS)
    step = 1e-4 * np.eye(SIZE + DAYS)
    slope = both.slope(z)
    exact = np.array([(both.means((z + s)[None])[0] - both.means((z - s)[None])[0]) / 2e-4
                      for s in step]).T
    assert slope == pytest.approx(exact, abs=1e-6)
    assert not slope[FEATURES:, :SIZE][:, OF_DAY].any()
    assert not slope[:FEATURES, SIZE:].any()
    first, second = both.split(both.means(z[None])[0])
    assert len(first) == len(second) == FEATURES


def test_two_records_know_a_unit_better_than_one(joint):
    both = joint(9002)
    errors = []
    for one in (both.parts[0], both):
        found = one.without_law()
        errors.append(np.abs(found.z[:SIZE] - two_days(9002)[0])[TOLD & ~OF_DAY].mean())
    assert errors[1] < 0.9 * errors[0]
    assert both.without_law().cost / both.size == pytest.approx(1.0, abs=0.2)


def test_runs_of_one_record_tell_nothing_of_the_day_of_another(joint):
    widths = []
    for seed in range(9010, 9015):
        both = joint(seed)
        one = both.parts[0]
        of_one, of_both = (
            np.sqrt(np.diag(measured(u, u.without_law())[0].covariance)) for u in (
                one, both))
        widths.append(of_both[:SIZE][~OF_DAY] / of_one[~OF_DAY])
    assert np.mean(widths) == pytest.approx(np.sqrt(0.5), rel=0.1)


@pytest.mark.slow
def test_an_effect_is_named_on_two_records(joint):
    found = decide(joint(9003, ranked=True, backlash=1.5))
    assert found.verdict == "explained"
    assert found.fit.names == ("backlash",)
    assert found.fit.mean.shape == (2 * FEATURES,)


def test_the_gap_of_a_joint_record_is_ranked_among_joint_units(joint):
    both = joint(9004, healthy=40)
    held = gap.HeldOut(unit=both, fitted=both)
    found = held.gap([both.without_law()])
    assert found.healthy.shape == (40,)
    assert found.values[0] < 1.2 * found.healthy.max()
    assert found.rest[0].shape == (2 * FEATURES,)


def test_what_belongs_to_the_day_of_a_held_out_record_is_fitted_within_its_bands(joint):
    """All of it at once: a number at its bound leaves the others to be fitted beside it."""
    held = joint(9005).parts[1]
    z = np.where(OF_DAY, 0.0, two_days(9005)[0])
    held = replace(held, values=held.values + 6.0 * held.slope(z)[:, OF_DAY].sum(axis=1))
    root = np.full(FEATURES, 2.0)
    columns = held.slope(z)[:, OF_DAY] / 2.0
    rest = (held.values - held.means(z[None])[0]) / 2.0
    known = lsq_linear(np.vstack([columns, np.sqrt(fit.PRIOR) * np.eye(DAYS)]),
                       np.append(rest, np.zeros(DAYS)), bounds=(-1.0, 1.0)).x
    assert np.abs(known).max() == pytest.approx(1.0)
    there, found = gap._day_fitted(
        held, gap._Predicted(held, z, held.means(z[None])[0], np.ones(SIZE)), root)
    assert found == pytest.approx(rest - columns @ known, abs=1e-6)
    assert there == pytest.approx(np.where(OF_DAY, 0.0, z) + np.eye(SIZE)[:, OF_DAY] @ known,
                                  abs=1e-6)


def test_a_law_that_adds_to_a_number_of_the_day_may_move_it_by_two_days(joint):
    """The fit tells their sum; on another day the number may be at the other end of its band."""
    held = joint(9005).parts[1]
    load, offset = (gap._reach(held, replace(held.without_law(), terms=tuple(
        EffectTerm(variant=v, u=np.zeros(v.size), signature=None)
        for v in variants() if v.name == name))) for name in (
            "surface_load", "current_sensor_offset"))
    assert load[gap.LOAD] == 2.0 and np.delete(load, gap.LOAD).tolist() == [1.0] * (SIZE - 1)
    assert offset.sum() == SIZE + 3.0 and offset[OF_DAY].sum() == OF_DAY.sum() + 3.0
    assert (gap._reach(held, held.without_law()) == 1.0).all()


def test_a_law_that_acts_on_the_days_load_is_predicted_on_the_day_of_the_held_out_record(
    monkeypatch,
):
    """Else it would leave what it does to a load that the fitted records did not have."""
    load = gap.LOAD

    def loaded(_model, _spread, _fmap, z, _conditions, seed, effects):
        size = effects.load_dependent_friction.coefficient / 0.1
        return features_of(z, MODEL.effects) + 4.0 * size * z[load] * STRANGE + (
            np.random.default_rng(seed).normal(size=FEATURES))

    effects = effects_of(load_dependent_friction=1.0)
    day = 0.9 * np.eye(SIZE)[load]
    held = replace(unit(seed=3), simulator=loaded, values=loaded(
        None, None, None, day, None, 11, effects))
    (variant,) = (v for v in variants() if v.effect == "load_dependent_friction")
    law = EffectTerm(variant=variant, u=np.array([0.1]), signature=Signature(
        variant=variant, levels=(np.zeros(0),), values=(np.zeros((0, FEATURES)),)))
    nothing = fit.LawFit(terms=(), z=np.zeros(SIZE), mean=BASE, cost=1.0, runs=8,
                         slopes=np.zeros((FEATURES, SIZE)))
    right = replace(nothing, terms=(law,), slopes=np.zeros((FEATURES, SIZE + 1)))
    monkeypatch.setattr(gap.HeldOut, "healthy", np.ones(1))
    found = gap.HeldOut(unit=held, fitted=held).gap([nothing, right])
    assert found.values[0] > 8.0 and found.values[1] < 3.0


def test_where_something_lets_go_the_load_of_the_day_is_looked_for():
    """From some load on all is otherwise: slopes about a middling day lead away from the day."""
    load = gap.LOAD
    assert OF_DAY[load]

    def lets_go(_model, _spread, _fmap, z, _conditions, seed, effects):
        total = effects.load_dependent_friction.coefficient / 0.1 + z[load]
        return features_of(z, MODEL.effects) + np.random.default_rng(seed).normal(
            size=FEATURES) + (50.0 if total > 0.7 else 5.0 * total) * STRANGE

    effects = effects_of(load_dependent_friction=1.0)
    day = -0.4 * np.eye(SIZE)[load]
    held = replace(unit(seed=3), simulator=lets_go, values=lets_go(
        None, None, None, day, None, 11, effects))
    (variant,) = (v for v in variants() if v.effect == "load_dependent_friction")
    law = EffectTerm(variant=variant, u=np.array([0.1]), signature=Signature(
        variant=variant, levels=(np.zeros(0),), values=(np.zeros((0, FEATURES)),)))
    right = fit.LawFit(terms=(law,), z=np.zeros(SIZE), mean=BASE, cost=1.0, runs=8,
                       slopes=np.zeros((FEATURES, SIZE + 1)))
    near = gap._nearest_turn(held, right, 1.0)
    found = gap._best_day(near, right, bound=3.0)
    assert gap._off(near) > 2.0 * gap._off(found)
    assert found.z[load] == pytest.approx(-0.4, abs=0.1)
    assert gap._best_day(found, right, bound=3.0) is found
    nothing = replace(right, terms=(), slopes=right.slopes[:, 1:])  # has the same chance
    known = replace(held, simulator=lambda *given: lets_go(*given[:-1], effects))
    near = gap._nearest_turn(known, nothing, 1.0)
    assert gap._best_day(near, nothing, bound=3.0).z[load] == pytest.approx(-0.4, abs=0.1)


def test_a_model_that_cannot_be_run_on_a_held_out_record_is_as_far_off_as_can_be(joint):
    held = joint(9006).parts[1]
    nowhere, fine = np.full(FEATURES, np.nan), held.means(np.zeros((1, SIZE)))[0]
    found = gap._left(held, np.zeros((SIZE, SIZE)), [
        gap._Predicted(held, np.zeros(SIZE), mean, np.ones(SIZE)) for mean in (fine, nowhere)])
    assert found.values[1] == LARGEST_RESIDUAL > found.values[0]


def test_a_held_out_record_begins_in_any_turn_of_the_rotor():
    """Three pole pairs; an eccentricity is seen from the turn that fits best, whatever the day."""
    motor = MODEL.actuator.motor._replace(pole_pairs=3)
    library = judged()
    library = replace(library, model=MODEL._replace(
        actuator=MODEL.actuator._replace(motor=motor)))

    def simulator(_model, _spread, _fmap, z, conditions, _seed, effects):
        e = effects.rotor_eccentricity
        turned = e.angle - conditions.start_angle / 3.0
        return features_of(z, MODEL.effects) + 100.0 * e.zeta * (
            np.cos(turned) * BASE + np.sin(turned) * STRANGE)

    (shifted,) = (v for v in variants() if v.name == "rotor_eccentricity shifted")
    law = EffectTerm(variant=shifted, u=np.array([0.05, 0.0]), signature=Signature(
        variant=shifted, levels=((), ()), values=(np.zeros((0, FEATURES)),) * 2))
    z = np.zeros(SIZE)
    fitted = fit.LawFit(terms=(law,), z=z, mean=BASE, slopes=np.zeros((FEATURES, SIZE + 2)),
                        cost=1.0, runs=10)
    for turn in range(3):
        now = RecordConditions(start_angle=TURN * turn)
        effects = with_terms([law], MODEL.effects)
        day = np.where(OF_DAY, np.random.default_rng(turn).uniform(-1.0, 1.0, SIZE), 0.0)
        held = fit.TestedUnit(
            library=library, values=simulator(None, None, None, day, now, 0, effects),
            conditions=RecordConditions(), simulator=simulator)
        found = gap._nearest_turn(held, fitted, 1.0)
        assert found.mean == pytest.approx(
            simulator(None, None, None, found.z, now, 0, effects), abs=1e-9)
        assert found.z[TOLD] == pytest.approx(day[TOLD], abs=0.1)


def test_what_is_named_is_predicted_by_the_median_about_the_fit():
    """Where it bends that is not what the fit does; runs that run away count as any other."""
    own = int(np.flatnonzero(~OF_DAY)[0])

    def bends(_model, _spread, _fmap, z, _conditions, _seed, _effects):
        return BASE * (z[own] ** 2 if abs(z[own]) < 0.4 else 1e6)  # beyond two deviations

    point = fit.LawFit(terms=(), z=np.zeros(SIZE), mean=BASE, slopes=np.zeros((FEATURES, SIZE)),
                       cost=1.0, runs=10)
    known = Posterior(np.full(SIZE, 0.9), 0.04 * np.eye(SIZE))  # its middle leaves more
    held = replace(unit(seed=1), simulator=bends)
    nowhere = gap._Predicted(held, np.zeros(SIZE), 0.0 * BASE, np.ones(SIZE))
    mean = gap._expected(nowhere, point, known, 1.0).mean
    share = mean @ BASE / (BASE @ BASE)
    assert mean == pytest.approx(share * BASE) and 0.008 < share < 0.045  # 0.018 expected
    lost = replace(held, simulator=lambda *_: np.full(FEATURES, np.nan))
    assert gap._expected(nowhere._replace(unit=lost, mean=BASE), point, known, 1.0).mean is BASE


def test_what_healthy_units_leave_is_kept_and_judged_by_the_first_ones(
    libraries, tmp_path, monkeypatch,
):
    """Other code that finds the same keeps it, in the kit's folder or the cache; else all anew."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(kept_module, "kit_path", lambda _: tmp_path / "kit")
    asked = []

    def scored(x, factor=1.0):
        asked.append(x)
        return (factor * x,)

    def kept(factor=1.0, folder=None):
        asked.clear()
        rows = kept_module.kept_of(libraries, "gaps1", [1.0, 2.0, 3.0, 4.0, 5.0],
                                   lambda x: scored(x, factor), folder)
        return rows[:, 0].tolist(), len(asked)

    assert kept(folder=tmp_path / "kit") == ([1.0, 2.0, 3.0, 4.0, 5.0], 5)
    assert kept() == ([1.0, 2.0, 3.0, 4.0, 5.0], 0)
    monkeypatch.setattr(kept_module.cache, "key_of", lambda *_, **__: "other code")
    assert kept(1.001) == ([1.0, 2.0, 3.0, 4.0, 5.0], kept_module.AGAIN)
    assert kept(1.001) == ([1.0, 2.0, 3.0, 4.0, 5.0], 0)  # asked once
    monkeypatch.setattr(kept_module.cache, "key_of", lambda *_, **__: "a third code")
    assert kept(1.1)[1] == kept_module.AGAIN + 5
    assert kept(1.1)[0][4] == pytest.approx(5.5)


def test_two_effects_are_told_in_the_order_of_what_they_close():
    answer = decide(unit(seed=3, viscous_friction=1.0, backlash=3.0))
    assert len(answer.alone) == 2
    first, second = (answer.fit.names[k] for k in order_of(answer))
    assert (first, second) == ("backlash", "viscous_friction")
    costs = [f.cost for f in stages_of(answer)]
    assert costs == sorted(costs, reverse=True)
    assert [f.names for f in answer.alone] == [(n,) for n in answer.fit.names]


def test_a_silence_beside_a_large_gap_says_that_it_is_not_sure():
    healthy = np.linspace(1.0, 3.0, 20)
    silent = decide(unit(seed=3))
    assert silent.verdict == "no disagreement"
    plain = reasons_of(silent, LawGap(values=(2.9,), healthy=healthy))
    (*same, doubt) = reasons_of(silent, LawGap(values=(8.4,), healthy=healthy))
    assert plain == silent.reasons == tuple(same)
    assert "8.4 is beyond the 3 " in doubt
    assert "--baseline" in doubt
    named = decide(unit(seed=3, backlash=3.0))
    (said,) = reasons_of(named, LawGap(values=(8.4, 7.0), healthy=healthy))
    assert said == "backlash closes 100% of what the model leaves"
