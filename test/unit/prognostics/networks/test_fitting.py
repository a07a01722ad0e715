"""An ensemble kept as one network: exactly the mean of its members."""

from __future__ import annotations

import numpy as np
import pytest

from ema_prognostics.networks.fitting import _merged, fit_classifier, fit_regressor


class Member:
    """What scikit-learn's perceptrons keep."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.coefs_ = [rng.normal(size=(3, 5)), rng.normal(size=(5, 2))]
        self.intercepts_ = [rng.normal(size=5), rng.normal(size=2)]

    def __call__(self, x: np.ndarray) -> np.ndarray:
        hidden = np.tanh(x @ self.coefs_[0] + self.intercepts_[0])
        return hidden @ self.coefs_[1] + self.intercepts_[1]


def test_merged_network_is_the_mean_of_the_members() -> None:
    rng = np.random.default_rng(0)
    members = [Member(rng) for _ in range(3)]
    x = rng.normal(size=(20, 3))
    network = _merged(members, "linear", np.array([1.0, 2.0]), np.array([3.0, 4.0]))
    mean = np.mean([m(x) for m in members], axis=0)
    assert np.allclose(network(x), [1.0, 2.0] + mean * [3.0, 4.0])


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
    member = Member(np.random.default_rng(5))
    x = np.random.default_rng(6).normal(size=(4, 3))
    out = _merged([member], law, np.zeros(2), np.ones(2))(x)  # type: ignore[arg-type]
    expected = member(x)
    assert np.allclose(out, 1.0 / (1.0 + np.exp(-expected)) if law == "logsig" else expected)
