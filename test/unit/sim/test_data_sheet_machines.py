"""Machines described from a data sheet alone follow the tests that were made for them."""

from dataclasses import replace

import numpy as np
import pytest

from ema_record.channels import ROTOR_ANGLE
from ema_record.checks.guard import guard_findings
from ema_record.data_sheet.derive import describe
from ema_record.data_sheet.sheet import read_sheet
from ema_record.profiles.design import default_profiles
from ema_record.profiles.plan import test_plan as plan_of
from ema_sim.rebuild import completed
from ema_sim.simulate import simulate

MACHINES = {
    "one pole pair, gear 500": {
        "resistance": "2.13ohm", "inductance": "1.44mH", "torque-constant": "75mNm/A",
        "pole-pairs": "1", "end-stop": "0.5rad", "current-limit": "21A", "inertia": "150gcm2",
        "gear": "500", "bus": "96V", "friction": "0.3Nm"},
    "eight pole pairs, gear 150": {
        "resistance": "2.28ohm", "inductance": "1.29mH", "kv": "184rpm/V", "pole-pairs": "8",
        "end-stop": "45deg", "current-limit": "4A", "inertia": "92.5gcm2", "gear": "150",
        "bus": "24V", "rate": "40kHz"},
    "270 V, gear 800": {
        "resistance": "0.4ohm", "inductance": "1.5mH", "back-emf": "0.35Vs/rad",
        "pole-pairs": "4", "end-stop": "20deg", "current-limit": "40A", "inertia": "6kgcm2",
        "gear": "800", "bus": "270V"},
}


@pytest.mark.parametrize("name", MACHINES)
def test_a_relay_machine_of_a_data_sheet_is_stable(name):
    actuator = describe(
        read_sheet(MACHINES[name], {"drive": "relay", "shape": "trapezoid"})).actuator
    profile = default_profiles(actuator)["extended"]
    plan = plan_of(profile, actuator)
    record = simulate(profile, actuator=actuator)
    time = record.time - profile.command_time
    speed, position = record.samples[:, 1], record.samples[:, 9]
    limit = actuator.control.speed_limit
    for part, share, close in (("full", 1.0, 0.002), ("quarter", 0.25, 0.01),
                               ("quarter_back", -0.25, 0.01)):
        segment = plan.segments[part]
        inside = (time >= segment.begin) & (time <= segment.end)
        assert speed[inside].mean() == pytest.approx(share * limit, rel=close)
        assert speed[inside].std() < 0.01 * limit
        turned = abs(speed[inside].sum()) / actuator.acquisition.rate / (2.0 * np.pi)
        assert turned * actuator.motor.pole_pairs >= segment.turns
    inside = (time >= plan.ramp[0]) & (time <= plan.ramp[1])
    assert speed[inside].mean() == pytest.approx(limit / 32.0, rel=0.1)
    reach = max(x for _, x in profile.points)
    assert position.max() < reach + 0.02 * actuator.surface.end_stop
    just_before = np.abs(record.time - (profile.points[3][0] - 2e-3)) < 1e-3
    assert position[just_before].mean() == pytest.approx(reach, rel=0.03)


@pytest.mark.parametrize("seed", range(2))
def test_a_relay_whose_band_is_wide_for_its_friction_reads_its_currents_right(seed):
    """Its mean current falls short of a small reference: no sensor's fault."""
    values = {
        "resistance": "1.2ohm", "inductance": "0.194mH", "kv": "475rpm/V", "pole-pairs": "1",
        "inertia": "34gcm2", "gear": "100", "end-stop": "40deg", "current-limit": "7.5A",
        "bus": "24V"}
    actuator = describe(read_sheet(values, {"drive": "relay"})).actuator
    record = simulate(default_profiles(actuator)["extended"], actuator=actuator, seed=seed)
    assert guard_findings(record, actuator) == ()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "pairs"), [("step", "1"), ("extended", "1"), ("extended", "4")])
def test_the_angle_of_a_pwm_drive_is_found_where_it_is_not_recorded(pairs, name):
    """The back-EMF drives a current across the torque axis: it was up to 73 degrees off."""
    actuator = describe(read_sheet({
        "resistance": "0.6ohm", "inductance": "0.35mH", "inertia": "1.2e-5kgm2", "gear": "200",
        "end-stop": "40deg", "bus": "48V", "current-limit": "15A", "torque-constant": "60mNm/A",
        "stiffness": "10Nm/arcmin", "pole-pairs": pairs},
        {"drive": "pwm", "shape": "trapezoid"})).actuator
    record = simulate(default_profiles(actuator)[name], actuator=actuator, seed=1)
    samples = record.samples.copy()
    samples[:, ROTOR_ANGLE] = np.nan
    off = completed(replace(record, samples=samples), actuator)[:, ROTOR_ANGLE] - record.channel(
        "rotor_angle")
    assert abs(np.median(np.degrees(np.angle(np.exp(1j * off))))) < 7.0
