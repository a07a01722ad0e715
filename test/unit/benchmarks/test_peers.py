"""Peers on the panel: their limits, their answers to problems with a known term."""

import numpy as np
import pytest

from benchmarks.peers.__main__ import sets_of
from benchmarks.peers.methods import METHODS, limits
from benchmarks.peers.ports import Problem, recalibrated

N = 1600


def problem(seed, size=0.0):
    """Return white noise, a known part and, times `size`, the second term."""
    rng = np.random.default_rng(seed)
    turn = np.linspace(0.0, 60.0, N)
    columns = np.column_stack([np.cos(turn), np.sin(turn), np.sign(np.sin(0.7 * turn)),
                               np.cos(3.1 * turn)])
    base = np.linspace(-1.0, 1.0, N)[:, None]
    raw = rng.standard_normal(N) + 0.5 * base[:, 0] + size * columns[:, 2]
    names = ["cogging_torque.1_cos", "cogging_torque.1_sin",
             "motor_friction.increase|surface_friction.increase", "stribeck_friction.10"]
    return Problem("motor torque", columns, names, recalibrated(raw, base), raw, base,
                   (np.sin(0.1 * turn) > 0.0).astype(int))


@pytest.mark.parametrize("name", METHODS)
def test_a_peer_names_the_term_that_is_there_and_nothing_else(name):
    method = METHODS[name]
    if method.absent:
        pytest.skip(f"{method.package} is not installed")
    limit = limits([method.scores(problem(seed)) for seed in range(20)])
    columns, other = method.answer([problem(99, size=0.8)], limit)
    assert sets_of(columns) == [["motor_friction", "surface_friction"]]
    assert not other
    assert sum(method.answer([problem(seed)], limit)[0] != [] for seed in range(20)) == 0


@pytest.mark.parametrize("name", METHODS)
def test_a_port_that_stands_still_is_no_anomaly(name):
    """As the supply of a unit that does not sag: its voltage repeats to the last bit."""
    method = METHODS[name]
    if method.absent:
        pytest.skip(f"{method.package} is not installed")
    still = problem(0)._replace(response=np.zeros(N), raw=np.zeros(N))
    limit = limits([method.scores(problem(0)._replace(port="supply")), method.scores(still)])
    assert all(np.isfinite(score) for score in method.scores(still).values())
    assert method.answer([still], limit) == ([], False)


def test_limits_are_kept_by_all_healthy_units_also_where_one_lacks_a_region():
    limit = limits([{"a": 1.0, "b": 7.0}, {"a": 2.0}])
    assert limit == {"a": 2.0, "b": 7.0}


def test_columns_of_one_effect_are_one_set():
    assert sets_of(["turn_short.0", "phase_resistance_imbalance.0|turn_short.0",
                    "backlash.increase"]) == [["turn_short"], ["backlash"]]
