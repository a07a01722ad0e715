"""Winding, controller and inertia read off a record: what is put in comes out."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest

from ema_prognostics.cascade.inputs import MECHANICAL, mechanical
from ema_prognostics.features.extract import extract
from ema_prognostics.features.vector import rotate, start_allowed
from ema_record.actuator import Actuator, load_actuator
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate
from support.actuators import DEFAULT, OTHER, Machine, both_machines, changed


@cache
def features(*settings: str, actuator: Actuator = DEFAULT.actuator) -> Mapping[str, float]:
    record = simulate(load_profile("extended"), actuator=actuator,
                      effects=parse_effects(settings), seed=12)
    return extract(record, "extended", actuator)


@pytest.fixture(scope="module")
def healthy() -> Mapping[str, float]:
    return features()


@both_machines
def test_a_nominal_winding_is_nominal(
    machine: Machine, request: pytest.FixtureRequest
) -> None:
    if machine is OTHER:
        request.applymarker(pytest.mark.xfail(
            reason="drop of the switches read as -0.46 V at 10 kHz, where there is none"))
    healthy = features(actuator=machine.actuator)
    # An error of 0.02 Ω is a larger part of a smaller resistance.
    of_resistance = DEFAULT.actuator.motor.phase_resistance
    of_resistance /= machine.actuator.motor.phase_resistance
    for name, part in (("winding_inductance", 1.0), ("winding_resistance", of_resistance),
                       ("winding_back_emf", 1.0)):
        assert healthy[name] == pytest.approx(0.0, abs=0.02 * part)
    assert healthy["switch_drop"] == pytest.approx(0.0, abs=0.4)
    assert healthy["sensor_angle"] == pytest.approx(0.0, abs=10.0)
    assert np.exp(healthy["control_delay"]) == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize(("setting", "name", "value", "tolerance"), [
    ("torque_constant_drop.drop=0.1", "winding_back_emf", float(np.log(0.9)), 0.02),
    # 0.35 V low whatever the step of the simulation, 0.2 V of scatter over the seeds.
    ("inverter_voltage_drop.drop=4", "switch_drop", 4.0, 0.9),
    # 47 in the mean of ten seeds, 6 of scatter; without one 0, 3 of scatter.
    ("hall_misalignment.angle=0.05", "sensor_angle", 47.0, 15.0),
    ("phase_resistance_imbalance.increase=0.5", "resistance_m1_re", 50.0, 4.0),
    ("control_delay.delay=0.0003", "control_delay", float(np.log(0.3)), 0.1),
    ("inertia_change.motor=0.3", "inertia", float(np.log(1.3)), 0.06),
    ("bus_voltage_sag.resistance=1.0", "bus_sag", float(np.log(1.05)), 0.05),
])
def test_what_is_put_in_comes_out(setting: str, name: str, value: float, tolerance: float) -> None:
    assert features(setting)[name] == pytest.approx(value, abs=tolerance)


def test_resistance_of_another_phase_turns_into_that_of_phase_a() -> None:
    found = features("phase_resistance_imbalance.increase=0.5",
                     "phase_resistance_imbalance.phase=b")
    names = ["resistance_m1_re", "resistance_m1_im"]
    turned = rotate(np.array([[found[n] for n in names]]), names, 1)
    assert turned[0] == pytest.approx([50.0, 0.0], abs=4.0)


def test_friction_that_grows_with_load_bends_the_reversal(healthy: Mapping[str, float]) -> None:
    bent = features("load_dependent_friction.coefficient=0.2")
    assert bent["shaft_bend"] - healthy["shaft_bend"] > 0.1
    dry = features("motor_friction.increase=0.1", "surface_friction.increase=0.1")
    assert dry["shaft_bend"] == pytest.approx(healthy["shaft_bend"], abs=0.06)


def test_stiffness_is_free_of_friction_and_lost_motion(healthy: Mapping[str, float]) -> None:
    def of(found: Mapping[str, float]) -> dict[str, float]:
        names = list(found)
        return dict(zip(MECHANICAL, mechanical(names, np.array([list(found.values())]))[0]))

    usual = of(healthy)
    assert usual["compliance"] == pytest.approx(0.0, abs=0.1)
    worn = of(features("surface_friction.increase=0.5", "backlash.increase=3e-4"))
    assert worn["compliance"] == pytest.approx(usual["compliance"], abs=0.06)
    assert worn["viscous_torque"] == pytest.approx(usual["viscous_torque"], abs=0.006)
    soft = of(features("shaft_compliance.increase=0.5"))
    assert soft["compliance"] - usual["compliance"] == pytest.approx(np.log(1.5), abs=0.06)
    assert soft["stiffness_agreement"] == pytest.approx(usual["stiffness_agreement"], abs=0.08)


def test_a_start_within_tolerance_is_a_start() -> None:
    a = load_actuator()
    reach = 1e3 * a.wind_up / a.gear.ratio  # of a surface that friction holds
    x = np.array([[0.9 * reach, 1.0], [-reach - 0.3, 2.0]])
    found = start_allowed(x, ["start_position", "other"])
    assert found == pytest.approx(np.array([[0.0, 1.0], [-0.3, 2.0]]))
    assert start_allowed(x, ["a", "b"]).tolist() == x.tolist()


@pytest.mark.parametrize("offset", [-0.5, 0.5])
def test_a_converter_that_truncates_reads_the_speed_of_the_angle(offset) -> None:
    """But for half a step, in parts of the speed."""
    a = changed(converters={"speed_offset": offset})
    found = extract(simulate(load_profile("extended"), actuator=a, seed=2), "extended")
    step = a.converters.speed_range / 2.0**a.converters.speed_bits
    for name, share in (("full", 1.0), ("quarter", 0.25)):
        assert found[f"speed_over_angle_{name}"] == pytest.approx(
            1e3 * offset * step / (share * a.control.speed_limit), abs=0.05)  # per mille


def test_a_commutation_that_acts_late_is_not_taken_for_the_winding() -> None:
    """Of a description that says so; one that does not sees another inductance."""
    at_once, late = changed(), changed(acquisition={"commutation_latency": 3.0})
    names = ("winding_inductance", "winding_resistance", "winding_back_emf", "sensor_angle")
    usual, known, hidden = (
        extract(simulate(load_profile("extended"), actuator=unit, seed=2), "extended", described)
        for unit, described in ((at_once, at_once), (late, late), (late, at_once)))
    told, untold = (np.array([abs(found[name] - usual[name]) for name in names])
                    for found in (known, hidden))
    assert told[:3].max() < 0.02
    assert untold[0] > 5.0 * told[0]
