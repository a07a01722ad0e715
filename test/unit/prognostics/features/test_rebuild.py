"""Channels that were not recorded, rebuilt: against the channels that were there."""

from __future__ import annotations

import numpy as np
import pytest

from ema_prognostics.features.balance import line_orders, other_orders, torque_balance
from ema_prognostics.features.extract import extract
from ema_prognostics.features.signals import prepare
from ema_record.actuator import FOC, load_actuator
from ema_record.channels import (
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
)
from ema_record.errors import InvalidRecordError
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects
from ema_sim.rebuild import completed, torque_command, torque_signs
from ema_sim.simulate import simulate
from support.simulations import record_of, slewing_record, without

ACTUATOR = load_actuator()


def test_the_third_current_is_what_the_star_point_leaves() -> None:
    record = slewing_record(current=6.0)
    found = completed(without(record, 4), ACTUATOR)
    np.testing.assert_allclose(found[:, PHASE_CURRENTS].sum(axis=1), 0.0, atol=1e-9)


def test_the_angle_of_the_whole_test_is_found_to_two_degrees() -> None:
    record = record_of("extended", seed=1)
    found = completed(without(record, ROTOR_ANGLE), ACTUATOR)[:, ROTOR_ANGLE]
    off = np.angle(np.exp(1j * (found - record.samples[:, ROTOR_ANGLE])))
    assert abs(off).max() < np.deg2rad(2.0)


def test_the_position_follows_the_motor_through_the_gear() -> None:
    record = record_of("extended", seed=1)
    found = completed(without(record, SURFACE_POSITION), ACTUATOR)[:, SURFACE_POSITION]
    # Wind-up and lost motion are what it cannot know, and the noise of the integrated speed.
    allowed = 2.0 * ACTUATOR.wind_up / ACTUATOR.gear.ratio
    assert abs(found - record.samples[:, SURFACE_POSITION]).max() < allowed


@pytest.mark.parametrize(("lost", "missing"), [
    ((4,), set()), ((SURFACE_POSITION,), {"lag_ramp", "position_step", "start_position"}),
    ((5, 6, 7), {"winding_inductance", "rise_full", "control_delay", "reference_rms"}),
])
def test_features_without_a_channel_are_fewer_and_else_alike(
    lost: tuple[int, ...], missing: set[str]
) -> None:
    record = record_of("extended", seed=1)
    whole, part = (extract(r, "extended") for r in (record, without(record, *lost)))
    assert missing <= set(whole) - set(part)
    assert not set(part) - set(whole)
    for name, tolerance in (("torque_quarter", 0.01), ("gap_width", 0.2), ("inertia", 0.01)):
        assert part[name] == pytest.approx(whole[name], abs=tolerance)


def test_references_are_the_current_that_flows_commutated() -> None:
    record = slewing_record(current=6.0)
    found = completed(without(record, 5, 6, 7), ACTUATOR)
    asked = torque_command(found[:, REFERENCE_CURRENTS], found[:, ROTOR_ANGLE], ACTUATOR)
    np.testing.assert_allclose(asked[1000:], 6.0, atol=0.05)


def test_sinusoidal_references_ask_for_their_amplitude() -> None:
    foc = ACTUATOR._replace(drive=ACTUATOR.drive._replace(kind=FOC))
    theta = np.linspace(0.0, 20.0, 101)
    np.testing.assert_allclose(torque_command(3.0 * torque_signs(theta, foc), theta, foc), 3.0)


def test_two_currents_and_the_speed_are_needed() -> None:
    record = slewing_record()
    for columns in ((2, 3), (1,), (0,)):
        with pytest.raises(InvalidRecordError, match="two phase currents are needed"):
            completed(without(record, *columns), ACTUATOR)


def test_lines_of_one_pole_pair_are_the_first_six() -> None:
    assert line_orders(1) == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert line_orders(4) == (0.25, 2.0, 2.25, 4.0, 4.25, 6.0)


def test_an_eccentric_rotor_of_four_pole_pairs_has_a_first_line() -> None:
    four = ACTUATOR._replace(motor=ACTUATOR.motor._replace(pole_pairs=4))
    record = slewing_record(current_lines=[(0.25, 0.35, 0.4)])
    found = torque_balance(prepare(record, four), 0.1, 0.36, 20)
    # Which of the four turns of the electrical angle a turn of the rotor begins with, no record
    # tells: the direction is known up to a quarter.
    assert found.residual[0] ** 4 == pytest.approx(0.05**4 * np.exp(1.6j), abs=1e-6)
    assert abs(found.residual[1:5]).max() < 3e-3


def test_teeth_that_are_no_multiple_of_the_pole_pairs_have_a_line() -> None:
    """17 teeth a turn of the rotor: 3.4 periods an electrical turn; beside 4 is eccentricity."""
    five = ACTUATOR._replace(motor=ACTUATOR.motor._replace(pole_pairs=5))
    orders = other_orders(5)
    assert 3.4 in orders and not {2.0, 3.8, 4.0, 4.2} & set(orders)
    assert other_orders(1).tolist() == list(range(7, 37))
    high = {line: torque_balance(
        prepare(slewing_record(current_lines=[(line, 0.35, 0.4)]), five), 0.1, 0.36, 20
    ).high["low"] for line in (3.4, 4.2)}
    assert high[3.4] == pytest.approx(0.05, rel=0.02)
    assert high[4.2] < 0.01


@pytest.mark.parametrize(("mode", "line", "part"), [("common", 1, 1.0), ("shifted", 3, 0.413)])
def test_lines_of_the_rotor_are_the_same_in_all_slews(mode: str, line: int, part: float) -> None:
    """Even and equal at both speeds: each slew begins with another of the electrical turns.

    `part` of ζ: the closed form of the modulated torque, 1.24 / 3 of the mean for `shifted`.
    """
    four = ACTUATOR._replace(motor=ACTUATOR.motor._replace(pole_pairs=4))
    effects = parse_effects(["rotor_eccentricity.zeta=0.1", f"rotor_eccentricity.mode={mode}",
                             "rotor_eccentricity.angle=0.3"])
    record = simulate(load_profile("extended"), actuator=four, effects=effects, seed=5)
    found = extract(record, "extended", four)
    even, slow, odd = (
        abs(complex(found[f"{name}_m{line}_re"], found[f"{name}_m{line}_im"]))
        for name in ("full_even", "quarter_even", "full_odd"))
    assert even == pytest.approx(100.0 * part, rel=0.15)
    assert slow == pytest.approx(100.0 * part, rel=0.10)
    assert odd < 0.6 * even
