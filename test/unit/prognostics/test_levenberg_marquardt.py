"""The estimators: Jacobian, determinism, what scikit-learn expects."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from sklearn.utils.estimator_checks import estimator_checks_generator

from ema_prognostics.networks.levenberg_marquardt import (
    LevenbergMarquardtClassifier,
    LevenbergMarquardtRegressor,
    jacobian,
    n_weights,
    residuals,
)


@pytest.mark.parametrize("law", ["logsig", "linear"])
@pytest.mark.parametrize(("d", "h", "k"), [(1, 1, 1), (3, 4, 2), (5, 2, 3)])
def test_jacobian_equals_finite_differences(law, d, h, k):
    rng = np.random.default_rng(d + h + k)
    x, t = rng.normal(size=(6, d)), rng.uniform(size=(6, k))
    w = rng.normal(size=n_weights(d, h, k))
    exact = jacobian(w, x, t, h, law, 0.02)
    for row in range(len(exact)):
        numeric = approx_fprime(w, lambda v, r=row: residuals(v, x, t, h, law, 0.02)[r], 1e-7)
        np.testing.assert_allclose(exact[row], numeric, atol=2e-6)


NEEDS_OTHER_LIBRARIES = ("array_api", "pandas", "dataframe", "decision_function")


def contract_checks():
    for estimator in (
        LevenbergMarquardtClassifier(hidden=6, max_nfev=60),
        LevenbergMarquardtRegressor(hidden=6, max_nfev=60),
    ):
        for instance, check in estimator_checks_generator(estimator):
            name = getattr(check, "func", check).__name__
            if not any(word in name for word in NEEDS_OTHER_LIBRARIES):
                label = f"{type(estimator).__name__[18:]}-{name}"
                yield pytest.param(instance, check, id=label)


@pytest.mark.parametrize(("estimator", "check"), list(contract_checks()))
def test_scikit_learn_contract(estimator, check):
    check(estimator)


def test_learns_what_is_not_linearly_separable():
    rng = np.random.default_rng(1)
    x = rng.uniform(-1, 1, size=(300, 2))
    y = np.where(x[:, 0] * x[:, 1] > 0, "same", "opposite")
    network = LevenbergMarquardtClassifier(hidden=8, n_restarts=5).fit(x[:200], y[:200])
    assert network.score(x[200:], y[200:]) > 0.9


def test_regression_of_a_smooth_curve():
    x = np.linspace(-2, 2, 120)[:, None]
    network = LevenbergMarquardtRegressor(hidden=8, alpha=1e-6).fit(x, np.sin(2 * x[:, 0]))
    assert np.abs(network.predict(x) - np.sin(2 * x[:, 0])).max() < 0.02


def test_rows_that_carry_two_ones_are_learned_as_such():
    x = np.linspace(0, 1, 21)[:, None]
    target = np.zeros((21, 2), dtype=int)
    target[:14, 0] = 1
    target[13:, 1] = 1
    network = LevenbergMarquardtClassifier(hidden=4, alpha=1e-6, n_restarts=3).fit(x, target)
    np.testing.assert_array_equal(network.predict(x), target)


def test_same_seed_same_bytes_and_the_plain_network_agrees():
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(80, 3)), rng.integers(0, 3, size=80)
    first = LevenbergMarquardtClassifier(random_state=5).fit(x, y)
    again = LevenbergMarquardtClassifier(random_state=5).fit(x, y)
    other = LevenbergMarquardtClassifier(random_state=6).fit(x, y)
    assert first.weights_.tobytes() == again.weights_.tobytes()
    assert first.weights_.tobytes() != other.weights_.tobytes()
    np.testing.assert_array_equal(first.to_network()(x), first.outputs(x))
    assert first.cost_ == min(first.costs_)


@pytest.mark.parametrize("wrong", [{"hidden": 0}, {"alpha": 0.0}, {"n_restarts": 0}])
def test_hyper_parameters_out_of_bounds(wrong):
    with pytest.raises(ValueError, match="at least 1"):
        LevenbergMarquardtClassifier(**wrong).fit([[0.0], [1.0]], [0, 1])
