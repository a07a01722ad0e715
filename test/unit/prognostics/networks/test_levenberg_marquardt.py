"""Training of the paper's networks: Jacobian, determinism, what they can learn."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from ema_prognostics.networks.levenberg_marquardt import jacobian, residuals, train


@pytest.mark.parametrize(("d", "h", "k"), [(1, 1, 1), (3, 4, 2), (5, 2, 3)])
def test_jacobian_equals_finite_differences(d, h, k):
    rng = np.random.default_rng(d + h + k)
    x, t = rng.normal(size=(6, d)), rng.uniform(size=(6, k))
    w = rng.normal(size=(d + 1) * h + (h + 1) * k)
    exact = jacobian(w, x, t, h, 0.02)
    for row in range(len(exact)):
        numeric = approx_fprime(w, lambda v, r=row: residuals(v, x, t, h, 0.02)[r], 1e-7)
        np.testing.assert_allclose(exact[row], numeric, atol=2e-6)


def test_learns_what_is_not_linearly_separable():
    rng = np.random.default_rng(1)
    x = rng.uniform(-1, 1, size=(300, 2))
    same = x[:, 0] * x[:, 1] > 0
    target = np.column_stack([same, ~same]).astype(float)
    network = train(x[:200], target[:200], hidden=8, n_restarts=5)
    assert np.mean((network(x[200:])[:, 0] > 0.5) == same[200:]) > 0.9


def test_rows_that_carry_two_ones_are_learned_as_such():
    x = np.linspace(0, 1, 21)[:, None]
    target = np.zeros((21, 2), dtype=int)
    target[:14, 0] = 1
    target[13:, 1] = 1
    network = train(x, target, hidden=4, alpha=1e-6, n_restarts=3)
    np.testing.assert_array_equal(network(x) > 0.5, target)


def test_same_seed_same_bytes_and_a_constant_input_does_no_harm():
    rng = np.random.default_rng(2)
    x, t = rng.normal(size=(80, 3)), np.eye(3)[rng.integers(0, 3, size=80)]
    x[:, 1] = 4.0
    first, again, other = (train(x, t, seed=seed)(x).tobytes() for seed in (5, 5, 6))
    assert first == again != other


def test_more_restarts_never_fit_worse():
    rng = np.random.default_rng(3)
    x, t = rng.normal(size=(60, 2)), np.eye(2)[rng.integers(0, 2, size=60)]
    errors = [np.sum((train(x, t, alpha=1e-9, n_restarts=n)(x) - t) ** 2) for n in (1, 4)]
    assert errors[1] <= errors[0] * (1 + 1e-6)
