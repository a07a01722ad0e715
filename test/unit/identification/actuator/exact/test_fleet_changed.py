"""A unit beside its own accepted records: what cancels, how sure it is; quick, on known worlds."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from fleet_unit import (
    CONDITIONS,
    FEATURES,
    MODEL,
    OF_DAY,
    SIZE,
    STRANGE,
    TOLD,
    day_beside_unit,
    features_of,
    plain_library,
    two_days_of,
)

from ema_identification.actuator.decision import fit
from ema_identification.actuator.fleet.surrogate import SETTLED_RUNS, NoiseLaw
from ema_identification.actuator.library import baseline
from ema_identification.actuator.library.baseline import changed_unit
from ema_identification.actuator.measure.tolerances import NoiseFactors

ROW = CONDITIONS.row()
two_days = partial(two_days_of, 5)


def bending():
    """Return a unit beside two accepted records, of a world that bends, without noise.

    And its true numbers, and what has changed: the rest is the same strange thing in all records.
    """
    rng, plain = np.random.default_rng(21), plain_library()
    weights = plain.weights.copy()
    weights[SIZE + 1:] = rng.normal(scale=0.3, size=weights[SIZE + 1:].shape)
    library = replace(plain, weights=weights)
    own, change = rng.uniform(-1.0, 1.0, SIZE), rng.normal(size=FEATURES)
    days = [np.where(OF_DAY, rng.uniform(-1.0, 1.0, SIZE), own) for _ in range(3)]
    conditions = [replace(CONDITIONS, temperature=t, bus=b)
                  for t, b in ((40.0, 0.05), (-20.0, -0.1), (5.0, 0.1))]

    def simulator(_model, _spread, _fmap, z, conditions, _seed, effects):
        return library.means(z[None], conditions)[0] + STRANGE + (
            change if effects != MODEL.effects else 0.0)

    *accepted, later = (fit.TestedUnit(
        library=library, conditions=c, simulator=simulator,
        values=library.means(z[None], c)[0] + STRANGE) for z, c in zip(days, conditions))
    found = changed_unit(replace(later, values=later.values + change), accepted, 0.0)
    assert not np.any((found.at[0] - found.at[1])[~OF_DAY])
    before = np.mean([u.values - STRANGE for u in accepted], axis=0)  # had they been known exactly
    return replace(found, at=tuple(days[:2]), before=before,
                   values=found.values - found.before + before), days[2], change


def test_of_the_difference_only_the_change_is_left():
    """Whatever numbers and days bring, and whatever model and machine do not share."""
    changed, z, change = bending()
    others = np.random.default_rng(22).uniform(-1.0, 1.0, (3, SIZE))
    assert changed.values - changed.means(z[None])[0] == pytest.approx(change)
    for there, mean in zip(others, changed.run_all([((), x) for x in others], 2)):
        assert mean == pytest.approx(changed.means(there[None])[0])
    assert changed.values - changed.run((), z, 2) == pytest.approx(change)
    step = 1e-4 * np.eye(SIZE)
    exact = (changed.means(z + step) - changed.means(z - step)).T / 2e-4
    assert changed.slope(z) == pytest.approx(exact, abs=1e-6)
    assert np.abs(exact[:, ~OF_DAY]).max() > 0.1  # another day: not all cancels
    assert changed.covariance(4) == pytest.approx(1.25 * changed.covariance(0))


@pytest.mark.parametrize(("accepted", "apart", "carried"), [
    (2, 0.0, 0.0), (1, 2.0, 0.5), (1, 0.5, 2.0)])
def test_likelihood_of_a_difference_is_to_scale(accepted, apart, carried):
    """A cost of 1 a feature, on the quadratic and on runs, however many records were accepted.

    These are noisier. The quadratic is off by `apart`, runs by no more than they or it would be.
    """
    plain, loud, costs = plain_library(), replace(CONDITIONS, noise=NoiseFactors(3.0, 1.0)), []
    law = NoiseLaw(quiet=np.full(FEATURES, 0.8), correlation=np.eye(FEATURES),
                   noisy=np.outer([0.2, 0.0], np.ones(FEATURES)))  # variances 1 and 2.6
    library = replace(plain, repeat=law, surrogate=replace(law, noisy=0.0 * law.noisy),
                      carried=carried)
    for seed in range(5):
        rng = np.random.default_rng([seed, 77])

        def simulator(_model, _spread, _fmap, z, conditions, seed, effects):
            return features_of(z, effects) + np.random.default_rng(seed).normal(
                size=FEATURES) * law.deviation(conditions.noise)

        z = rng.uniform(-1.0, 1.0, SIZE)
        units = [fit.TestedUnit(
            library=library, conditions=c, simulator=simulator, seed=10 * seed + k,
            values=simulator(None, None, None, np.where(
                OF_DAY, rng.uniform(-1.0, 1.0, SIZE), z), c, rng.integers(2**31), MODEL.effects))
            for k, c in enumerate([CONDITIONS, *[loud] * accepted])]
        error = rng.normal(scale=np.sqrt(0.8), size=FEATURES)
        found = []
        for share, runs in ((apart, 0), (min(apart, carried), SETTLED_RUNS)):
            off = replace(units[0], values=units[0].values + share * error)
            unit_ = changed_unit(off, units[1:], apart)
            quick = unit_.without_law()
            found.append((unit_.settled(quick, None, runs) if runs else quick).cost / FEATURES)
        costs.append(found)
    assert np.mean(costs, axis=0) == pytest.approx(1.0, abs=0.12)  # 0.05 expected


@pytest.mark.parametrize("accepted", [1, 3])
def test_accepted_records_tell_a_unit_as_surely_as_is_said(accepted):
    """Of a number that no test tells from the day's: half, and the day's half of each record.

    What no record tells at all stays as unsure as it was, however many were accepted.
    """
    (library, day, own), squares = day_beside_unit(), []
    for seed in range(8):
        rng = np.random.default_rng([seed, 56])
        z = rng.uniform(-1.0, 1.0, SIZE)
        records = [fit.TestedUnit(
            library=library, conditions=CONDITIONS,
            values=library.weights[0] + library.weights[1:SIZE + 1].T @ np.where(
                OF_DAY, rng.uniform(-1.0, 1.0, SIZE), z) + rng.normal(size=FEATURES))
            for _ in range(1 + accepted)]
        changed = changed_unit(records[0], records[1:], 0.0)
        squares.append(changed.weight * (changed.centre - z) ** 2)
    untold = ~OF_DAY & ~TOLD
    assert 1.0 / changed.weight[own] == pytest.approx((1.0 + 1.0 / accepted) / 12.0, rel=0.01)
    assert 1.0 / changed.weight[untold] == pytest.approx(1.0 / 3.0)
    clear = ~OF_DAY & TOLD & (np.arange(SIZE) != own)
    assert 1.0 / changed.weight[clear].mean() == pytest.approx(
        1.0 / (FEATURES - SIZE) / 2.25 / accepted, rel=0.3)
    assert np.mean(squares, axis=0)[clear].mean() == pytest.approx(1.0, abs=0.25)
    assert not changed.centre[OF_DAY].any()
    assert 1.0 / changed.weight[day] == pytest.approx(
        1.0 / 3.0 + (1.0 + 1.0 / accepted) / 12.0, rel=0.01)
    assert changed.edge[day] == 2.0 and changed.edge[own] == 1.0


def test_what_two_tests_of_a_unit_do_not_share_is_found_of_healthy_units():
    """With it they leave 1 a feature: so those that are ranked are scored."""
    days, off = [two_days(k) for k in range(20)], np.random.default_rng(23)
    first, later = (np.array([features_of(day[k], MODEL.effects) for day in days]) + scale
                    * off.normal(size=(20, FEATURES)) for k, scale in ((0, 1.0), (1, 1.8)))
    aside, later = (np.tile(ROW, (20, 1)), first), np.hstack([later, np.tile(ROW, (20, 1))])
    found = baseline._judged(replace(plain_library(), aside=aside), later, lambda *_: None)
    assert found["apart"] == pytest.approx(1.5, abs=0.25)  # 1 + 1.5 squared
    assert found["healthy"].shape == (20, 4)
    assert found["healthy"][:, 0].mean() == pytest.approx(1.0, abs=0.15)
