"""The features on simulated records: closed forms."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest

from ema_prognostics.cascade.lines import ACROSS
from ema_prognostics.features.extract import extract
from ema_prognostics.features.signals import prepare
from ema_prognostics.features.start import StartFit, fit_start
from ema_record.errors import IncompleteRecordError
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate
from support.actuators import DEFAULT, Machine, both_machines


@cache
def features(machine: Machine, *settings: str) -> Mapping[str, float]:
    record = simulate(load_profile("extended"), actuator=machine.actuator, rate=machine.rate,
                      effects=parse_effects(settings), seed=11)
    return extract(record, "extended", machine.actuator)


def line(found: Mapping[str, float], h: int) -> complex:
    return 1e-3 * complex(found[f"quarter_even_m{h}_re"], found[f"quarter_even_m{h}_im"])


@both_machines
@pytest.mark.parametrize("phase", "abc")
def test_short_gives_the_second_and_fourth_line(machine: Machine, phase: str) -> None:
    x, healthy = 0.05, features(machine)
    found = features(machine, f"turn_short.fraction={x}", f"turn_short.phase={phase}")
    second = line(found, 2) - line(healthy, 2)
    assert abs(second) == pytest.approx(0.278 * x, rel=0.1)
    assert abs(line(found, 4) - line(healthy, 4)) == pytest.approx(0.132 * x, rel=0.2)
    angle = np.angle(second * np.exp(2j * np.pi * 2 * "abc".index(phase) / 3.0))
    assert abs(angle) < 0.15


def test_eccentricity_gives_odd_lines() -> None:
    healthy = features(DEFAULT)
    found = features(DEFAULT, "rotor_eccentricity.zeta=0.02", "rotor_eccentricity.mode=common")
    assert abs(line(found, 1) - line(healthy, 1)) == pytest.approx(0.02, rel=0.1)
    assert abs(line(found, 2) - line(healthy, 2)) < 1e-3


@pytest.mark.parametrize("angle", [0.0, 0.8, 1.57])
def test_third_line_across_is_a_third_of_that_along(angle: float) -> None:
    found = features(DEFAULT, "rotor_eccentricity.zeta=0.08", "rotor_eccentricity.mode=shifted",
                     f"rotor_eccentricity.angle={angle}")
    third = line(found, 3)
    assert np.hypot(third.real, ACROSS * third.imag) == pytest.approx(0.6 * 0.08, rel=0.03)
    assert abs(third.imag) == pytest.approx(0.2 * 0.08 * np.sin(angle), abs=1e-3)


@both_machines
def test_gap_is_the_backlash(machine: Machine) -> None:
    healthy = features(machine)
    assert 1e-4 * healthy["gap_width"] == pytest.approx(1e-4, abs=1.5e-5)
    found = features(machine, "backlash.increase=5e-4")
    assert 1e-4 * found["gap_width"] == pytest.approx(6e-4, abs=3e-5)
    assert found["gap_torque"] == pytest.approx(healthy["gap_torque"], abs=0.03)


@pytest.mark.parametrize("increase", [2e-3, 4e-3])
def test_wide_lost_motion_is_read_until_the_surface_moves(increase: float) -> None:
    """It takes longer to cross than the nominal play, for which a test has the time at least."""
    found = features(DEFAULT, f"backlash.increase={increase}")
    assert 1e-4 * found["gap_width"] == pytest.approx(1e-4 + increase, rel=0.03)


@pytest.mark.parametrize("settings", [
    ("turn_short.fraction=0.15", "turn_short.phase=b"),
    ("rotor_eccentricity.zeta=0.2", "rotor_eccentricity.mode=static"),
])
@pytest.mark.parametrize("angle", [0.0, 2.0, 4.0])
def test_unequal_phases_are_no_lost_motion(settings: tuple[str, ...], angle: float) -> None:
    record = simulate(load_profile("extended"), effects=parse_effects(settings), seed=3,
                      start_angle=angle)
    found = extract(record, "extended", DEFAULT.actuator)
    assert 1e-4 * found["gap_width"] == pytest.approx(1e-4, abs=1.5e-5)


@both_machines
def test_friction_of_motor_and_surface_part(machine: Machine) -> None:
    a, healthy = machine.actuator, features(machine)
    motor = features(machine, "motor_friction.increase=0.3")
    surface = features(machine, "surface_friction.increase=0.3")
    dry, of_surface = a.motor.dynamic_friction, a.surface.dynamic_friction / a.gear.ratio
    rise = {n: np.exp(f["torque_quarter"]) - np.exp(healthy["torque_quarter"])
            for n, f in (("motor", motor), ("surface", surface))}
    assert rise["motor"] == pytest.approx(0.3 * dry, rel=0.05)
    assert rise["surface"] == pytest.approx(0.3 * of_surface, rel=0.05)
    assert np.exp(motor["gap_torque"]) == pytest.approx(1.3 * dry, rel=0.04)
    assert np.exp(surface["gap_torque"]) == pytest.approx(dry, rel=0.04)


@both_machines
def test_sensor_errors_do_not_reach_the_lines(machine: Machine) -> None:
    healthy = features(machine)
    found = features(machine, "current_sensor_gain.phase_a=0.01",
                     "current_sensor_offset.phase_b=0.05")
    for h in (1, 2, 4):
        assert abs(line(found, h) - line(healthy, h)) < 1e-3


def test_cut_record_is_refused() -> None:
    record = simulate(load_profile("extended"), seed=1)
    cut = Record(samples=record.samples[:30_000], profile=record.profile)
    with pytest.raises(IncompleteRecordError):
        extract(cut, "extended")


@pytest.mark.parametrize(("twist", "crossed"), [(-1.0, 1.1), (0.0, 0.55), (1.0, 0.0)])
def test_a_start_shows_the_lost_motion_that_it_crosses(twist: float, crossed: float) -> None:
    """Whole, half or nothing of 1.1 mrad, by how the last move has left the shaft."""
    record = simulate(load_profile("step"), effects=parse_effects(["backlash.increase=0.001"]),
                      seed=3, noise=0.5, start=(-0.4, 1e-3 * twist))
    found = extract(record, "step")
    assert crossed - 0.15 <= found["start_gap_least"] <= crossed + 0.1
    assert found["start_gap_most"] > 1.05


@pytest.mark.parametrize("viscous", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("worn", [[], ["motor_friction.increase=0.5"]])
def test_a_start_tells_viscous_from_dry_friction(viscous: float, worn: list[str]) -> None:
    motor = DEFAULT.actuator.motor
    grease = motor._replace(viscous_friction=viscous * motor.viscous_friction)
    record = simulate(load_profile("step"), actuator=DEFAULT.actuator._replace(motor=grease),
                      effects=parse_effects(worn), seed=1, start=(-0.4, 0.0))
    assert extract(record, "step")["start_viscous"] == pytest.approx(viscous, abs=0.3)


def test_a_start_of_a_few_samples_tells_no_lost_motion() -> None:
    signals = prepare(simulate(load_profile("step"), seed=3))
    wound = DEFAULT.actuator.wind_up / DEFAULT.actuator.gear.ratio
    assert fit_start(signals, slice(440, 450), np.zeros(10), 1.0) == pytest.approx(
        StartFit(0.0, 3.0 * wound, 1.0))
