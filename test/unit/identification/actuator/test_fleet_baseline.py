"""What acceptance records tell: a type's discrepancy, a unit's own change; on linear units."""

import weakref
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from fleet_unit import (
    CONDITIONS,
    OF_DAY,
    SIZE,
    STRANGE,
    day_beside_unit,
    effects_of,
    features_of,
    judged,
    p_of,
    plain_library,
    run,
    two_days_of,
    unit,
)

from ema_identification.actuator import gap, next_test
from ema_identification.actuator.decision import fit
from ema_identification.actuator.decision.decide import decide
from ema_identification.actuator.decision.proposals import scores
from ema_identification.actuator.decision.ranks import LEVEL, share_of
from ema_identification.actuator.fleet.surrogate import Discrepancy
from ema_identification.actuator.library import acceptance, baseline
from ema_identification.actuator.library.baseline import changed_unit
from ema_record.kit import LIBRARY

slow = pytest.mark.slow

ROW = CONDITIONS.row()
PAIRS = 300
two_days = partial(two_days_of, 5)


def drawn(seed, z, *, strange=0.0, **sizes):
    """Return the features of a test."""
    noise = np.random.default_rng([seed, 6]).normal(size=len(STRANGE))
    return features_of(z, effects_of(**sizes)) + noise + strange * STRANGE


@pytest.fixture(scope="module")
def ranked():
    """Return a library whose healthy units were tested on two days."""
    days = [two_days(k) for k in range(PAIRS)]
    aside = (np.tile(ROW, (PAIRS, 1)), np.array([drawn(k, z) for k, (z, _) in enumerate(days)]))
    later = np.array([[*drawn(1000 + k, z), *ROW] for k, (_, z) in enumerate(days)])
    plain = replace(judged(), aside=aside)
    found = baseline._judged(plain, later, lambda _what, _part: None)
    return replace(plain, healthy=found["healthy"]), float(found["apart"])


def pair(ranked, seed, *, strange=0.0, **sizes):
    """Return a unit with effects beside its own accepted record, both `strange`."""
    library, apart = ranked
    z, later = two_days(seed)
    first, second = (fit.TestedUnit(library=library, values=values, conditions=CONDITIONS,
                                    seed=seed, simulator=run)
                     for values in (drawn(2000 + seed, z, strange=strange),
                                    drawn(3000 + seed, later, strange=strange, **sizes)))
    return changed_unit(second, [first], apart)


@slow
def test_what_both_records_have_is_no_change(ranked):
    """The absolute question calls it unknown; the difference does not hold it."""
    assert decide(unit(seed=3, strange=2.0)).verdict == "unknown effect"
    found = [decide(pair(ranked, 5000 + k, strange=2.0)).verdict for k in range(12)]
    assert found.count("no disagreement") >= 11


def test_what_a_kit_knows_of_its_type_is_in_both_records():
    """Accepted records are fitted with the discrepancy; of the difference it is no part."""
    library, apart = plain_library(), 0.5
    z, later = two_days(6003)
    first, second = (fit.TestedUnit(library=library, values=values, conditions=CONDITIONS,
                                    simulator=run)
                     for values in (drawn(1, z), drawn(2, later)))
    kit = replace(library, left=Discrepancy(2.0 * STRANGE, np.zeros_like(STRANGE)))
    of_type = replace(first, library=kit, values=first.values + kit.left.mean)
    plain = changed_unit(second, [first], apart)
    found = changed_unit(replace(second, values=second.values + kit.left.mean), [of_type], apart)
    assert np.allclose(found.values, plain.values)
    assert scores(found) == pytest.approx(scores(plain))
    assert np.allclose(*(u.run_all([((), np.zeros(SIZE))], 4) for u in (found, plain)))


@slow
def test_a_change_is_named_beside_what_both_have(ranked):
    found = decide(pair(ranked, 6001, strange=2.0, backlash=2.0))
    assert found.verdict == "explained"
    assert found.fit.names == ("backlash",)


@slow
def test_a_change_within_the_band_shows_beside_the_accepted_record_only(ranked):
    """A tolerance that moves through its band: one record alone takes it for another unit."""
    z, later = (np.where(np.arange(SIZE) == 2, end, day)
                for end, day in zip((-0.9, 0.9), two_days(6002)))
    library, apart = ranked
    first, second = (fit.TestedUnit(library=library, values=values, conditions=CONDITIONS,
                                    simulator=run)
                     for values in (drawn(1, z), drawn(2, later)))
    assert p_of(second) > LEVEL
    # Beyond all in cost; the healthy unit of the largest gain is as rare, and so many units prove
    # no more than this (480 do).
    assert p_of(changed_unit(second, [first], apart)) <= share_of(1, PAIRS) < 0.016


def test_what_no_test_tells_from_the_unit_may_change_from_end_to_end():
    """A number of the day that does what one of the unit does (a gain, the motor constant)."""
    (library, day, _), costs = day_beside_unit(), []
    for seed in range(6):
        rng = np.random.default_rng([seed, 55])
        records = []
        for end in (-0.95, 0.95):
            z = np.where(OF_DAY, rng.uniform(-1.0, 1.0, SIZE), 0.3)
            z[day] = end
            values = library.means(z[None], CONDITIONS)[0] + rng.normal(size=len(STRANGE))
            records.append(fit.TestedUnit(library=library, values=values, conditions=CONDITIONS))
        changed = changed_unit(records[1], records[:1], 0.0)
        costs.append(changed.without_law().cost / changed.size)
    assert np.mean(costs) < 1.2


@slow
def test_discrepancy_of_a_type_is_taken_off(tmp_path, monkeypatch):
    """Of twelve units that all leave the same, an acceptance record each."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    library = replace(judged(), aside=(
        np.tile(ROW, (PAIRS, 1)),
        np.array([drawn(k, two_days(k)[0]) for k in range(PAIRS)])))
    kept = {"features": np.array([drawn(8000 + k, two_days(8000 + k)[0], strange=2.0)
                                  for k in range(12)]),
            "conditions": np.tile(ROW, (12, 1)), "unit": np.arange(12)}
    left = acceptance.discrepancy_of(library, kept)
    assert abs(np.corrcoef(left.mean, STRANGE)[0, 1]) > 0.7
    found = acceptance.with_discrepancy(library, left)
    values = [drawn(k, two_days(k)[0], strange=2.0) for k in range(9000, 9010)]
    new = [fit.TestedUnit(library=found, values=v, conditions=CONDITIONS, simulator=run)
           for v in values]
    verdicts = [decide(u).verdict for u in new]
    assert verdicts.count("no disagreement") >= 9
    assert sorted(p.name[:5] for p in (tmp_path / "ema_phm").iterdir()) == ["left_"]
    plain = acceptance.with_discrepancy(replace(library, signatures=()), left)  # held out
    assert not np.array_equal(plain.healthy, found.healthy)
    again = acceptance.with_discrepancy(library, left)
    assert np.array_equal(again.healthy, found.healthy)


@slow
def test_what_a_unit_of_a_type_works_out_is_not_kept_while_others_are_ranked(
        tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    seen, most = list[weakref.ref](), []

    def scored(one):
        seen.append(weakref.ref(one.whitener(0)))
        most.append(sum(ref() is not None for ref in seen))
        return scores(one)

    monkeypatch.setattr(acceptance, "scores", scored)
    library = replace(judged(), aside=(
        np.tile(ROW, (5, 1)), np.array([drawn(k, two_days(k)[0]) for k in range(5)])))
    left = Discrepancy(np.zeros_like(STRANGE), np.full_like(STRANGE, 0.1))
    assert acceptance.with_discrepancy(library, left).healthy.shape == (5, 4)
    assert most == [1] * 5


@slow
def test_a_test_is_proposed_for_a_change_by_runs_of_the_unit_as_it_is(ranked, monkeypatch):
    """The accepted records are of another test, whose features are others."""
    changed = pair(ranked, 5, backlash=2.0)
    answer = decide(changed)
    seen = []

    def shorter(*arguments):
        seen.append(run(*arguments)[:-1])
        return seen[-1]

    monkeypatch.setattr(next_test, "feature_map", lambda *_: None)
    monkeypatch.setattr(next_test, "simulate", lambda *_, **__: None)
    monkeypatch.setattr(next_test, "whole", lambda record, _: record)
    object.__setattr__(changed, "simulator", shorter)
    others = [f for f in answer.fits if f.names != answer.fit.names][:1]
    assert next_test._separation(None, changed, [answer.fit, *others]) > 0.0
    assert len(seen) == 2 * next_test.TEST_RUNS


def test_a_kit_without_acceptance_records_has_no_discrepancy(tmp_path, monkeypatch):
    monkeypatch.setattr(acceptance, "kit_path", lambda name: tmp_path / name)
    monkeypatch.setattr(acceptance, "_name", lambda _map: "acceptance_of_this_test")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    library = plain_library()
    assert LIBRARY and acceptance.with_acceptance(library) is library


@slow
def test_gap_on_a_held_out_record_is_ranked_among_healthy_units(tmp_path, monkeypatch):
    """Their gaps are kept; a unit whose held-out record has an effect is beyond them."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    days = [two_days(k) for k in range(30)]
    libraries = [replace(judged(), aside=(
        np.tile(ROW, (30, 1)), np.array([drawn(1000 * d + k, z[d]) for k, z in enumerate(days)])))
        for d in (0, 1)]
    z, later = two_days(9100)
    fitted = fit.TestedUnit(library=libraries[0], values=drawn(1, z), conditions=CONDITIONS)

    def gap_of(values):
        held = fit.TestedUnit(library=libraries[1], values=values, conditions=CONDITIONS)
        found = gap.HeldOut(unit=held, fitted=fitted).gap([fitted.without_law()])
        assert found.healthy.shape == (30,)
        return found

    quiet = gap_of(drawn(2, later))
    assert len(list((tmp_path / "ema_phm").iterdir())) == 1
    loud = gap_of(drawn(2, later, backlash=3.0))
    assert loud.healthy.tolist() == quiet.healthy.tolist()
    assert quiet.values[0] <= quiet.healthy.max() * 1.2
    assert loud.values[0] > loud.healthy.max()
    own = gap.fitted_gap(fitted, [fitted.without_law()])
    assert 0.5 * own.floor < own.values[0] < 2.0 * own.floor
