"""How surely runs of a model tell it, on linear units of which the exact answer is known."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from fleet_unit import (
    ADDED,
    CONDITIONS,
    FEATURES,
    MODEL,
    SIZE,
    SLOPES,
    TOLD,
    UNITS,
    effects_of,
    features_of,
    plain_library,
)
from scipy.optimize import lsq_linear

from ema_identification.actuator.decision import fit
from ema_identification.actuator.decision.fit import PRIOR
from ema_identification.actuator.decision.intervals import (
    INTERVAL_ROUNDS,
    _Plane,
    linearised,
    measured,
    p_sizes,
    posterior_of,
)
from ema_identification.actuator.fleet.surrogate import NoiseLaw
from ema_identification.actuator.laws.catalogue import variants
from ema_identification.actuator.laws.terms import EffectTerm, LawFit, Posterior

LAW = "viscous_friction", "coefficient"
(SIGNATURE,) = (s for s in plain_library().signatures if s.variant.name == LAW[0])
COLUMNS = np.column_stack([ADDED[LAW] / UNITS[LAW], SLOPES])
ROOT = np.tril(np.random.default_rng(31).normal(scale=0.05, size=(FEATURES, FEATURES)), -1)
ROOT += np.diag(np.random.default_rng(32).uniform(0.5, 2.0, FEATURES))
"""Of a noise that the library does not know: it says 1 and no correlation."""


def world(root, columns=COLUMNS):
    """Return a simulator whose features are linear; None: without noise."""
    def simulator(_model, _spread, _fmap, z, _conditions, seed, effects):
        law = getattr(effects, LAW[0]).coefficient
        noise = 0.0 if root is None else root @ np.random.default_rng(seed).normal(size=len(root))
        return features_of(np.zeros(SIZE), MODEL.effects) + columns @ np.append(law, z) + noise
    return simulator


def model_of(seed, root, *, size=1.0, edge=10.0, columns=COLUMNS, z=None, off=0.0, error=0.0,
             simulator=None, **library):
    """Return a unit with the right law, a fit that ended beside it, and the truth."""
    rng, simulator = np.random.default_rng([seed, 33]), simulator or world(root, columns)
    z = rng.normal(scale=np.sqrt(1.0 / PRIOR), size=SIZE) if z is None else z
    values = simulator(None, None, None, z, None, [seed, 34],
                       effects_of(**{LAW[0]: size})) + off * rng.normal(size=FEATURES) + error
    unit = fit.TestedUnit(library=replace(plain_library(), **library), values=values, seed=seed,
                          conditions=CONDITIONS, simulator=simulator, edge=edge)
    term = EffectTerm(variant=SIGNATURE.variant, signature=SIGNATURE,
                      u=np.array([1.2 * size * UNITS[LAW]]))
    model = LawFit(terms=(term,), z=np.zeros(SIZE), mean=values, cost=1.0, runs=8,
                   slopes=np.zeros((FEATURES, 1 + SIZE)))
    return unit, model, np.append(size * UNITS[LAW], z)


def found_of(seed, root, *, rounds=2, **more):
    """Return rounds of runs of the right model, and the truth."""
    unit, model, truth = model_of(seed, root, **more)
    return list(islice(linearised(unit, model), rounds)), truth


@pytest.mark.parametrize("off", [0.0, 1.5])
def test_a_result_is_off_as_far_as_its_covariance_says(off):
    """Whatever noise the library expects; also where records are off beyond runs, as it knows."""
    squares, wide = [], []
    for seed in range(5):
        (*_, last), truth = found_of(seed, ROOT, off=off, carried=off)
        variance = np.diag(last.known.covariance)
        squares.append((last.known.mean - truth) ** 2 / variance)
        wide.append(variance[1:][~TOLD])
    squares = np.array(squares)
    assert squares[:, 1:][:, TOLD].mean() == pytest.approx(1.0, abs=0.25)  # 0.11 expected
    assert squares[:, 0].mean() < 3.0
    assert np.array(wide) == pytest.approx(1.0 / PRIOR, rel=0.1)  # nothing tells these
    noise = ROOT @ ROOT.T + off**2 * np.eye(FEATURES)
    best = np.linalg.inv(COLUMNS.T @ np.linalg.solve(noise, COLUMNS)
                         + np.diag(np.append(1e-9, np.full(SIZE, PRIOR))))
    assert np.mean(np.sqrt(variance / np.diag(best))[np.append(True, TOLD)]) < 1.5


def test_the_noise_of_slopes_takes_nothing_off_what_they_tell():
    """Else what is hardly told would be taken for less than it is: by a quarter here."""
    columns, share = COLUMNS * np.append(1.0, np.full(SIZE, 0.2 / 1.5)), []
    unsure = []
    for seed in range(8):
        (first,), truth = found_of(seed, np.eye(FEATURES), rounds=1, columns=columns)
        unsure.append(np.diag(first.known.covariance)[1:][~TOLD])
        share.append([first.known.mean[1:][TOLD] @ truth[1:][TOLD], (truth[1:][TOLD] ** 2).sum()])
    told = 0.2**2 * FEATURES
    found = np.divide(*np.sum(share, axis=0))
    assert found == pytest.approx(told / (told + PRIOR), abs=0.06)
    assert np.mean(unsure) < 1.0 / PRIOR  # nor does it make less sure what is not told


def test_within_the_bands_the_planes_meet_the_record_where_least_is_left():
    """Hardly any noise: its slopes are the world's, the result that of bounded least squares."""
    rng, size = np.random.default_rng(35), np.append(UNITS[LAW], np.ones(SIZE))
    z = np.where(rng.uniform(size=SIZE) < 0.2, 1.4, rng.uniform(-0.8, 0.8, SIZE))
    (first, second), truth = found_of(3, 0.01 * np.eye(FEATURES), z=z, edge=1.0, carried=3.0)
    for one in first, second:
        assert one.slopes * size == pytest.approx(COLUMNS * size, abs=0.01)
        assert np.abs(one.points[:, 1:]).max() == 1.0
    prior = np.sqrt(PRIOR) * np.eye(1 + SIZE)[1:]
    exact = lsq_linear(np.vstack([COLUMNS * size / 3.0, prior]), np.append(
        COLUMNS @ truth / 3.0, np.zeros(SIZE)), bounds=(
        np.append(0.0, -np.ones(SIZE)), np.append(np.inf, np.ones(SIZE)))).x
    assert 3 < (exact[1:] > 0.999).sum() < 12
    assert second.known.mean / size == pytest.approx(exact, abs=0.03)


def test_what_a_plane_leaves_of_its_runs_is_as_large_as_their_noise():
    """Slopes follow the noise of so few runs, which leave less of it: a quarter here."""
    rng = np.random.default_rng(40)
    unit, *_ = model_of(2, np.eye(FEATURES))
    offsets = rng.normal(size=(4 * SIZE, SIZE))
    rows = offsets @ SLOPES.T + 2.0 * rng.normal(size=(4 * SIZE, FEATURES))
    plane = _Plane.through(unit, np.arange(SIZE), offsets, rows)
    assert (plane.deviation**2 - np.diag(plane.extra)).mean() == pytest.approx(4.0, rel=0.05)


def test_each_round_is_as_wide_as_what_is_not_told_before():
    (first, second), _ = found_of(4, np.eye(FEATURES))
    expected = np.append(1.2 * UNITS[LAW] / 3.0, np.full(SIZE, np.sqrt(1.0 / PRIOR)))
    assert first.points.mean(axis=0) == pytest.approx(
        np.append(1.2 * UNITS[LAW], np.zeros(SIZE)), abs=1e-9)
    assert first.points.std(axis=0) == pytest.approx(expected, rel=1e-6)
    assert np.cov(second.points.T, bias=True) == pytest.approx(
        9.0 * first.known.covariance, rel=1e-6, abs=1e-12)
    assert second.points.mean(axis=0) == pytest.approx(first.known.mean)
    runs = len(first.points), len(second.points)
    assert runs == (4 * (1 + SIZE), 8 * (1 + SIZE))


def test_what_slopes_may_be_off_counts_by_how_far_it_leads():
    """A unit three deviations off in all: the noise of slopes is twice that of its record."""
    squares = []
    for seed in range(4):
        z = 1.7 * np.random.default_rng([seed, 39]).choice([-1.0, 1.0], SIZE)
        (first,), truth = found_of(seed, np.eye(FEATURES), rounds=1, z=z)
        squares.append((first.known.mean - truth) ** 2 / np.diag(first.known.covariance))
    assert np.array(squares)[:, 1:][:, TOLD].mean() == pytest.approx(1.0, abs=0.4)


def test_what_is_measured_is_the_last_round():
    unit, model, _ = model_of(8, np.eye(FEATURES))
    known, slopes = measured(unit, model)
    *_, last = islice(linearised(unit, model), INTERVAL_ROUNDS)
    assert known.mean == pytest.approx(last.known.mean)
    assert slopes == pytest.approx(last.slopes)
    assert np.ptp(known.covariance / last.known.covariance) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("most", "rounds"), [(1.0, 2), (-0.1, 0)])
def test_runs_that_fail_are_left_out_and_too_few_tell_nothing(most, rounds):
    plain = world(np.eye(FEATURES))

    def fails(*given):
        found = plain(*given)
        return np.full(FEATURES, np.nan) if given[3][2] > most else found

    z = -0.2 * np.ones(SIZE)
    found, truth = found_of(9, None, z=z, simulator=fails)
    assert len(found) == rounds
    for one in found:
        assert one.points[:, 3].max() <= most and len(one.points) == len(one.features)
    if rounds:
        assert len(found[0].points) < 4 * (1 + SIZE)
        assert found[1].known.mean[1:][TOLD] == pytest.approx(truth[1:][TOLD], abs=0.3)


def test_of_a_law_that_shows_in_nothing_only_its_size_is_known():
    """First it is somewhere about the fit, in the end within ten times as much."""
    (first, second), _ = found_of(6, np.eye(FEATURES), columns=COLUMNS * np.append(
        0.0, np.ones(SIZE)))
    for found, wide in (first, 1.0), (second, 10.0):
        assert np.sqrt(found.known.covariance[0, 0]) == pytest.approx(
            wide * 1.2 * UNITS[LAW] / 3.0, rel=0.02)


def test_a_correlation_that_the_library_knows_makes_a_result_surer():
    """Hardly more runs than a record has features tell little of it."""
    root = np.tril(np.random.default_rng(38).normal(scale=0.2, size=(FEATURES,) * 2))
    root += np.eye(FEATURES)
    noise = root @ root.T
    scale = np.sqrt(np.diag(noise))
    known = NoiseLaw(quiet=scale**2, noisy=np.zeros((2, FEATURES)),
                     correlation=noise / np.outer(scale, scale))
    alone = replace(known, correlation=np.eye(FEATURES))
    wide = [np.sqrt(np.diag(found_of(7, root, repeat=law, surrogate=law)[0][1].known.covariance))
            for law in (known, alone)]
    assert (wide[0] / wide[1])[1:][TOLD].mean() < 0.8


def test_what_is_far_off_hardly_moves_a_result():
    """Three features of 150 by a hundred deviations: something else is there."""
    error = np.zeros(FEATURES)
    error[np.random.default_rng(36).choice(FEATURES, 3, replace=False)] = 100.0
    ((*_, plain), _), ((*_, moved), _) = (
        found_of(5, np.eye(FEATURES), error=x) for x in (0.0, error))
    assert np.abs((moved.known.mean - plain.known.mean)
                  / np.sqrt(np.diag(plain.known.covariance))).max() < 2.0


def test_a_fit_tells_by_its_own_slopes_what_bayes_says():
    """Linear, Gaussian, close to the fit: exact; also where something is known of the unit."""
    rng = np.random.default_rng(37)
    centre, weight = rng.uniform(-0.5, 0.5, SIZE), rng.uniform(3.0, 300.0, SIZE)
    here, there = (rng.normal(scale=1e-3, size=1 + SIZE) * np.append(UNITS[LAW], np.ones(SIZE))
                   for _ in range(2))
    unit = fit.TestedUnit(library=plain_library(), values=SLOPES @ there[1:],
                          conditions=CONDITIONS, centre=centre, weight=weight)
    model = LawFit(terms=(), z=here[1:], mean=SLOPES @ here[1:], slopes=SLOPES, cost=1.0, runs=0)
    found = posterior_of(unit, model)
    precision = SLOPES.T @ SLOPES + np.diag(weight)
    assert found.covariance == pytest.approx(np.linalg.inv(precision), abs=1e-6)
    assert found.mean == pytest.approx(np.linalg.solve(
        precision, SLOPES.T @ unit.values + weight * centre), abs=1e-4)


def test_a_law_is_as_far_from_none_as_its_sizes_are():
    """Not as its other coordinates are: at which speed a Stribeck effect falls."""
    known = {v.effect: v for v in variants()}
    terms = tuple(EffectTerm(variant=known[name], signature=SIGNATURE, u=np.zeros(1))
                  for name in ("cogging_torque", "stribeck_friction", LAW[0]))
    model = LawFit(terms=terms, z=np.zeros(0), mean=np.zeros(0), slopes=np.zeros((0, 5)),
                   cost=0.0, runs=8)
    found = p_sizes(Posterior(np.array([3.0, 4.0, 2.0, 9.0, -1.0]), np.eye(5)), model)
    assert found == pytest.approx([np.exp(-12.5), 0.0455, 0.3173], rel=1e-3)
    shared = np.eye(5)
    shared[0, 1] = shared[1, 0] = 0.6  # along what both do a size is less sure, across it more
    (first, *_) = p_sizes(Posterior(np.array([2.0, 2.0, 0.0, 0.0, 0.0]), shared), model)
    assert first == pytest.approx(np.exp(-0.5 * 8.0 / 1.6))
