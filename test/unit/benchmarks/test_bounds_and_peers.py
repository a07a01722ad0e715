"""Information bounds against closed forms; the comparison's perceptron on known data."""

import numpy as np
import pytest
from scipy.special import ndtri

from benchmarks.detection.detectability import (
    inverse_covariance,
    linear_bound,
    needed_shift,
    noise_bound,
    own_spread_bound,
)
from benchmarks.detection.peers import Perceptron
from benchmarks.units import actuator_of
from ema_prognostics.cascade.classes import OUTPUTS
from ema_prognostics.training.fleet import FleetFeatures
from ema_record.actuator import load_actuator

KNOWN = float(ndtri(0.99) + ndtri(0.90))  # 3.608 standard deviations


def test_a_known_shift():
    assert needed_shift() == pytest.approx(KNOWN)
    assert needed_shift(directions=3) > needed_shift()
    assert needed_shift(freedoms=2) > needed_shift()


def test_a_tolerance_alone():
    """99 % of 1 ± 10 % lie below 1.098; nine of ten above 0.92: a factor of 1.098 / 0.92."""
    assert own_spread_bound(0.1) == pytest.approx(1.098 / 0.92 - 1.0)


def test_noise_alone():
    rng = np.random.default_rng(92_001)
    deviation = np.array([2.0, 0.5, 1.0])
    samples = deviation * rng.standard_normal((4000, 3))
    signature = np.array([1.0, 1.0, 0.0])
    exact = KNOWN * np.sqrt(2.0 / (1.0 / 4.0 + 1.0 / 0.25))
    found = noise_bound(signature, inverse_covariance(samples), KNOWN, 2)
    assert found == pytest.approx(exact, rel=0.05)


def test_more_features_than_it_takes_do_not_make_the_noise_smaller():
    rng = np.random.default_rng(92_002)
    samples = rng.standard_normal((120, 40))
    signature = np.eye(40)[0]
    none = np.empty((0, 40))
    found = linear_bound(signature, samples, none, none)
    assert found >= 0.95 * KNOWN * np.sqrt(2.0)


def test_a_tolerance_that_looks_like_the_fault():
    """Without noise the additive test needs the spread's own quantiles: 0.098 + 0.080."""
    rng = np.random.default_rng(92_003)
    samples = 1e-4 * rng.standard_normal((100, 2))
    signature = np.array([1.0, 0.0])
    found = linear_bound(signature, samples, np.empty((0, 2)), 0.1 * signature[None])
    assert found == pytest.approx(0.178, rel=0.02)


def test_what_is_not_known_elsewhere_does_no_harm():
    rng = np.random.default_rng(92_004)
    samples = rng.standard_normal((300, 2))
    signature, other = np.array([1.0, 0.0]), np.array([[0.0, 50.0]])
    free = linear_bound(signature, samples, np.empty((0, 2)), other)
    assert free == pytest.approx(KNOWN, rel=0.1)


def test_a_parameter_that_no_feature_shows_does_no_harm():
    """Its shift is 0, or -0 under a negative weight."""
    rng = np.random.default_rng(92_006)
    samples = rng.standard_normal((300, 2))
    signature = np.array([1.0, 0.0])
    for sign in (1.0, -1.0):
        found = linear_bound(signature, samples, np.empty((0, 2)), np.full((1, 2), sign * 0.0))
        assert found == pytest.approx(KNOWN, rel=0.1)


def test_tied_parameters_move_together():
    nominal = load_actuator().motor
    moved = actuator_of({"motor_friction": 0.1, "back_emf_b": 0.005}).motor
    assert moved.dynamic_friction == pytest.approx(1.1 * nominal.dynamic_friction)
    assert moved.static_friction == pytest.approx(1.1 * nominal.static_friction)
    assert moved.back_emf_deviation_b == 0.005
    assert actuator_of({}) == load_actuator()


def test_the_perceptron_learns_what_is_plain():
    rng = np.random.default_rng(92_005)
    count, names = 1500, tuple(f"f{k}" for k in range(len(OUTPUTS)))
    which = rng.integers(0, len(OUTPUTS) + 1, count)
    severity = np.zeros((count, len(OUTPUTS)))
    sick = which < len(OUTPUTS)
    severity[np.flatnonzero(sick), which[sick]] = 0.1
    record = 80.0 * severity + 0.3 * rng.standard_normal(severity.shape)
    train = FleetFeatures(names=names, baseline=np.zeros_like(record), record=record,
                          severity=severity, unit=np.arange(count), friction=np.zeros((count, 2)))
    fresh = 8.0 * np.eye(len(OUTPUTS))
    called = Perceptron(train).call(np.vstack([fresh, 0.0 * fresh[:1]]), np.zeros((9, 8)))
    assert called[0].outcome == "turn_short"
    assert [c.phase for c in called[:3]] == ["a", "b", "c"]
    assert [c.outcome for c in called[3:]] == [
        "rotor_eccentricity", "rotor_eccentricity", "friction", "friction", "backlash",
        "healthy",
    ]
    assert called[7].severity == pytest.approx(0.1, rel=0.2)
