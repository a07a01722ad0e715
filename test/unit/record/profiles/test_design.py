"""The default tests of any actuator, and the plan of their analysis."""

import math

import numpy as np
import pytest

from ema_record.actuator import FOC, HARMONICS, actuator_from, load_actuator
from ema_record.errors import UsageError
from ema_record.profile import Profile, load_profile, step_profile
from ema_record.profiles.design import default_profiles
from ema_record.profiles.motion import free_speed, friction_at, motion, torque_at, torque_constant
from ema_record.profiles.plan import test_plan as plan_of
from ema_record.profiles.sizes import before, down, round_number, sizes, up

SMALL = {  # 12 V, four pole pairs, gear 30
    "inverter": {"bus_voltage": 6.0, "current_limit": 20.0, "hysteresis": 0.5},
    "motor": {
        "phase_resistance": 0.1, "phase_inductance": 1e-4, "back_emf_constant": 0.008,
        "pole_pairs": 4, "inertia": 2e-6, "torque_limit": 0.3, "dynamic_friction": 0.01,
        "static_friction": 0.015, "viscous_friction": 1e-6},
    "gear": {"ratio": 30.0},
    "surface": {"end_stop": 1.0, "inertia": 1e-3, "viscous_friction": 1e-3,
                "dynamic_friction": 0.1, "static_friction": 0.15},
    "shaft": {"stiffness": 500.0, "damping": 0.1},
    "control": {"speed_limit": 300.0, "position_gain": 2500.0, "proportional_gain": 0.05,
                "integral_gain": 8.0},
    "acquisition": {"rate": 10_000.0},
}
LARGE = {  # 270 V, three pole pairs, gear 1200
    "inverter": {"bus_voltage": 135.0, "current_limit": 20.0},
    "motor": {
        "phase_resistance": 1.0, "phase_inductance": 1e-3, "back_emf_constant": 0.12,
        "pole_pairs": 3, "inertia": 1e-4, "torque_limit": 4.0, "dynamic_friction": 0.3,
        "static_friction": 0.4},
    "gear": {"ratio": 1200.0},
    "surface": {"end_stop": 0.5, "inertia": 5.0, "viscous_friction": 20.0,
                "dynamic_friction": 300.0, "static_friction": 400.0},
    "shaft": {"stiffness": 1e6, "damping": 300.0},
    "control": {"speed_limit": 800.0, "position_gain": 4e4},
}


def machine(data, **changes):
    """Return an actuator of these sections; changes are named section__parameter."""
    merged = {section: dict(values) for section, values in data.items()}
    for name, value in changes.items():
        section, _, parameter = name.partition("__")
        merged.setdefault(section, {})[parameter] = value
    return actuator_from(merged, "machine")


def test_a_test_that_would_take_too_long_is_refused_before_it_is_made():
    with pytest.raises(UsageError, match=r"would take .* at most 60: .* raise control"):
        default_profiles(machine(SMALL, control__speed_limit=1.0))


@pytest.mark.parametrize("name", ["step", "extended"])
def test_the_default_actuator_gets_the_shipped_tests(name):
    assert default_profiles(load_actuator())[name] == load_profile(name)


def test_the_plan_of_the_shipped_extended_test():
    plan = plan_of(load_profile("extended"), load_actuator())
    assert plan.segments == {
        "full": (0.10, 0.36, 20), "full_back": (0.66, 0.878, 16),
        "quarter": (1.09, 1.458, 8), "quarter_back": (1.61, 1.978, 8),
    }
    assert (plan.ramp, plan.ramp_back) == ((2.12, 2.498), (2.66, 2.998))
    assert plan.reversals == ((2.508, -1), (3.008, 1))
    assert plan.reversal_length == 0.1
    assert plan.full_speed == (0.06, 0.36)
    assert plan.starts == ((0.0, 0.06), (0.47, 0.64), (0.86, 1.0), (1.44, 1.54))
    assert plan.slow_from == 2.008
    assert plan.last_time == 3.083
    assert plan.is_extended


@pytest.mark.parametrize("profile", [
    load_profile("step"), step_profile(0.8), step_profile(0.95),
    Profile(name="read", points=((0.0, 0.3), (0.1, 0.3), (0.1, -0.5), (0.6, -0.5))),
])
def test_every_long_step_has_the_same_plan(profile):
    plan = plan_of(profile, load_actuator())
    assert plan.segments == {"full": (0.10, 0.36, 20)}
    assert plan.full_speed == (0.06, 0.36)
    assert plan.starts == ((0.0, 0.06),)
    assert plan.last_time == 0.36
    assert plan.slow_from == math.inf
    assert plan.reversals == ()
    assert not plan.is_extended


def test_a_shorter_step_ends_before_it_brakes():
    actuator = load_actuator()
    plan = plan_of(step_profile(0.5), actuator)
    lag = actuator.gear.ratio / actuator.control.position_gain
    assert plan.full.end < 0.5 / actuator.slew_speed - lag + plan.acceleration
    assert plan.last_time == plan.full.end


@pytest.mark.parametrize("profile", [step_profile(0.05), load_profile("ramps")])
def test_without_a_full_slew_there_is_no_plan(profile):
    with pytest.raises(UsageError, match=r"no slew long enough .* 0\.8 rad at once are right"):
        plan_of(profile, load_actuator())


def settled_turns(segment, share, actuator):
    speed = share * actuator.control.speed_limit / (2.0 * math.pi)
    return (segment.end - segment.begin) * speed


@pytest.mark.parametrize("data", [SMALL, LARGE], ids=["small", "large"])
@pytest.mark.parametrize("stop", [0.5, 1.0, 2.0])
def test_other_machines_get_complete_tests_within_their_stroke(data, stop):
    actuator = machine(data, surface__end_stop=stop)
    made = default_profiles(actuator)
    plan = plan_of(made["extended"], actuator)
    assert plan.is_extended
    assert plan_of(made["step"], actuator).full == plan.full
    assert made["step"].duration < made["extended"].duration <= 60.0
    assert made["step"].duration - made["step"].command_time > plan.full.end
    for profile in made.values():
        assert max(abs(x) for _, x in profile.points) <= 0.9 * stop
    pairs = actuator.motor.pole_pairs
    quarter = size_of(actuator).quarter_speed / actuator.slew_speed
    long = stop >= 1.0
    assert settled_turns(plan.full, pairs, actuator) >= (20.0 if long else 6.0)
    assert settled_turns(plan.quarter, quarter * pairs, actuator) >= (10.0 if long else 6.0)
    assert plan.ramp[1] - plan.ramp[0] > 0.2
    ends = [plan.full.end, plan.full_back.end, plan.quarter.end, plan.quarter_back.end,
            *(t for t, _ in plan.reversals)]
    begins = [plan.full.begin, plan.full_back.begin, plan.quarter.begin, plan.quarter_back.begin,
              plan.ramp[0], plan.ramp_back[0]]
    assert all(b < e for b, e in zip(begins, ends))
    assert all(e < b for e, b in zip(ends, begins[1:]))


def size_of(actuator):
    return sizes(actuator)


def test_quarter_slews_hold_eight_turns_of_the_rotor_where_the_stroke_does():
    actuator = machine(SMALL, surface__end_stop=2.0)
    plan = plan_of(default_profiles(actuator)["extended"], actuator)
    share = size_of(actuator).quarter_speed / actuator.slew_speed
    assert settled_turns(plan.quarter, share, actuator) >= 8.0
    short = machine(SMALL, surface__end_stop=0.5)
    size = size_of(short)
    assert size.quarter_travel == pytest.approx(size.travel, rel=0.02)  # all that there is


@pytest.mark.parametrize(("changes", "message"), [
    ({"surface__end_stop": 0.05}, r"stroke of \+-0\.05 rad leaves 0\.09 rad"),
    ({"surface__end_stop": 0.1}, r"stroke of \+-0\.1 rad is too short: 0\.18 rad are 0\.859 "),
    ({"inverter__bus_voltage": 2.0}, r"bus of \+-2 V .*_limit 300 rad/s: \d+ rad/s"),
    ({"motor__static_friction": 1.0}, r"does not exceed static friction, 1 N m"),
    ({"motor__dynamic_friction": 0.29}, r"do not carry the motor"),
    ({"acquisition__rate": 2000.0}, r"10\.5 an electrical turn .* record at 4584 or more"),
    ({"control__position_gain": 0.0}, r"position_gain"),
    ({"shaft__stiffness": 100.0, "surface__static_friction": 8.0, "surface__end_stop": 0.5},
     r"wind-up of the shaft, which needs 1: a longer stroke"),
])
def test_what_cannot_be_done_is_said_in_one_line(changes, message):
    with pytest.raises(UsageError, match=message) as caught:
        default_profiles(machine(SMALL, **changes))
    assert "\n" not in str(caught.value)


def test_torque_constant_closed_forms():
    default = load_actuator()
    k = default.motor.back_emf_constant
    sine = default._replace(motor=default.motor._replace(back_emf=HARMONICS))
    foc = default.drive._replace(kind=FOC)
    half = 0.5 * (math.pi - default.motor.flat_top)
    fundamental = 4.0 * k * math.sin(half) / (math.pi * half)
    assert torque_constant(default) == pytest.approx(2.0 * k, rel=1e-9)
    assert torque_constant(sine) == pytest.approx(3.0 * math.sqrt(3.0) / math.pi * k, rel=1e-6)
    assert torque_constant(sine._replace(drive=foc)) == pytest.approx(1.5 * k, rel=1e-9)
    assert torque_constant(default._replace(drive=foc)) == pytest.approx(
        1.5 * fundamental, rel=1e-6)


def test_time_to_accelerate_closed_form():
    # Constant torque and friction: t = J ω / (T − F).
    actuator = machine(SMALL, motor__viscous_friction=0.0, surface__viscous_friction=0.0,
                       inverter__bus_voltage=60.0)
    motor, gear = actuator.motor, actuator.gear
    inertia = motor.inertia + actuator.surface.inertia / gear.ratio**2
    friction = motor.dynamic_friction + actuator.surface.dynamic_friction / gear.ratio
    torque = min(motor.torque_limit, 2.0 * motor.back_emf_constant
                 * actuator.inverter.current_limit)
    assert motion(actuator).acceleration == pytest.approx(
        inertia * actuator.control.speed_limit / (torque - friction), rel=1e-9)


def test_no_torque_is_left_at_the_speed_of_the_bus():
    for kind in (0, FOC):
        actuator = machine(SMALL, drive__kind=kind)
        free = free_speed(actuator)
        line = math.sqrt(3.0) * actuator.motor.back_emf_constant * (
            1.2158541651 if kind == FOC else 2.0 / math.sqrt(3.0))
        assert free == pytest.approx(2.0 * actuator.inverter.bus_voltage / line, rel=1e-6)
        found = torque_at(actuator, np.array([0.0, 0.99 * free, 1.01 * free]))
        assert found[0] > found[1] > found[2] == 0.0


def test_friction_of_the_surface_is_reflected_by_the_gear():
    actuator = load_actuator()
    moved = actuator._replace(gear=actuator.gear._replace(efficiency=0.5))
    gear, dry = actuator.gear.ratio, actuator.surface.dynamic_friction
    at_rest = np.zeros(1)
    assert (friction_at(moved, at_rest) - friction_at(actuator, at_rest))[0] == pytest.approx(
        dry / gear)


def test_round_numbers():
    assert round_number(0.0113, (1.0, 2.0, 5.0)) == 0.01
    assert round_number(0.005, (1.0, 2.0, 5.0)) == 0.005
    assert round_number(99.9, (1.0, 2.0, 5.0)) == 50.0
    assert (up(0.0531, 0.01), down(0.0531, 0.01), before(0.05, 0.01)) == (0.06, 0.05, 0.04)
    assert up(0.03 + 1e-12, 0.01) == 0.03


def test_a_test_holds_what_a_corrected_actuator_needs_of_it() -> None:
    """More lost motion and friction, less stiffness: windows end with the test, not after it."""
    a = load_actuator()
    worn = a._replace(
        shaft=a.shaft._replace(backlash=2.0 * a.shaft.backlash, stiffness=0.5 * a.shaft.stiffness),
        surface=a.surface._replace(dynamic_friction=1.5 * a.surface.dynamic_friction))
    profile = default_profiles(a)["extended"]
    own, other = plan_of(profile, a), plan_of(profile, worn)
    assert other.last_time > own.last_time
    assert other.last_time + profile.command_time <= profile.duration
