"""A guard made of drawn features: what it turns away, and what it must not."""

from __future__ import annotations

import numpy as np
import pytest

from ema_prognostics.cascade.classes import KINDS_FOUND
from ema_prognostics.cascade.guard import (
    ALONE,
    BETTER_IS_LESS,
    Guard,
    checked_of,
    drivers_of,
    limits_of,
    signed,
)
from ema_prognostics.cascade.guard_groups import group_columns
from ema_prognostics.training.guard_training import GuardRecords, train_guard

NAMES = ["torque_quarter", "noise_speed", "position_step", "temperature", "inertia",
         "speed_rms_quarter", "control_gain", "reference_sum"]
N = 3000


def records(rng: np.random.Generator, n: int = N) -> np.ndarray:
    """Return squashed features: the scatter of speed and gain grows with the noise."""
    noise = rng.uniform(-1.0, 1.0, n)
    wide = np.exp(noise)
    return np.column_stack([
        rng.normal(size=n), noise, rng.choice([0.0, 2.0], n, p=[0.9, 0.1]),
        rng.uniform(-1.0, 1.0, n), rng.normal(size=n) * 0.5,
        noise + 0.1 * rng.normal(size=n), 0.1 * wide * rng.normal(size=n),
        0.1 * rng.normal(size=n),
    ])


@pytest.fixture(scope="module")
def guard() -> Guard:
    rng = np.random.default_rng(0)
    kinds = rng.integers(0, len(KINDS_FOUND), N)
    known = records(rng)
    part = train_guard(
        GuardRecords(known=known, known_kind=kinds, weight=np.ones(N), other=records(rng),
                     kind=kinds, healthy=records(rng)),
        NAMES, "extended", seed=1, iterations=60)
    return Guard(
        drivers=np.array([NAMES.index(n) for n in part.drivers]),
        checked=np.array([NAMES.index(n) for n in part.checked]), signed=signed(part.checked),
        mean=part.mean.build(), scale=part.scale.build(),
        limits=tuple(limits_of(part.limits[k], part.checked)  # type: ignore[index]
                     for k in KINDS_FOUND),
        groups=tuple(group_columns(tuple(part.checked))))


def score(guard: Guard, **changed: float) -> float:
    x = np.zeros((1, len(NAMES)))
    for name, value in changed.items():
        x[0, NAMES.index(name)] = value
    return float(guard.scores(x, np.array([0]))[0].max())


def test_few_healthy_records_are_turned_away(guard: Guard) -> None:
    scores, _ = guard.scores(records(np.random.default_rng(9)), np.zeros(N, dtype=int))
    assert np.mean(scores.max(axis=1) > 1.0) < 0.008  # three rules of 0.1 %


def test_noise_and_rounding_are_judged_on_the_bad_side_only(guard: Guard) -> None:
    assert score(guard, noise_speed=-1.0, speed_rms_quarter=-1.0) < 1.0
    assert score(guard, noise_speed=1.8, speed_rms_quarter=1.8) > 1.0
    assert score(guard, position_step=2.0) < 1.0
    assert score(guard, position_step=4.0) > 1.0
    assert score(guard, reference_sum=-50.0) == score(guard, reference_sum=0.0) < 1.0
    assert score(guard, reference_sum=2.0) > 1.0


def test_scatter_is_less_than_the_noise_lets_expect(guard: Guard) -> None:
    assert score(guard, noise_speed=0.8, speed_rms_quarter=-3.0) < 1.0
    assert score(guard, noise_speed=0.8, speed_rms_quarter=2.0) > 1.0


def test_what_a_noisy_record_may_show_a_quiet_one_may_not(guard: Guard) -> None:
    assert score(guard, control_gain=0.45, noise_speed=-0.9, speed_rms_quarter=-0.9) > 1.0
    assert score(guard, control_gain=0.45, noise_speed=0.9, speed_rms_quarter=0.9) < 1.0
    assert score(guard, control_gain=-0.45, noise_speed=-0.9, speed_rms_quarter=-0.9) > 1.0


def test_the_recorder_is_a_driver_and_judged_by_itself() -> None:
    names = [*NAMES, "viscous_share"]
    assert {n for n in names if n in ALONE} <= set(drivers_of(names, "extended"))
    assert {n for n in names if n in ALONE} <= set(checked_of(names, "extended"))
    assert not signed(["high_low_full", "noise_speed", "sum_rms"]).any()
    assert signed(["inertia", "control_gain", "viscous_share"]).all()
    assert "reference_sum" in BETTER_IS_LESS


def test_what_an_ideal_machine_has_none_of_is_judged_where_no_fault_moves_it() -> None:
    none_of = ["winding_unlike", "offset_largest", "gain_largest", "reference_spread"]
    assert not signed(none_of).any()
    checked = checked_of([*none_of, "winding_like_best", "surface_torque"], "extended")
    assert checked == none_of


@pytest.mark.parametrize("kind", ["step", "extended"])
def test_features_that_a_drive_does_not_have_are_no_matter(kind: str) -> None:
    names = ["torque_full", "speed_full", "temperature", "inertia"]
    assert set(drivers_of(names, kind)) <= set(names)
    assert "inertia" in checked_of(names, kind)
