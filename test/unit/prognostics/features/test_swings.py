"""Slews that swing by themselves: how much, and what then counts instead. Closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from ema_prognostics.features.balance import torque_balance
from ema_prognostics.features.dry_friction import dry_friction
from ema_prognostics.features.extract import extract
from ema_prognostics.features.signals import prepare
from ema_prognostics.features.vector import SWING, difference_names, differences, steady, swings
from ema_record.actuator import load_actuator
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate
from support.simulations import slewing_record

NAMES = ["quarter_even_m1_re", "high_low_quarter", "torque_rms_quarter",
         "speed_over_angle_quarter", "torque_quarter", "swing_quarter", "swing_full"]
HEALTHY = np.array([0.1, -4.0, -1.0, 0.2, -0.8, 0.001, 0.0005])


def record_of(quarter: float = 0.1, full: float = 0.0005) -> np.ndarray:
    return np.array([[29.0, -2.0, -0.5, 0.9, -0.7, quarter, full]])


@pytest.mark.parametrize("order", [0.62, 1.25, 2.4])
def test_a_swing_is_its_amplitude(order: float) -> None:
    record = slewing_record(speed_lines=[(order, 20.0, 0.4)])
    found = torque_balance(prepare(record), 0.1, 0.36, 20).swing
    assert found == pytest.approx(20.0 / 790.6, rel=0.06)


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_what_the_rotor_repeats_is_no_swing(order: int) -> None:
    record = slewing_record(speed_lines=[(order, 20.0, 0.4)])
    assert torque_balance(prepare(record), 0.1, 0.36, 20).swing < 0.05 * 20.0 / 790.6


def test_nor_is_a_drift_or_noise() -> None:
    record = slewing_record(noise=0.5)
    record.samples[:, 1] += 10.0 * record.time
    assert torque_balance(prepare(record), 0.1, 0.36, 20).swing < 0.2 * SWING


def test_nor_is_what_is_left_of_the_way_to_a_ramp() -> None:
    record, actuator = slewing_record(noise=0.02), load_actuator()
    arrival = actuator.control.position_gain / actuator.gear.ratio
    record.samples[:, 1] -= 30.0 * np.exp(-arrival * (record.time - 0.1))
    assert torque_balance(prepare(record), 0.1, 0.2, 8).swing < SWING


def test_a_limit_cycle_is_taken_off_the_lines() -> None:
    own = [(1, 6.0, 0.3), (2, 9.0, -0.7)]
    alone = torque_balance(prepare(slewing_record(speed_lines=own)), 0.1, 0.36, 20)
    cycle = [(1.23, 80.0, 0.4), (2.46, 12.0, 1.0), (3.69, 5.0, 2.0)]
    found = torque_balance(
        prepare(slewing_record(speed_lines=[*own, *cycle])), 0.1, 0.36, 20)
    assert found.swing == pytest.approx(80.0 / 790.6, rel=0.1) and found.told.all()
    assert abs(found.residual - alone.residual).max() < 0.02 * abs(alone.residual).max()
    # Without it line 1 alone is off by several times itself.
    assert all(found.high[band] < alone.high[band] + 0.02 * abs(alone.residual).max()
               for band in found.high)


def test_a_line_that_an_overtone_falls_onto_is_not_told() -> None:
    record = slewing_record(speed_lines=[(1.5, 80.0, 0.4), (3.0, 12.0, 1.0)])
    assert torque_balance(prepare(record), 0.1, 0.36, 20).told.tolist() == [
        True, True, False, True, True, False]


def test_a_single_jolt_is_no_limit_cycle() -> None:
    record = slewing_record()
    record.samples[:, 1] += 100.0 * np.exp(-((record.time - 0.2) / 0.005) ** 2)
    assert torque_balance(prepare(record), 0.1, 0.36, 20).swing < 0.1 * SWING


def test_noise_is_none_however_large_and_a_cycle_within_it_is() -> None:
    assert torque_balance(prepare(slewing_record(noise=20.0)), 0.1, 0.36, 20).swing == 0.0
    record = slewing_record(speed_lines=[(1.4, 3.0, 0.4)], noise=0.5)
    found = torque_balance(prepare(record), 0.1, 0.36, 20).swing
    assert found == pytest.approx(3.0 / 790.6, rel=0.1) and found > SWING


def test_a_strong_ripple_of_the_rotor_is_none_although_samples_lie_otherwise_each_turn() -> None:
    record = slewing_record(speed_lines=[(1, 60.0, 0.4), (5, 40.0, 1.0)])
    assert torque_balance(prepare(record), 0.1, 0.36, 20).swing < 0.1 * SWING


def test_scatter_of_a_slew_that_swings_is_that_of_a_healthy_unit() -> None:
    found = steady(NAMES, record_of(), HEALTHY)[0]
    assert found.tolist() == [29.0, -2.0, -1.0, 0.2, -0.7, 0.001, 0.0005]


def test_a_steady_one_counts_and_by_how_much_is_no_feature() -> None:
    found = steady(NAMES, record_of(quarter=0.5 * SWING), HEALTHY)[0]
    assert found.tolist() == [29.0, -2.0, -0.5, 0.9, -0.7, 0.001, 0.0005]


def test_where_all_slews_swing_or_usual_ones_do_the_features_stay() -> None:
    assert steady(NAMES, record_of(full=0.1), HEALTHY)[0, 2] == -0.5
    usual = HEALTHY.copy()
    usual[5] = 0.05
    assert steady(NAMES, record_of(), usual)[0, 2] == -0.5


@pytest.mark.parametrize(("record", "baseline"), [(0.1, 0.001), (0.001, 0.1)])
def test_with_a_baseline_both_must_be_steady(record: float, baseline: float) -> None:
    names = difference_names(NAMES)
    x = differences(record_of(quarter=record), record_of(quarter=baseline))
    assert swings(names, x).tolist() == [[True, False]]
    expected = differences(HEALTHY[None], HEALTHY[None])[0]
    found = steady(names, x, expected)[0]
    assert found[2] == 0.0 and found[len(NAMES) + 2] == HEALTHY[2]
    assert found[len(NAMES)] == 29.0


def test_without_such_features_nothing_is_done() -> None:
    x = np.ones((3, 2))
    assert np.array_equal(steady(["full_even_m1_re", "torque_full"], x, np.zeros(2)), x)


def test_a_limit_cycle_of_the_surface_is_a_swing_and_its_torque_no_friction() -> None:
    # Stick-slip: much more static than dynamic friction, hardly any damping of the shaft.
    nominal = load_actuator()
    loose = nominal._replace(
        surface=nominal.surface._replace(static_friction=3.0 * nominal.surface.dynamic_friction),
        shaft=nominal.shaft._replace(damping=0.25 * nominal.shaft.damping))
    record = simulate(load_profile("extended"), actuator=loose, seed=3)
    found = extract(record, "extended", nominal)
    assert found["swing_quarter"] > 5.0 * SWING > SWING > 10.0 * found["swing_full"]
    level = [np.exp(found[f"torque_{name}"]) for name in ("ramp", "quarter", "full")]
    assert level[0] + (level[2] - level[0]) * 0.2 == pytest.approx(level[1], rel=0.03)


def test_a_steady_slew_keeps_its_torque() -> None:
    signals = prepare(simulate(load_profile("extended"), seed=3, effects=parse_effects([])))
    slews = {"full": (0.08, 0.4, 30), "full_back": (0.66, 0.86, 12),
             "quarter": (1.1, 1.4, 4), "quarter_back": (1.6, 1.9, 4)}
    balances = {name: torque_balance(signals, *slew) for name, slew in slews.items()}
    _, found = dry_friction(signals, balances, [(2.1, 2.4), (2.7, 2.9)], 0.4)
    assert found == balances
