"""An ensemble kept as one network: exactly the mean of its members."""

from __future__ import annotations

import numpy as np
import pytest

from ema_prognostics.networks.descent import Perceptron, loss_and_gradient
from ema_prognostics.networks.fitting import fit_classifier, fit_regressor, merged


def member(rng: np.random.Generator) -> Perceptron:
    return Perceptron(rng.normal(size=(3, 5)), rng.normal(size=5), rng.normal(size=(5, 2)),
                      rng.normal(size=2))


def output(m: Perceptron, x: np.ndarray) -> np.ndarray:
    hidden = np.tanh(x @ m.first + m.first_bias)
    return np.asarray(hidden @ m.second + m.second_bias)


def test_merged_network_is_the_mean_of_the_members() -> None:
    rng = np.random.default_rng(0)
    members = [member(rng) for _ in range(3)]
    x = rng.normal(size=(20, 3))
    network = merged(members, "linear", np.array([1.0, 2.0]), np.array([3.0, 4.0]))
    mean = np.mean([output(m, x) for m in members], axis=0)
    assert np.allclose(network(x), [1.0, 2.0] + mean * [3.0, 4.0])


@pytest.mark.parametrize("loss", ["squares", "logistic"])
def test_gradient_is_that_of_the_loss(loss: str) -> None:
    rng = np.random.default_rng(4)
    x, target = rng.normal(size=(30, 3)), (rng.random((30, 2)) > 0.4).astype(float)
    weight = rng.uniform(0.5, 2.0, 30)
    w = rng.normal(size=3 * 4 + 4 + 4 * 2 + 2)

    def value(v: np.ndarray) -> float:
        return loss_and_gradient(v, x, target, weight, 4, loss, 2.0)[0]  # type: ignore[arg-type]

    _, gradient = loss_and_gradient(w, x, target, weight, 4, loss, 2.0)  # type: ignore[arg-type]
    step = 1e-6
    for k in range(len(w)):
        d = step * (np.arange(len(w)) == k)
        assert gradient[k] == pytest.approx((value(w + d) - value(w - d)) / (2 * step), abs=1e-7)


def test_a_record_of_double_weight_is_two_records() -> None:
    rng = np.random.default_rng(7)
    x, y = rng.normal(size=(300, 2)), rng.normal(size=(300, 1))
    weight = np.where(np.arange(300) < 100, 2.0, 1.0)
    w = rng.normal(size=2 * 3 + 3 + 3 + 1)
    once = loss_and_gradient(w, x, y, weight * 300 / 400, 3, "squares", 0.0)
    twice = loss_and_gradient(w, np.vstack([x, x[:100]]), np.vstack([y, y[:100]]), np.ones(400),
                              3, "squares", 0.0)
    assert once[0] == pytest.approx(twice[0])
    assert once[1] == pytest.approx(twice[1])


def test_classifier_gives_the_probability() -> None:
    rng = np.random.default_rng(1)
    x = rng.normal(size=(3000, 2))
    p = 1.0 / (1.0 + np.exp(-2.0 * x[:, 0]))
    network = fit_classifier(x, rng.random(3000) < p, hidden=6, iterations=20, seed=1, members=2)
    assert np.abs(network(x)[:, 0] - p).mean() < 0.04


def test_regressor_follows_a_curve_and_the_seed_decides() -> None:
    rng = np.random.default_rng(2)
    x = rng.uniform(-2, 2, size=(1500, 1))
    y = np.sin(x) + 5.0
    first, second = (fit_regressor(x, y, hidden=10, iterations=150, seed=3) for _ in range(2))
    assert np.abs(first(x) - y).max() < 0.15
    assert np.array_equal(first(x), second(x))
    other = fit_regressor(x, y, hidden=10, iterations=5, seed=4)
    assert not np.array_equal(first(x), other(x))


@pytest.mark.parametrize("law", ["logsig", "linear"])
def test_one_member_is_itself(law: str) -> None:
    one = member(np.random.default_rng(5))
    x = np.random.default_rng(6).normal(size=(4, 3))
    out = merged([one], law, np.zeros(2), np.ones(2))(x)  # type: ignore[arg-type]
    expected = output(one, x)
    assert np.allclose(out, 1.0 / (1.0 + np.exp(-expected)) if law == "logsig" else expected)
