"""The decision in one likelihood on units that are linear: its level, power, sets, intervals."""

from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from fleet_unit import (
    ADDED,
    BASE,
    FEATURES,
    HEALTHY,
    MODEL,
    OF_DAY,
    SIZE,
    SLOPES,
    TOLD,
    UNITS,
    effects_of,
    features_of,
    judged,
    p_of,
    plain_library,
    run,
    unit,
)
from scipy.stats import binom

from ema_identification.actuator import gap
from ema_identification.actuator.decision import decide as decision
from ema_identification.actuator.decision import models
from ema_identification.actuator.decision.answer import FleetAnswer, log_evidence
from ema_identification.actuator.decision.decide import EDGE, MOST, OUT, decide
from ema_identification.actuator.decision.fit import units_aside
from ema_identification.actuator.decision.intervals import at, p_sizes
from ema_identification.actuator.decision.proposals import LawProposal, at_known_sizes
from ema_identification.actuator.decision.ranks import LEVEL, both_of, p_nothing, rank, share_of
from ema_identification.actuator.decision.slopes import law_slopes
from ema_identification.actuator.fleet.surrogate import SETTLED_RUNS, Whitener, excess
from ema_identification.actuator.fleet.units import CHUNK, FULL, fleet_unit
from ema_identification.actuator.laws.catalogue import variants
from ema_identification.actuator.laws.terms import EffectTerm, LawFit, LawGap, Posterior
from ema_identification.actuator.library.build import fleet_library
from ema_identification.actuator.measure.tolerances import RecordConditions
from ema_identification.actuator.words import candidates_of, parameters_of, recalibrated_of
from ema_record.profile import load_profile
from ema_record.spread import load_spread
from ema_sim.model_file import load_model_file

VISCOUS = UNITS["viscous_friction", "coefficient"]
(SIGNATURE,) = (s for s in plain_library().signatures if s.variant.name == "viscous_friction")


def test_rank_of_exchangeable_scores_is_uniform():
    rng = np.random.default_rng(1)
    found = np.array([rank(s[0], s[1:]) for s in rng.normal(size=(4000, 100))])
    for level in (0.01, 0.05, 0.5):
        share = (found <= level).mean()  # exactly floor(101 level) / 101 of them
        assert share == pytest.approx(np.floor(101 * level) / 101, abs=4 * np.sqrt(level / 4000))


def test_nineteen_of_twenty_libraries_keep_the_level():
    """Not only the mean of all libraries that might have been drawn."""
    healthy = np.sort(np.random.default_rng(2).uniform(size=(4000, 480)))
    allowed = max(k for k in range(5) if share_of(k, 480) <= LEVEL)
    shares = 1.0 - healthy[:, -1 - allowed]  # of healthy units beyond the last that is tolerated
    kept = (shares <= LEVEL).mean()
    assert 0.94 < kept < 0.97
    assert shares.mean() > 0.2 * LEVEL


def test_as_many_units_are_ranked_as_the_level_asks_for():
    """The fewest, in whole chunks, of which the second still proves it."""
    assert share_of(1, FULL.set_aside) <= LEVEL < share_of(1, FULL.set_aside - CHUNK)


def test_looking_at_cost_gain_and_gap_is_paid_for():
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(2000, 100, 3)) @ np.array(
        [[1.0, 0.6, 0.3], [0.0, 0.8, 0.3], [0.0, 0.0, 0.9]])
    found = np.array([p_nothing(s[0], s[1:]) for s in rows])
    for level in (0.05, 0.1, 0.5):
        assert level - 0.15 <= (found <= level).mean() <= level


@pytest.mark.parametrize("k", [0, 1, 2])
def test_one_score_far_beyond_all_healthy_units_is_enough(k):
    """Whichever it is: the others may be usual."""
    healthy = np.random.default_rng(3).exponential(size=(480, 3))
    score = np.full(3, 0.7)
    assert p_nothing(score, healthy) > 0.2
    score[k] = 50.0
    assert p_nothing(score, healthy) == share_of(0, 480) <= LEVEL


@pytest.mark.slow
def test_level_of_nothing_on_healthy_units():
    found = np.array([p_of(unit(seed=k)) for k in range(120)])
    assert (found <= 0.05).sum() <= 14  # at most 6 expected; the healthy ones scatter too
    assert (found <= LEVEL).sum() <= 4
    assert 0.35 < found.mean() < 0.7


@pytest.mark.slow
def test_a_unit_a_little_beyond_its_bands_lacks_nothing():
    """Bands are what people write down; far beyond them something is missing."""
    rng = np.random.default_rng(11)
    for bands, least, most in ((EDGE, 17, 20), (2.0, 0, 0)):
        units = [unit(seed=k, z=bands * rng.uniform(-1.0, 1.0, SIZE)) for k in range(20)]
        assert least <= sum(p_of(replace(u, edge=EDGE)) > LEVEL for u in units) <= most
        said = [decide(u).verdict for u in units[:6]]
        assert ("no disagreement" in said, "explained" in said) == (most > 0, False)


@pytest.mark.slow
def test_an_effect_of_a_unit_a_little_beyond_its_bands_is_named_alone():
    """No number that is beyond its band is a second effect."""
    beyond = 0
    for seed in range(3, 9):
        z = EDGE * np.random.default_rng(seed).uniform(-1.0, 1.0, SIZE)
        found = decide(unit(seed=seed, z=z, backlash=3.0))
        assert found.verdict == "explained"
        assert found.fit.names == ("backlash",)
        beyond += OUT in found.reasons
    assert beyond > 0


@pytest.mark.slow
def test_likelihood_is_to_scale_on_healthy_units():
    units = [unit(seed=300 + k) for k in range(60)]
    fits = [u.without_law() for u in units]
    assert np.mean([f.cost for f in fits]) / FEATURES == pytest.approx(1.0, abs=0.08)
    runs = [u.settled(f, None, 8) for u, f in zip(units, fits)]
    assert np.mean([f.cost for f in runs]) / FEATURES == pytest.approx(1.0, abs=0.08)


@pytest.mark.slow
def test_larger_effects_are_never_less_surprising():
    found = [p_of(unit(seed=5, backlash=x)) for x in (0.0, 0.2, 0.4, 0.8, 1.6)]
    assert found == sorted(found, reverse=True)
    assert found[-1] == pytest.approx(1.0 - 0.05 ** (1.0 / HEALTHY))


@pytest.mark.parametrize(("hidden", "verdict"), [
    ({}, "no disagreement"),
    ({"viscous_friction": 1.0}, "explained"),
    ({"backlash": 3.0}, "explained"),
    ({"viscous_friction": 1.0, "backlash": 2.0}, "explained"),
    ({"strange": 2.0}, "unknown effect"),
])
def test_what_is_hidden_is_decided(hidden, verdict):
    found = decide(unit(seed=3, **hidden))
    assert found.verdict == verdict
    names = set() if found.fit is None else set(found.fit.names)
    assert names == (set(hidden) if verdict == "explained" else set())
    assert all(not e for e in found.equivalent)
    assert all(p <= LEVEL for p in found.p_value)


@pytest.mark.slow
def test_a_name_near_the_threshold_is_the_right_one_or_none():
    """Lindley's case: near the threshold silence is no error, another name is."""
    found = [decide(unit(seed=k, backlash=0.35)) for k in range(40, 50)]
    names = [{*f.fit.names, *sum(f.equivalent, ())} for f in found if f.fit is not None]
    assert all("backlash" in n for n in names)
    assert {f.verdict for f in found} <= {"no disagreement", "explained", "unknown effect"}


def test_second_effects_are_tried_though_a_linear_gain_proves_nothing():
    """Beside a fit that is far off; where one explains, only what useless effects do not gain."""
    def pairs(**hidden):
        one = unit(seed=3, **hidden)
        case = models.Models(one)
        useless = case.library.healthy.copy()
        useless[:, 1] = 1e9
        case.library = replace(case.library, healthy=useless)
        return {frozenset(f.names) for f in case.pairs(case.singles())}

    assert {"viscous_friction", "backlash"} in pairs(viscous_friction=1.0, backlash=2.0)
    assert pairs(backlash=2.0) == set()


@pytest.mark.parametrize(("lead", "p", "named"), [
    (-1.0, LEVEL, ("a", "b")), (2.0, LEVEL, ("a", "b")), (2.0, 2.0 * LEVEL, ("a",))])
def test_two_are_named_where_each_passes_its_own_test_beside_the_other(lead, p, named):
    """Whatever the evidence of one alone, which is no answer then; another law still may be."""
    def model(log, *names):
        return SimpleNamespace(
            names=names, variants=names, terms=names, log=log, cost=100.0 - log)

    null, one, other = model(-50.0), model(-lead, "a"), model(-9.0, "c")
    pair, alone = model(0.0, "a", "b"), [one, model(-40.0, "b")]
    case = SimpleNamespace(nothing=null.cost, null=null, evidence=lambda f: f.log,
                           explains=lambda f: f.log > -10.0,
                           p_own=lambda f, less: p if f is pair else 0.0,
                           each_alone=lambda *_: alone)
    found = decision._named(case, FleetAnswer(verdict="unknown effect", null=null), [pair, other])
    assert found.fit.names == named
    assert found.verdict == "explained"


def test_each_law_has_its_price():
    """One unit in 1 / `LEVEL` has any, all alike: a law that gains less is not likelier."""
    case = models.Models(unit(seed=3))
    names = {s.variant.effect for s in case.library.signatures}
    none = replace(case.null, cost=100.0)
    term = EffectTerm(variant=SIGNATURE.variant, signature=SIGNATURE, u=np.array([VISCOUS]))
    freedom = case.library.freedom
    for above, likelier in ((0.1, True), (-0.1, False)):
        log = np.log(len(names) / LEVEL) + 0.5 * np.log(freedom) + above
        for count in (1, 2):
            laws = replace(none, terms=(term,) * count,
                           cost=100.0 * np.exp(-2.0 * count * log / freedom))
            assert (case.evidence(laws) > case.evidence(none)) == likelier


@pytest.mark.slow
def test_what_is_rarer_than_one_in_twenty_is_named_only_if_it_adds_to_none():
    """Where every law is known as it is on the unit, hardly more than the ranks name."""
    hidden = [unit(seed=k, backlash=0.12) for k in range(40, 70)]
    between = [u for u in hidden if LEVEL < p_of(u) <= 0.05]
    assert len(between) >= 5
    said = [decide(u) for u in between]
    assert {f.fit.names for f in said if f.fit is not None} == {("backlash",)}
    assert sum(f.verdict == "no disagreement" for f in said) >= 4
    named = next(u for u, f in zip(between, said) if f.fit is not None)
    assert decide(named, Held(1.3, 1.2)).verdict == "explained"
    assert decide(named, Held(1.3, 1.4)).verdict == "no disagreement"  # and none that grows
    assert [decide(unit(seed=600 + k)).verdict for k in range(30)] == ["no disagreement"] * 30


@pytest.mark.parametrize("beyond", [False, True])
def test_none_is_fitted_within_the_bounds_of_what_is_named(beyond, monkeypatch):
    """Numbers beyond their bands may make up for more than a law does: also without it."""
    u, edges, hardest = unit(seed=7, viscous_friction=1.0), [], models.Models.hardest
    term = EffectTerm(variant=SIGNATURE.variant, signature=SIGNATURE, u=np.array([VISCOUS]))
    start = u.on_library((term,), [np.zeros(SIZE)])
    law = replace(start, terms=(term,), z=np.where(TOLD, start.z, 1.2 * beyond))
    for place in decision, models:
        monkeypatch.setattr(place, "p_nothing", lambda *_: 2.0 * LEVEL)
    monkeypatch.setattr(models.Models, "singles", lambda self: [
        self.unit.begun(law, self.white, SETTLED_RUNS)])
    monkeypatch.setattr(models.Models, "pairs", lambda *_: [])
    monkeypatch.setattr(models.Models, "hardest", lambda self, fits: (
        edges.append(self.unit.edge) or hardest(self, fits)))
    assert decide(u).verdict == "explained"
    assert edges[0] == (EDGE if beyond else 1.0)


@pytest.mark.parametrize(("size", "adds"), [(1.0, True), (1e-3, False)])
def test_a_law_adds_to_none_if_it_gains_also_beside_the_numbers_of_none(size, adds):
    """A fit of it that stands still elsewhere is no reason for silence, nor for a name."""
    u = unit(seed=7, viscous_friction=size)
    case = models.Models(u)
    nothing = case.hardest([])
    term = EffectTerm(variant=SIGNATURE.variant, signature=SIGNATURE, u=np.array([size * VISCOUS]))
    stuck = replace(u.on_library((term,), [nothing.z]), terms=(term,), cost=2.0 * nothing.cost,
                    z=np.where(TOLD, -nothing.z, nothing.z))
    assert case.p_own(stuck, nothing.cost) > LEVEL
    assert case.adds(stuck, nothing) is adds
    assert not case.adds(stuck, replace(nothing, cost=0.05 * nothing.cost))


def test_the_law_that_gains_most_begins_at_each_size():
    (two,) = (s for s in plain_library().signatures if s.variant.size == 1
              and s.variant.name == "viscous_friction")
    far = LawProposal(two, np.array([0.3 * VISCOUS]), np.zeros(SIZE), 1.0)
    sizes = [p.u[0] for p in at_known_sizes([far])]
    known = np.abs(two.levels[0])
    assert sizes == pytest.approx(np.clip(np.unique(known[known > 0.0]), two.variant.low[0],
                                          two.variant.high[0]))
    assert at_known_sizes([far._replace(u=np.zeros(1))]) == []


def test_two_tests_together_are_as_rare_as_fisher_says():
    rng = np.random.default_rng(5)
    together = np.array([both_of(*p) for p in rng.uniform(size=(20_000, 2))])
    for level in (0.01, 0.1, 0.5):
        assert (together <= level).mean() == pytest.approx(level, abs=4 * np.sqrt(level / 20_000))
    assert both_of(0.03, 0.03) < LEVEL < both_of(0.05, 0.05)


SCALE = Whitener(deviation=np.ones(FEATURES), root=np.eye(FEATURES))
BEND_OF = np.random.default_rng(11).normal(scale=3.0, size=FEATURES)
BESIDE = np.random.default_rng(9).normal(scale=0.4 / np.sqrt(SIZE), size=(FEATURES, SIZE))


def curved(_model, _spread, _fmap, z, _conditions, seed, effects):
    """Stand for `fleet_features`: what an effect does depends on the unit."""
    plain = features_of(z, MODEL.effects)
    added = features_of(z, effects) - plain
    noise = np.random.default_rng(seed).normal(size=FEATURES)
    return plain + added * (1.0 + BESIDE @ z) + noise


def test_a_large_effect_of_which_the_library_knows_half_is_fitted_with_simulated_slopes():
    z = np.random.default_rng(4).uniform(-1.0, 1.0, SIZE)
    u = replace(unit(seed=3), simulator=curved,
                values=curved(None, None, None, z, None, 1, effects_of(viscous_friction=20.0)))
    term = EffectTerm(variant=SIGNATURE.variant, signature=SIGNATURE, u=np.array([10 * VISCOUS]))
    near, before = u.on_library((term,), [np.zeros(SIZE)]), u.without_law().mean
    with_mended = u.descended(near, before, runs=4, steps=4)
    anew = u.refitted(replace(near, z=u.centre), before, runs=4)
    assert anew.cost < 1.5 * FEATURES < with_mended.cost
    assert anew.terms[0].u[0] == pytest.approx(20 * VISCOUS, rel=0.02)
    assert np.abs(anew.z - z).mean() < np.abs(with_mended.z - z).mean()


def test_a_fit_in_another_minimum_begins_anew_where_runs_lead():
    """Waves along an effect stop a descent; a plane through runs over 30 % of it sees none."""
    def wavy(_model, _spread, _fmap, z, _conditions, seed, effects):
        x = effects.viscous_friction.coefficient / VISCOUS
        return (features_of(z, MODEL.effects) + BEND_OF * (x + 2.0 * np.sin(np.pi * x))
                + np.random.default_rng(seed).normal(size=FEATURES))

    u = replace(unit(seed=3), simulator=wavy, values=wavy(
        None, None, None, np.full(SIZE, 0.3), None, 1, effects_of(viscous_friction=20.0)))
    case = models.Models(u)
    term = EffectTerm(variant=SIGNATURE.variant, signature=SIGNATURE, u=np.array([17 * VISCOUS]))
    start = replace(u.on_library((term,), [np.zeros(SIZE)]), terms=(term,), cost=1e9)
    assert not case.explains(case.refitted(start))
    found = case._pressed(start)
    assert case.explains(found)
    truth = replace(start, z=np.full(SIZE, 0.3), terms=(replace(
        term, u=np.array([20.0 * VISCOUS])),))  # or another of the sizes that do the same
    assert found.cost < 1.01 * case.unit.begun(truth, case.white, SETTLED_RUNS).cost


@pytest.mark.slow
def test_a_basin_that_is_too_narrow_for_slopes_is_reached_round_by_round():
    """What goes to and fro with a number has no slope over a round that is wider than a turn.

    By rounds eight draws of ten get there (nine did), by slopes none.
    """
    turns = np.random.default_rng(12).uniform(2.0, 6.0, FEATURES)

    def ringing(_model, _spread, _fmap, z, _conditions, seed, effects):
        off = effects.viscous_friction.coefficient / VISCOUS - 20.0
        return (features_of(z, MODEL.effects) + np.where(np.arange(FEATURES) % 3, 0.0, off)
                + 10.0 * np.sin(turns * off) + np.random.default_rng(seed).normal(size=FEATURES))

    values = ringing(None, None, None, np.full(SIZE, 0.3), None, 1,
                     effects_of(viscous_friction=20.0))
    reached = []
    for seed, begin in product(range(3, 8), (16.0, 23.0)):
        u = replace(unit(seed=3), seed=seed, simulator=ringing, values=values)
        term = EffectTerm(variant=SIGNATURE.variant, signature=SIGNATURE,
                          u=np.array([begin * VISCOUS]))
        start = replace(u.on_library((term,), [np.zeros(SIZE)]), terms=(term,), cost=1e9)
        case = models.Models(u)
        assert not case.explains(case.refitted(start))
        reached.append(case.explains(case._pressed(start)))
    assert sum(reached) >= 8


def test_no_fit_of_the_library_alone_is_pressed_or_named(monkeypatch):
    """There a law may leave less than it does on runs."""
    begun, press, fitted = [], models.Models._pressed, models.Models.fitted
    monkeypatch.setattr(models.Models, "explains", lambda *_: False)
    monkeypatch.setattr(models.Models, "_pressed", lambda self, fit: begun.append(fit) or (
        press(self, fit)))
    monkeypatch.setattr(models.Models, "fitted", lambda self, starts: [
        f for f in fitted(self, starts) if f.names != starts[0].names])  # lost on runs
    u = replace(unit(seed=3), simulator=curved, values=curved(
        None, None, None, np.full(SIZE, 0.9), None, 3, effects_of(viscous_friction=6.0)))
    found = models.Models(u).singles()
    assert len(begun) == 2
    assert all(f.runs for f in (*begun, *found))


def test_a_model_that_cannot_be_run_where_rounds_lead_ends_them(monkeypatch):
    case = models.Models(unit(seed=3, backlash=2.0))
    term = EffectTerm(variant=SIGNATURE.variant, signature=SIGNATURE, u=np.array([VISCOUS]))
    start = case.unit.begun(case.unit.on_library((term,), [np.zeros(SIZE)]), case.white, 8)
    monkeypatch.setattr(models.Models, "explains", lambda *_: False)
    monkeypatch.setattr(models.Models, "refitted", lambda *_: start)
    monkeypatch.setattr(type(case.unit), "begun", lambda _, fit, *__: replace(fit, cost=np.inf))
    assert case._pressed(start) is start


@pytest.mark.parametrize(("size", "step"), [(20.0, 0.05), (0.5, 0.2)])
def test_the_slope_of_a_law_that_bends_is_over_the_least_step_that_shows(size, step):
    """Of x + x²/10 the secant over a share s of x is off by s x/10: noise allows no less."""
    def bending(*_, effects):
        x = effects.viscous_friction.coefficient / VISCOUS
        return BEND_OF * (x + 0.1 * x**2)

    u = replace(unit(seed=3), simulator=lambda *given: bending(effects=given[-1]))
    term = EffectTerm(variant=SIGNATURE.variant, signature=SIGNATURE, u=np.array([size * VISCOUS]))
    fit = LawFit(terms=(term,), z=np.zeros(SIZE), mean=np.zeros(FEATURES), cost=0.0, runs=1,
                 slopes=np.zeros((FEATURES, 1 + SIZE)))
    found = law_slopes(u.run_all, fit, u.run((term,), fit.z, 1), SCALE, 1)[:, 0] * VISCOUS
    assert found == pytest.approx(BEND_OF * (1.0 + 0.2 * size + 0.1 * step * size))


def test_runs_are_the_same_in_any_number_of_threads():
    alone, shared = unit(seed=3), replace(unit(seed=3), workers=5)
    models = [((), np.full(SIZE, 0.1 * k)) for k in range(4)]
    here = alone.run_all(models, 3)
    assert not np.array_equal(here[0], here[1])  # so that an order would be noticed
    assert np.array_equal(here, shared.run_all(models, 3))


def test_evidence_charges_each_coordinate():
    one = LawFit(terms=(), z=np.zeros(1), mean=np.zeros(1), slopes=np.zeros((1, 1)), cost=100.0,
                 runs=1)
    two = SimpleNamespace(cost=100.0, free=1, terms=())
    library = SimpleNamespace(freedom=50.0, signatures=())
    assert log_evidence(one, library) - log_evidence(two, library) == pytest.approx(
        0.5 * np.log(50.0))
    assert log_evidence(SimpleNamespace(cost=np.inf, free=1), library) == -np.inf


@pytest.mark.slow
@pytest.mark.parametrize("simulator", [run, curved], ids=["linear", "curved"])
def test_intervals_hold_nine_in_ten(simulator):
    """Also where what a large effect does depends on the unit, of which the library knows not.

    As sure as one is who knows the slopes there (least squares with the units' spread), who holds
    48 of the first 60 units, and nine in ten of 300.
    """
    inside, wide, size = [], [], 1.0 if simulator is run else 5.0
    for k in range(150):
        z = np.random.default_rng([1500 + k, 98]).uniform(-1.0, 1.0, SIZE)
        u = replace(unit(seed=1500 + k), simulator=simulator, values=simulator(
            None, None, None, z, None, 900 + k, effects_of(viscous_friction=size)))
        term = EffectTerm(variant=SIGNATURE.variant, signature=SIGNATURE,
                          u=np.array([size * VISCOUS]))
        fit = u.on_library((term,), [np.zeros(SIZE)])
        known, found = models.Models(u).remeasured(fit)
        (p,) = parameters_of(u, found, known, 0)
        inside.append(p.low <= size * VISCOUS <= p.high)
        added = ADDED["viscous_friction", "coefficient"]
        slopes = np.column_stack([added, SLOPES]) if simulator is run else np.column_stack(
            [added * (1.0 + BESIDE @ z), SLOPES + size * added[:, None] * BESIDE])
        exact = np.linalg.inv(slopes.T @ slopes + np.diag([0.0, *u.weight]))[0, 0]
        wide.append(np.sqrt(known.covariance[0, 0] / exact) / VISCOUS)
    least, most = binom.interval(0.99, len(inside), 0.9)
    assert least <= sum(inside) <= most
    assert 1.0 < np.median(wide) < 1.12


def slipping(*arguments):
    """Return a run in which a friction makes some features a matter of chance."""
    seed, effects = arguments[-2:]
    found = run(*arguments)
    if effects is not None and effects.load_dependent_friction.coefficient > 0.0:
        found[:8] += 40.0 * np.random.default_rng([seed, 3]).normal(size=8)
    return found


@pytest.mark.slow
def test_what_sticks_and_slips_is_named_all_the_same(monkeypatch):
    """Its noise is of the held-out record too, or a tenth of its features contradicts the name."""
    worn = effects_of(load_dependent_friction=2.0)
    monkeypatch.setattr(gap.HeldOut, "healthy", np.linspace(1.7, 2.3, 60))
    for k in range(3):
        u, other = (replace(unit(seed=s + k), simulator=slipping, values=slipping(
            None, None, None, np.zeros(SIZE), None, 70 + s + k, worn)) for s in (40, 140))
        case = models.Models(u)
        best, *_ = case.singles()
        assert not case.explains(best)
        assert np.flatnonzero(models.noisy(u, best).scatter[8:]).size <= 2
        for held in (None, gap.HeldOut(unit=other, fitted=u)):
            answer = decide(u, held)
            assert (answer.verdict, answer.fit.names) == (
                "explained", ("load_dependent_friction",))
        assert answer.gap.values[0] > 3.0 > 1.5 > answer.gap.values[1]


def test_noise_alone_is_no_excess():
    rng, noise = np.random.default_rng(5), np.full(900, 4.0)
    some = [excess(2.0 * rng.normal(size=(8, 900)), noise).any() for _ in range(600)]
    assert np.mean(some) == pytest.approx(0.05, abs=0.03)
    rows = 2.0 * rng.normal(size=(4000, 900))
    rows[:, 0] *= 5.0
    found = excess(rows, noise)
    assert found[0] == pytest.approx(96.0, rel=0.1)


@pytest.mark.slow
def test_runs_of_healthy_units_are_explained_by_one_another():
    """No second search for what varies more in one unit than in the fleet, as in limit cycles."""
    library = fleet_library(load_model_file(), load_profile("step"), rate=20_000.0, workers=2)
    cases = [models.Models(u) for u in units_aside(library)[:40] if u is not None]
    assert sum(models.noisy(case.unit, case.null) is not case.unit for case in cases) <= 2


def test_values_are_those_that_leave_least_on_runs():
    u = replace(unit(seed=7), simulator=curved, values=curved(
        None, None, None, np.full(SIZE, 0.4), None, 5, effects_of(viscous_friction=5.0)))
    case = models.Models(u)
    for size in (3.0, 5.0, 6.5):  # a fit may have ended beside it
        term = EffectTerm(variant=SIGNATURE.variant, signature=SIGNATURE,
                          u=np.array([size * VISCOUS]))
        fit = u.on_library((term,), [np.zeros(SIZE)])
        fit = replace(fit, terms=(term,))
        known, found = case.remeasured(fit)
        there = u.begun(at(fit, known.mean), case.white, SETTLED_RUNS)
        assert found.runs == SETTLED_RUNS
        assert found.cost <= min(there.cost, u.begun(fit, case.white, SETTLED_RUNS).cost)
        assert found.terms[0].u[0] == pytest.approx(5.0 * VISCOUS, rel=0.1)
    beyond = replace(u, simulator=lambda *_: np.full(u.size, np.nan))  # nothing can be run
    case.unit, fit = beyond, replace(fit)
    assert case.remeasured(fit)[1] is fit


class Held:
    """A held-out record with gaps that are given."""

    def __init__(self, *values, again=()):
        self.values, self.again = values, again

    def gap(self, models, edge=1.0, known=None):
        if len(models) == 1 and models[0].runs and self.again:
            return LawGap(values=self.again, healthy=np.linspace(0.5, 1.5, 480))
        return LawGap(values=self.values[:len(models)], healthy=np.linspace(0.5, 1.5, 480))


def left_of(before):
    """Return what closing most of a gap leaves: healthy units leave 1.0 of it, the median."""
    return np.sqrt(1.0 + (1.0 - MOST) * (before**2 - 1.0))


def test_held_out_records_only_judge():
    good, bad = Held(5.0, 1.0), Held(5.0, 6.0)
    assert decide(unit(seed=3, backlash=2.0), good).verdict == "explained"
    contradicted = decide(unit(seed=3, backlash=2.0), bad)
    assert contradicted.verdict == "contradicted"
    assert "5 to 6" in contradicted.reasons[0]
    assert decide(unit(seed=3), Held(1.2)).verdict == "no disagreement"
    silent = decide(unit(seed=3), Held(5.0))
    assert silent.verdict == "unknown effect"
    assert "5" in silent.reasons[1]
    assert decide(unit(seed=3), Held(5.0, again=(1.2,))).verdict == "no disagreement"
    far = decide(unit(seed=3, backlash=2.0), Held(5.0, left_of(5.0) + 0.01))
    assert far.verdict == "contradicted"  # a name of which the held-out record knows little
    assert "fell from 5 to 2.66 only" in far.reasons[0]
    near = decide(unit(seed=3, backlash=2.0), Held(5.0, left_of(5.0) - 0.01))
    assert near.verdict == "partly explained"  # it fell, and more is left than noise


@pytest.mark.parametrize(("before", "after", "closed"), [
    (5.0, left_of(5.0) - 0.01, True), (5.0, left_of(5.0) + 0.01, False),
    (1.6, 1.4, False),  # from just beyond the bound to just within
    (1.4, 0.5, False)])
def test_most_of_a_gap_is_closed_where_there_is_one(before, after, closed):
    assert Held(before, after).gap([None, None]).closes(MOST) == closed


@pytest.mark.slow
def test_laws_are_tried_where_only_the_held_out_record_is_off():
    """A small effect that one record in twenty healthy ones would leave too."""
    small = unit(seed=7, backlash=0.12)
    assert decide(small).verdict == "no disagreement"
    found = decide(small, Held(5.0, 1.0))
    assert found.verdict == "explained"
    assert found.fit.names == ("backlash",)
    assert found.p_nothing > LEVEL >= max(found.p_value)
    for after in (5.5, 5.0, 4.9):  # a name must lower that gap
        assert decide(small, Held(5.0, after)).verdict == "unknown effect"


def test_no_law_has_the_credit_of_a_unit_fitted_better_beside_it(monkeypatch):
    """A fit of no law may stand still where one with a law goes on: it is led there too."""
    class Near:
        """A held-out record that is off by how far the unit's own numbers are."""

        def gap(self, models, edge=1.0, known=None):
            off = [5.0 * np.abs(m.z - u.centre)[TOLD & ~OF_DAY].max() for m in models]
            return LawGap(values=tuple(off), healthy=np.linspace(0.5, 1.5, 480))

    u = replace(unit(seed=7), centre=np.zeros(SIZE))
    case = models.Models(u)
    end = case.null.z
    u = replace(u, centre=end)  # `Near` knows the unit by where the honest fit ends
    stuck = replace(case.null, z=np.where(TOLD, -end, end), cost=1.2 * case.null.cost)
    term = EffectTerm(variant=SIGNATURE.variant, signature=SIGNATURE, u=np.array([1e-3 * VISCOUS]))
    law = case.unit.begun(replace(
        case.unit.on_library((term,), [end]), terms=(term,), z=end), case.white, SETTLED_RUNS)
    monkeypatch.setattr(models.Models, "singles", lambda self: [law])
    monkeypatch.setattr(models.Models, "pairs", lambda *_: [])
    settled = type(u).settled
    monkeypatch.setattr(type(u), "settled", lambda self, fit, *given, **more: (
        stuck if not fit.terms and more.get("salt") == 4 else settled(self, fit, *given, **more)))
    monkeypatch.setattr(type(u), "without_law", lambda self: replace(stuck, runs=0))
    found = decide(u, Near())
    assert (found.verdict, found.fit) == ("no disagreement", None)
    assert found.gap.values[0] < 1.0 < Near().gap([stuck]).values[0]


@pytest.mark.parametrize(("size", "told", "verdict"), [
    (1e-3, True, "unknown effect"), (1.0, True, "explained"), (1.0, False, "explained")])
def test_a_law_beside_which_a_unit_is_fitted_better_is_a_name_with_a_size(
        size, told, verdict, monkeypatch):
    """Wherever the fit of no law stands still, and though its interval tells no size.

    Then a fit of none, begun where that of the law is, does not explain.
    """
    if not told:
        monkeypatch.setattr(decision, "p_sizes", lambda *_: (0.5,))
    u = unit(seed=7, viscous_friction=size)
    case = models.Models(u)
    term = EffectTerm(variant=SIGNATURE.variant, signature=SIGNATURE, u=np.array([size * VISCOUS]))
    law = u.begun(replace(u.on_library((term,), [case.null.z]), terms=(term,)), case.white,
                  SETTLED_RUNS)
    stuck, settled = replace(case.null, cost=50.0 * law.cost), type(u).settled
    for place in decision, models:
        monkeypatch.setattr(place, "p_nothing", lambda *_: 0.1 * LEVEL)
    monkeypatch.setattr(models.Models, "singles", lambda self: [law])
    monkeypatch.setattr(models.Models, "pairs", lambda *_: [])
    monkeypatch.setattr(type(u), "settled", lambda self, fit, *given, **more: (
        stuck if not fit.terms and more.get("salt") == 4 else settled(self, fit, *given, **more)))
    found = decide(u)
    assert found.verdict == verdict
    assert (found.fit is None) == (size < 1.0)
    assert ("with viscous_friction, but no size" in " ".join(found.reasons)) == (size < 1.0)


@pytest.mark.parametrize(("backlash", "named"), [(2.0, {"viscous_friction", "backlash"}),
                                                 (0.0, set())])
def test_a_law_without_which_nothing_explains_is_a_name_though_its_interval_tells_no_size(
        backlash, named, monkeypatch):
    """Of two as of one; a second one that the first does without is none."""
    u = unit(seed=3, viscous_friction=1.0, backlash=backlash)
    case = models.Models(u)
    one = next(f for f in case.singles() if f.names == ("viscous_friction",))
    second = [p for p in case.gains(one) if p.term.variant.effect == "backlash"][:1]
    pair = case.unit.begun(case.beside(one, second)[0], case.white, SETTLED_RUNS)
    pair = case.refitted(pair)
    alone = case.each_alone(pair, [one])
    untold = [0.5 if name == "backlash" else 0.0 for name in pair.names]
    assert case.needs(pair, untold, alone) is bool(named)
    assert case.needs(pair, [0.0, 0.0], alone)
    monkeypatch.setattr(decision, "p_sizes", lambda known, fit: [
        0.5 if name == "backlash" else 0.0 for name in fit.names])
    found = decide(u)
    assert set(found.fit.names) == (named or {"viscous_friction"})


@pytest.mark.slow
def test_a_law_of_no_size_is_told_from_none_as_often_as_is_said():
    """Wald's test: chi squared of the sizes, whatever the coordinates that are none."""
    known = {v.effect: v for v in variants()}
    terms = tuple(EffectTerm(variant=known[name], signature=SIGNATURE, u=np.zeros(1))
                  for name in ("cogging_torque", "stribeck_friction", "viscous_friction"))
    fit = replace(models.Models(unit(seed=3)).null, terms=terms)
    rng = np.random.default_rng(3)
    root = rng.normal(size=(5, 5))
    draws = rng.normal(size=(4000, 5)) @ root.T
    draws[:, 3] += 9.0  # at which speed a Stribeck effect falls
    p = np.array([p_sizes(Posterior(x, root @ root.T), fit) for x in draws])
    assert p.shape == (4000, 3)
    for level in (0.01, 0.3):
        assert (p <= level).mean(axis=0) == pytest.approx(
            level, abs=4.0 * np.sqrt(level / 4000))
    found = p_sizes(Posterior(np.array([3.0, 4.0, 2.0, 9.0, -1.0]), np.eye(5)), fit)
    assert found == pytest.approx([np.exp(-12.5), 0.0455, 0.3173], rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("after", "verdict"), [
    (left_of(10.0) - 0.01, "partly explained"), (left_of(10.0) + 0.01, "unknown effect")])
def test_a_law_beside_which_something_remains_needs_a_witness(after, verdict):
    """Most of the misfit is the law's, the rest nobody's: the held-out record decides."""
    both = unit(seed=3, backlash=4.0, strange=1.0)
    alone = decide(both)
    assert alone.verdict == "unknown effect"
    assert "the nearest, backlash, closes" in alone.reasons[-1]
    found = decide(both, Held(10.0, after))
    assert found.verdict == verdict
    if verdict == "partly explained":
        assert found.fit.names == ("backlash",)
        assert MOST < found.closed[0] < 1.0
        assert "something remains" in found.reasons[-1]
    small = decide(both, Held(1.2, 0.5))  # nothing to see on the held-out record
    assert small.verdict == "unknown effect"
    assert decide(unit(seed=3, strange=2.0), Held(10.0, 1.0)).verdict == "unknown effect"


def test_what_is_reported_of_the_unit_is_what_the_model_file_holds_beyond_its_band_too():
    known = replace(judged(), spread=load_spread())
    one, z = unit(library=known), np.zeros(SIZE)
    z[0] = 1.3  # the phase resistance, whose band is a tenth
    fit = LawFit(terms=(), z=z, mean=BASE, slopes=np.zeros((FEATURES, SIZE)), cost=1.0, runs=8)
    found = recalibrated_of(one, fit, Posterior(z, 1e-4 * np.eye(SIZE)))
    assert found[0].name == "motor.phase_resistance"
    assert found[0].low < found[0].value == pytest.approx(0.13) and found[0].high == found[0].value
    actuator, _ = fleet_unit(known.model, known.spread, z, RecordConditions())
    assert actuator.motor.phase_resistance == pytest.approx(
        1.13 * known.model.actuator.motor.phase_resistance)


def test_what_was_tried_says_how_often_a_useless_law_gains_as_much():
    one = unit(seed=3, backlash=3.0)
    answer = decide(one)
    tried = candidates_of(one, answer)
    useless = LawFit(terms=answer.fit.terms, z=answer.null.z, mean=answer.null.mean,
                     slopes=answer.fit.slopes, cost=answer.null.cost, runs=8)
    assert answer.fit.names == ("backlash",) and tried
    for fit, least, most in ((answer.fit, 0.0, LEVEL), (useless, 1.0, 1.0)):
        (again,) = candidates_of(one, replace(answer, fit=None, equivalent=(), fits=(fit,)))
        assert least <= again.p_value <= most
