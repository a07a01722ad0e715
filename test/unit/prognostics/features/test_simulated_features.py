"""The features on simulated records: closed forms."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from ema_prognostics.features.extract import extract
from ema_record.errors import IncompleteRecordError
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate


def features(*settings: str) -> Mapping[str, float]:
    record = simulate(load_profile("extended"), effects=parse_effects(settings), seed=11)
    return extract(record, "extended")


@pytest.fixture(scope="module")
def healthy() -> Mapping[str, float]:
    return features("winding_temperature.temperature=20")


def line(found: Mapping[str, float], h: int) -> complex:
    return 1e-3 * complex(found[f"quarter_even_m{h}_re"], found[f"quarter_even_m{h}_im"])


@pytest.mark.parametrize("phase", "abc")
def test_short_gives_the_second_and_fourth_line(
    healthy: Mapping[str, float], phase: str
) -> None:
    x = 0.05
    found = features(f"turn_short.fraction={x}", f"turn_short.phase={phase}")
    second = line(found, 2) - line(healthy, 2)
    assert abs(second) == pytest.approx(0.278 * x, rel=0.1)
    assert abs(line(found, 4) - line(healthy, 4)) == pytest.approx(0.132 * x, rel=0.2)
    angle = np.angle(second * np.exp(2j * np.pi * 2 * "abc".index(phase) / 3.0))
    assert abs(angle) < 0.15


def test_eccentricity_gives_odd_lines(healthy: Mapping[str, float]) -> None:
    found = features("rotor_eccentricity.zeta=0.02", "rotor_eccentricity.mode=common")
    assert abs(line(found, 1) - line(healthy, 1)) == pytest.approx(0.02, rel=0.1)
    assert abs(line(found, 2) - line(healthy, 2)) < 1e-3


def test_gap_is_the_backlash(healthy: Mapping[str, float]) -> None:
    assert 1e-4 * healthy["gap_width"] == pytest.approx(1e-4, abs=1.5e-5)
    found = features("backlash.increase=5e-4")
    assert 1e-4 * found["gap_width"] == pytest.approx(6e-4, abs=3e-5)
    assert found["gap_torque"] == pytest.approx(healthy["gap_torque"], abs=0.03)


def test_friction_of_motor_and_surface_part(healthy: Mapping[str, float]) -> None:
    motor = features("motor_friction.increase=0.3")
    surface = features("surface_friction.increase=0.3")
    # 0.30 N m of the motor; 60 N m / 500 of the surface: 0.09 and 0.036 N m more.
    rise = {n: np.exp(f["torque_quarter"]) - np.exp(healthy["torque_quarter"])
            for n, f in (("motor", motor), ("surface", surface))}
    assert rise["motor"] == pytest.approx(0.090, rel=0.05)
    assert rise["surface"] == pytest.approx(0.036, rel=0.05)
    assert np.exp(motor["gap_torque"]) == pytest.approx(0.39, rel=0.04)
    assert np.exp(surface["gap_torque"]) == pytest.approx(0.30, rel=0.04)


def test_sensor_errors_do_not_reach_the_lines(healthy: Mapping[str, float]) -> None:
    found = features("current_sensor_gain.phase_a=0.01", "current_sensor_offset.phase_b=0.05")
    for h in (1, 2, 4):
        assert abs(line(found, h) - line(healthy, h)) < 1e-3


def test_cut_record_is_refused() -> None:
    record = simulate(load_profile("extended"), seed=1)
    cut = Record(samples=record.samples[:30_000], profile=record.profile)
    with pytest.raises(IncompleteRecordError):
        extract(cut, "extended")
