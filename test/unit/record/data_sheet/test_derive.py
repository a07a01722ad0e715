"""From a data sheet to an actuator: conversions by closed forms, stated rules, what is refused."""

import math

import pytest
import yaml

from ema_record.actuator import load_actuator
from ema_record.data_sheet.constants import phase_constant, shape_constants
from ema_record.data_sheet.derive import describe
from ema_record.data_sheet.new_kit import new_kit, with_values
from ema_record.data_sheet.quantities import QUANTITIES, Given, read_quantity
from ema_record.data_sheet.sheet import read_sheet
from ema_record.errors import OutputError, UsageError
from ema_record.kit import using_kit
from ema_record.profile import load_profile, profile_names
from ema_record.profiles.design import default_profiles
from ema_record.profiles.motion import motion, torque_constant
from ema_record.spread import load_spread

RPM = 2.0 * math.pi / 60.0
SMALL = {
    "resistance": "1.2ohm", "inductance": "194uH", "kv": "475rpm/V", "pole-pairs": "1",
    "inertia": "34gcm2", "gear": "100", "end-stop": "40deg", "current-limit": "7.5A",
    "bus": "24V",
}


def sheet(choices=None, without=(), **changes):
    texts = {**SMALL, **{name.replace("_", "-"): text for name, text in changes.items()}}
    return read_sheet({k: v for k, v in texts.items() if v is not None}, choices or {}, without)


def actuator_of(choices=None, **changes):
    return describe(sheet(choices, **changes)).actuator


@pytest.mark.parametrize(("name", "text", "value"), [
    ("inductance", "0.194 mH", 1.94e-4),
    ("inductance", "194µH", 1.94e-4),
    ("inductance", "194 μH", 1.94e-4),
    ("resistance", "1.2 Ω", 1.2),
    ("resistance", "1.2\u2126", 1.2),
    ("inertia", "34 g·cm²", 34e-7),
    ("inertia", "0.6 kgcm2", 6e-5),
    ("kv", "475 rpm/V", 475 * RPM),
    ("back-emf", "2.107mV/rpm", 2.107e-3 / RPM),
    ("back-emf", "51V/krpm", 0.051 / RPM),
    ("viscous-friction", "2.4e-4 mNm/rpm", 2.4e-7 / RPM),
    ("speed", "6000RPM", 6000 * RPM),
    ("end-stop", "40°", math.radians(40)),
    ("stiffness", "1.5Nm/arcmin", 1.5 * 60 * 180 / math.pi),
    ("gear", "99.5", 99.5),
])
def test_units(name, text, value):
    assert read_quantity(name, text).value == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(("name", "kind"), QUANTITIES.items())
def test_every_example_can_be_read(name, kind):
    assert kind.least <= read_quantity(name, kind.example).value <= kind.most


@pytest.mark.parametrize(("name", "text", "message"), [
    ("inductance", "-0.2mH", "not possible: between two terminals: 0.04 to 200 mH"),
    ("inductance", "0.2", "the unit is missing: give H, mH, uH, for example 0.194mH"),
    ("inductance", "0.2ohm", "no unit 'ohm' here"),
    ("gear", "0.5", "not possible: turns of the motor a turn of the surface: 1 to"),
    ("gear", "100:1", "a pure number"),
    ("pole-pairs", "1.5", "whole"),
    ("pole-pairs", "0", "not possible"),
    ("inertia", "nan", "not a number"),
    ("inertia", "1e999kgm2", "not possible"),
    ("speed", "", "not a number: give for example 6000rpm"),
])
def test_what_is_not_possible_is_refused(name, text, message):
    with pytest.raises(UsageError, match="--" + name) as caught:
        read_quantity(name, text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_shape_constants_closed_forms():
    sine, trapezoid = shape_constants("sine"), shape_constants("trapezoid")
    assert sine.peak == pytest.approx(math.sqrt(3.0), rel=1e-6)
    assert sine.mean == pytest.approx(3.0 * math.sqrt(3.0) / math.pi, rel=1e-6)
    assert sine.rms == pytest.approx(math.sqrt(1.5), rel=1e-6)
    assert trapezoid.peak == trapezoid.mean == pytest.approx(2.0, rel=1e-9)
    # The line voltage is 2 over 60 degrees and falls from 1 to -1 or from 2 to 1 over 60.
    assert trapezoid.rms == pytest.approx(math.sqrt(20.0) / 3.0, rel=1e-6)
    half = math.pi / 6.0
    assert trapezoid.fundamental == pytest.approx(
        4.0 * math.sin(half) / (math.pi * half), rel=1e-6)


@pytest.mark.parametrize("shape", ["sine", "trapezoid"])
def test_the_same_motor_stated_in_every_way_is_the_same_motor(shape):
    k, of = 0.0123, shape_constants(shape)
    amplitude = 1.5 * of.fundamental * k
    for name, value, voltage, current in (
        ("kv", 1.0 / (of.mean * k), "mean", "block"), ("kv", 1.0 / (of.peak * k), "peak", "block"),
        ("kv", 1.0 / (of.rms * k), "rms", "block"), ("back-emf", of.peak * k, "peak", "block"),
        ("back-emf", of.rms * k, "rms", "block"),
        ("torque-constant", of.mean * k, "mean", "block"),
        ("torque-constant", amplitude, "mean", "peak"),
        ("torque-constant", amplitude * math.sqrt(2.0), "mean", "rms"),
    ):
        found, _ = phase_constant({name: Given(value, "")}, shape, voltage, current, 24.0)
        assert found == pytest.approx(k, rel=1e-9), (name, voltage, current)


def test_no_load_speed_as_the_constant():
    # 24 V less the drop of 0.189 A over 1.2 ohm drive 11300 rpm against k of block commutation.
    stated = actuator_of(kv=None, no_load_speed="11300rpm", no_load_current="0.189A")
    assert torque_constant(stated) == pytest.approx(
        1.5 * (24.0 - 0.189 * 1.2) / (11300 * RPM) / (3.0 * math.sqrt(3.0) / math.pi), rel=1e-6)


def test_a_star_is_halved_and_a_leg_has_half_the_bus():
    found = actuator_of()
    assert found.motor.phase_resistance == pytest.approx(0.6)
    assert found.motor.phase_inductance == pytest.approx(97e-6)
    assert found.inverter.bus_voltage == pytest.approx(12.0)
    assert found.motor.back_emf_constant == pytest.approx(
        1.0 / (475 * RPM) * math.pi / (3.0 * math.sqrt(3.0)), rel=1e-6)


def test_torque_of_six_step_and_of_sinusoidal_currents():
    six_step = actuator_of({"drive": "pwm", "shape": "trapezoid"},
                           kv=None, torque_constant="20mNm/A")
    foc = actuator_of({"drive": "foc", "shape": "sine", "current-is": "peak"},
                      kv=None, torque_constant="20mNm/A")
    for found, k in ((six_step, 0.01), (foc, 0.02 / 1.5)):
        assert found.motor.back_emf_constant == pytest.approx(k, rel=1e-6)
        assert torque_constant(found) == pytest.approx(0.02, rel=1e-6)
        assert found.motor.torque_limit == pytest.approx(0.02 * 7.5, rel=1e-5)


def test_gains_follow_the_stated_rules():
    found = actuator_of({"drive": "foc"})
    bandwidth = 2.0 * math.pi * found.drive.pwm_frequency / 15.0
    assert found.drive.proportional_gain == pytest.approx(bandwidth * 97e-6, rel=1e-3)
    assert found.drive.integral_gain == pytest.approx(bandwidth * 0.6, rel=1e-3)
    at, k_t, control = motion(found), torque_constant(found), found.control
    speed = control.proportional_gain * k_t / at.inertia
    most = 20.0 * k_t * 7.5 / (at.inertia * control.speed_limit)
    assert speed == pytest.approx(
        min(1.0 / (14.0 * control.period), bandwidth / 4.0, most), rel=1e-3)
    assert control.integral_gain == pytest.approx(
        control.proportional_gain * speed / 7.0, rel=2e-3)
    outer = control.position_gain / found.gear.ratio
    assert outer <= min(speed / 20.0, 0.5 / at.acceleration) * 1.001
    damped = (control.proportional_gain * k_t) ** 2 / (
        4.0 * at.inertia * control.integral_gain * k_t)
    assert damped > 1.0  # two real poles


def test_no_load_current_is_friction():
    found = actuator_of(no_load_current="0.2A", no_load_speed="11000rpm")
    k_t = torque_constant(found)
    assert found.motor.dynamic_friction == pytest.approx(0.1 * k_t, rel=2e-3)
    total = found.motor.dynamic_friction + found.motor.viscous_friction * 11000 * RPM
    assert total == pytest.approx(0.2 * k_t, rel=5e-3)


def test_origins_are_told():
    found = describe(sheet({"drive": "relay"}, ("rotor_angle",), friction="1.1mNm"))
    entries = found.entries
    assert entries["motor"]["dynamic_friction"][1:] == ("given", "--friction 1.1mNm")
    assert entries["motor"]["static_friction"].origin == "assumed"
    assert entries["control"]["position_gain"].origin == "derived"
    assert entries["drive"]["kind"].origin == "given"
    assert found.actuator.acquisition.rotor_angle == 0
    assert found.actuator.acquisition.surface_position == 1
    for section, part in entries.items():
        assert set(part) == set(getattr(found.actuator, section)._fields)


@pytest.mark.parametrize(("choices", "changes", "message"), [
    ({}, {"speed": "14000rpm"}, "back-EMF at this speed exceeds the bus of 24V: below 1088"),
    ({}, {"speed": "10500rpm"}, r"bus of \+-12 V .* carry the motor to --speed .* at most"),
    ({}, {"friction": "0.5Nm"}, "does not exceed static friction"),
    ({}, {"no_load_speed": "5000rpm"}, "contradict each other: k of a phase would be"),
    ({}, {"torque_constant": "30mNm/A"}, "--torque-constant 30mNm/A and --kv 475rpm/V contra"),
    ({}, {"end_stop": "3deg"}, r"stroke of \+-0.0523599 rad is too short"),
    ({}, {"rate": "1kHz"}, "--rate 1000 samples a second are 9.2 an electrical turn"),
    ({}, {"control_period": "1ms"}, "without --rate, one a control period, 1000 samples"),
    ({"drive": "relay"}, {"inductance": "45uH", "bus": "48V"}, "its band would be"),
    ({"drive": "vector"}, {}, "unknown word of --drive 'vector': one of relay, pwm, foc"),
    ({}, {"kv": None}, r"lacks a constant \(one of --kv"),
    ({}, {"bus": None, "gear": None}, r"lacks --gear \(100\), --bus \(24V\): give them"),
])
def test_impossible_data_are_one_line_and_nothing_is_written(tmp_path, choices, changes, message):
    with pytest.raises(UsageError, match=message) as caught:
        new_kit(sheet(choices, **changes), tmp_path / "kit")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_channel_that_is_always_there_cannot_lack():
    with pytest.raises(UsageError, match="the others are always recorded"):
        sheet(without=("motor_speed",))


def test_a_kit_is_whole_and_reads_back_as_it_was_described(tmp_path):
    described = new_kit(sheet({"drive": "relay"}, friction="1.1mNm", rate="10kHz"),
                        tmp_path / "kit")
    assert [path.name for path in tmp_path.iterdir()] == ["kit"]
    with using_kit(tmp_path / "kit"):
        assert load_actuator() == described.actuator
        assert load_spread().conditions.load == pytest.approx(
            0.3 * described.actuator.surface.dynamic_friction, rel=5e-3)
        assert profile_names() == ["extended", "step"]
        assert {n: load_profile(n) for n in profile_names()} == default_profiles(load_actuator())
    text = (tmp_path / "kit" / "actuator.yaml").read_text(encoding="utf-8")
    parameters = [line for line in text.splitlines() if line.startswith("  ")]
    assert all(" # " in line for line in parameters)
    assert "--resistance 1.2ohm between terminals, halved" in text
    assert isinstance(yaml.safe_load(text)["motor"]["phase_inductance"], float)


def test_what_exists_is_not_touched(tmp_path):
    (tmp_path / "kit").mkdir()
    with pytest.raises(OutputError, match="exists"):
        new_kit(sheet(), tmp_path / "kit")
    assert list((tmp_path / "kit").iterdir()) == []


def test_the_name_of_a_type_stays_a_comment(tmp_path):
    named = sheet()._replace(name="two\nlines: [")
    new_kit(named, tmp_path / "kit")
    with using_kit(tmp_path / "kit"):
        assert load_actuator().gear.ratio == 100.0


@pytest.mark.parametrize("said", [True, False])
def test_a_description_with_other_values_reads_back_as_they_are(tmp_path, said):
    """Also of a parameter that its text left at the default, in a line at the section's end."""
    new_kit(sheet(), tmp_path / "kit")
    file = tmp_path / "kit" / "actuator.yaml"
    lines = file.read_text(encoding="utf-8").splitlines()
    if not said:
        lines = [line for line in lines if "commutation_latency" not in line]
    with using_kit(tmp_path / "kit"):
        old = load_actuator()
    new = old._replace(
        acquisition=old.acquisition._replace(commutation_latency=1.25),
        motor=old.motor._replace(phase_resistance=2.0 * old.motor.phase_resistance))
    text = with_values("\n".join(lines) + "\n", new)
    file.write_text(text, encoding="utf-8")
    with using_kit(tmp_path / "kit"):
        assert load_actuator() == new
    assert text.count("commutation_latency: 1.25") == 1
    assert with_values(text, new) == text
    with pytest.raises(UsageError, match="motor: all on one line"):
        with_values("motor: {inertia: 1e-5}\n", new)
