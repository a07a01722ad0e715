"""Rotation of the phases, thresholds and interval widths: closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from ema_prognostics.cascade.find import meant
from ema_prognostics.features.vector import difference_names, differences, rotate, squash
from ema_prognostics.networks.network import logsig
from ema_prognostics.training.calibration import (
    borne_out,
    conformal_quantile,
    local_quantiles,
    tail_quantile,
)

NAMES = ["quarter_even_m1_re", "quarter_even_m1_im", "quarter_even_m2_re", "quarter_even_m2_im",
         "torque_quarter"]


def test_three_thirds_turn_back_and_keep_the_rest() -> None:
    x = np.random.default_rng(0).normal(size=(4, 5))
    assert np.allclose(rotate(rotate(x, NAMES, 1), NAMES, 2), x)
    assert np.array_equal(rotate(x, NAMES, 1)[:, 4], x[:, 4])


@pytest.mark.parametrize("phase", [0, 1, 2])
def test_a_line_of_phase_k_turns_into_that_of_phase_a(phase: int) -> None:
    # k_k(θ − 120° k): line h lags by h 120° k.
    lines = np.exp(-2j * np.pi * np.array([1, 2]) * phase / 3.0) * np.array([0.3, 0.5j])
    x = np.array([[lines[0].real, lines[0].imag, lines[1].real, lines[1].imag, 1.0]])
    assert np.allclose(rotate(x, NAMES, phase), [[0.3, 0.0, 0.0, 0.5, 1.0]])


def test_differences_keep_the_features_themselves() -> None:
    found = differences(np.array([[3.0, 5.0]]), np.array([[1.0, 1.0]]))
    assert found.tolist() == [[2.0, 4.0, 3.0, 5.0]]
    assert difference_names(["a", "b"]) == ["a", "b", "absolute_a", "absolute_b"]


def test_squash_is_linear_near_healthy() -> None:
    x = np.array([[1e-3, 1e6]])
    u = squash(x, np.zeros(2), np.ones(2))
    assert u[0, 0] == pytest.approx(1e-3, rel=1e-5)
    assert u[0, 1] == pytest.approx(np.log(2e6), rel=1e-5)


def test_tail_of_an_exponential() -> None:
    score = np.random.default_rng(1).exponential(size=40_000)
    assert tail_quantile(score, 1e-3) == pytest.approx(-np.log(1e-3), rel=0.06)


def test_conformal_width_covers() -> None:
    rng = np.random.default_rng(2)
    width = conformal_quantile(np.abs(rng.normal(size=4000)), 0.9)
    assert np.mean(np.abs(rng.normal(size=40_000)) <= width) == pytest.approx(0.9, abs=0.02)


def test_width_follows_what_the_residual_depends_on() -> None:
    rng = np.random.default_rng(5)
    value = rng.uniform(0.0, 1.0, 6000)
    residual = np.abs(rng.normal(size=6000)) * (1.0 + value)
    knots, width = local_quantiles(value, residual, 0.9)
    assert (np.diff(knots) > 0.0).all()
    assert width == pytest.approx(1.645 * (1.0 + knots), rel=0.12)
    assert len(local_quantiles(value, residual, 0.9, 3)[0]) == 3
    inside = residual <= np.interp(value, knots, width)
    for low in (0.0, 0.4, 0.8):
        assert inside[(value >= low) & (value < low + 0.2)].mean() == pytest.approx(0.9, abs=0.04)


def test_what_is_said_means_how_often_it_was_so() -> None:
    """A plateau of one in ten, then certainty: no logistic curve, and told nevertheless."""
    rng = np.random.default_rng(5)
    said = rng.uniform(-4.0, 4.0, 4000)
    true = np.where(said < 0.0, 0.1, 0.99)
    knots, logits = borne_out(said, rng.random(4000) < true)
    assert (np.diff(knots) > 0.0).all() and (np.diff(logits) > 0.0).all()
    found = logsig(meant(np.array([-2.0, 0.5, 2.0]), knots.tolist(), logits.tolist()))
    assert found[0] == pytest.approx(0.1, abs=0.04) and (found[1:] > 0.93).all()


def test_what_is_said_keeps_its_order_and_without_a_curve_its_value() -> None:
    said = np.linspace(-9.0, 9.0, 50)
    assert meant(said, [0.0], [0.0]) == pytest.approx(said)
    assert (np.diff(meant(said, [-1.0, 1.0], [-2.0, 3.0])) > 0.0).all()
    rare = borne_out(np.arange(480.0), np.arange(480) % 100 != 7)  # the last, sure 40 after 440
    assert (np.diff(rare[1]) > 0.0).all()
    few = borne_out(said[:3], np.array([False, True, True]))
    assert [len(part) for part in few] == [1, 1] and few[1][0] == pytest.approx(np.log(2.5 / 1.5))
