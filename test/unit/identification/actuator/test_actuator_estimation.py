"""Estimates that errors of the slopes must not make look sharp, and machines that are one."""

import math

import numpy as np
import pytest

from ema_identification.actuator.measure.tolerances import PRIOR
from ema_identification.actuator.naming.estimates import (
    LEAST_KNOWN,
    covariance_without_noise,
    slopes_by_regression,
    two_level_design,
)
from ema_identification.actuator.naming.next_test import WITHIN, inseparable, phase_constants
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate

RNG = np.random.default_rng(5)


@pytest.mark.parametrize("factors", [2, 19, 31, 32])
def test_columns_of_the_design_are_orthogonal_and_clear_of_products_of_two(factors):
    signs = two_level_design(factors)
    assert signs.shape[1] == factors
    assert np.array_equal(signs.T @ signs, len(signs) * np.eye(factors))
    assert not signs.sum(axis=0).any()
    products = signs[:, :, None] * signs[:, None, :]
    assert not np.tensordot(signs, products, axes=(0, 0)).any()


def test_regression_finds_slopes_and_how_far_they_are_off():
    true = RNG.normal(size=(500, 19))
    moves = 0.5 * two_level_design(19)
    noise = 0.3 * RNG.normal(size=(len(moves), 500))
    found = slopes_by_regression(moves, 7.0 + moves @ true.T + noise)
    off = (found.value - true) / np.sqrt(found.variance)
    assert np.sqrt(np.mean(off**2)) == pytest.approx(1.0, abs=0.03)
    assert found.variance.mean() == pytest.approx(0.3**2 / (64 * 0.25), rel=0.05)


def test_a_parameter_that_cannot_move_has_no_slope_and_spoils_no_other():
    moves = two_level_design(3)
    moves[:, 1] = 0.0
    found = slopes_by_regression(moves, moves @ np.array([[2.0], [9.0], [-1.0]]))
    assert found.value[0] == pytest.approx([2.0, 0.0, -1.0])
    assert np.isfinite(found.variance).all()


def test_noise_of_the_slopes_does_not_make_a_valley_a_point():
    direction = RNG.normal(size=(1000, 1))
    true = np.hstack([direction, 0.98 * direction + 0.002 * RNG.normal(size=(1000, 1))])
    error = 0.05
    noisy = true + error * RNG.normal(size=true.shape)
    exact = covariance_without_noise(true, np.zeros(2), 1)
    naive = covariance_without_noise(noisy, np.zeros(2), 1)
    mended = covariance_without_noise(noisy, np.full(2, 1000 * error**2), 1)
    assert exact[1, 1] == pytest.approx(PRIOR**2, rel=0.05), "the prior alone tells it"
    assert naive[1, 1] < 0.5 * exact[1, 1]
    assert 1.2 * naive[1, 1] < mended[1, 1] <= naive[1, 1] / LEAST_KNOWN


def test_what_is_well_known_stays_so():
    columns = RNG.normal(size=(1000, 3))
    mended = covariance_without_noise(columns, np.full(3, 10.0), 1)
    assert np.diag(mended) == pytest.approx(np.full(3, 1e-3), rel=0.15)


class Fitted:
    """A fit as far as its effects are asked for."""

    def __init__(self, *settings):
        name = settings[0].split(".")[0]
        self.found = parse_effects(list(settings))
        self.terms = [type("Term", (), {"variant": type("V", (), {"effect": name})})]

    def effects(self, _):
        return self.found


def eccentric(zeta, angle):
    return Fitted(f"rotor_eccentricity.zeta={zeta}", "rotor_eccentricity.mode=static",
                  f"rotor_eccentricity.angle={angle}")


def shorted(fraction, phase="b", mode="physical"):
    return Fitted(f"turn_short.fraction={fraction}", f"turn_short.phase={phase}",
                  f"turn_short.mode={mode}")


def test_a_short_of_constants_and_an_eccentricity_along_its_phase_are_one_machine():
    zeta, base = 0.04, load_model_file().effects
    fraction = 1.5 * zeta / (1.0 + 0.5 * zeta)
    short, bent = shorted(fraction, "a", "paper"), eccentric(-zeta, 0.0)
    ratio = phase_constants(bent.effects(base)) / phase_constants(short.effects(base))
    assert ratio == pytest.approx(np.full(3, 1.0 + 0.5 * zeta), rel=1e-12)
    actuator = load_model_file().actuator
    larger = actuator._replace(motor=actuator.motor._replace(
        back_emf_constant=actuator.motor.back_emf_constant * (1.0 + 0.5 * zeta)))
    one = simulate(load_profile("step"), actuator=larger, effects=short.found, seed=3)
    other = simulate(load_profile("step"), actuator=actuator, effects=bent.found, seed=3)
    early = one.time < 0.05  # rounding grows in the limit cycle after it
    assert np.abs(one.samples[early] - other.samples[early]).max() < 1e-6
    assert "phase a" in inseparable([short, bent], base)


@pytest.mark.parametrize(("zeta", "off", "one"), [
    (-0.03, 0.0, True), (-0.03, 0.05, True), (-0.03, 0.3, False), (0.03, 0.0, False)])
def test_a_test_is_proposed_where_the_axis_is_not_that_of_the_phase(zeta, off, one):
    base = load_model_file().effects
    fraction = 1.5 * abs(zeta) / (1.0 + 0.5 * abs(zeta))
    across = math.sqrt(3.0) * abs(zeta * math.sin(off))
    fits = [eccentric(zeta, 2.0 * math.pi / 3.0 + off), shorted(fraction)]
    assert bool(inseparable(fits, base)) is one
    if zeta < 0.0:
        assert one is (across < WITHIN)


def test_other_sets_are_left_to_the_prediction():
    base = load_model_file().effects
    friction = Fitted("motor_friction.increase=0.2")
    assert inseparable([shorted(0.03), friction], base) == ""
    assert inseparable([shorted(0.03), eccentric(-0.02, 2.1), friction], base) == ""
