"""Parts of the workflow that need no library: tolerances, cache, model file, least squares."""

import os
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from ema_identification.actuator.decision.slopes import bounded_least_squares
from ema_identification.actuator.fleet.units import (
    deviations,
    fleet_unit,
    half_widths,
    unit_numbers,
)
from ema_identification.actuator.gap import worst
from ema_identification.actuator.laws.catalogue import OF_THE_ROTOR, Signature, variants
from ema_identification.actuator.laws.signatures import stacked
from ema_identification.actuator.laws.terms import EffectTerm, choices_of
from ema_identification.actuator.measure.tolerances import (
    N_TOLERANCES,
    TOLERANCES,
    RecordConditions,
    align,
    realise,
)
from ema_identification.actuator.words import _shared_with_the_day
from ema_identification.actuator.workflow import model_file_text
from ema_record import array_cache as cache
from ema_record.kit import using_kit
from ema_record.profile import load_profile
from ema_record.sources import sources_of
from ema_record.spread import load_spread
from ema_sim.effects import EFFECTS, Effects, parse_effects
from ema_sim.machine import TURN
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate
from support.simulations import make_kit


def index_of(name):
    return [t.name for t in TOLERANCES].index(name)


def test_no_tolerance_at_the_reference_is_the_model_itself():
    model = load_model_file()
    nominal = realise(model, np.zeros(N_TOLERANCES), RecordConditions())
    assert nominal == (model.actuator, model.effects)


def test_a_tolerance_moves_its_parameter_by_its_width():
    model, z = load_model_file(), np.zeros(N_TOLERANCES)
    z[index_of("motor.dry_friction")] = 1.0
    z[index_of("current_sensor_offset.phase_c")] = -1.0
    actuator, effects = realise(model, z * half_widths(load_spread()), RecordConditions(
        temperature=60.0, bus=0.05))
    assert actuator.motor.dynamic_friction == pytest.approx(0.33)
    assert actuator.motor.static_friction == pytest.approx(0.44)
    assert effects.current_sensor_offset.phase_c == pytest.approx(-0.05)
    assert effects.winding_temperature.temperature == 60.0
    assert effects.bus_voltage_change.change == 0.05


@pytest.mark.parametrize("variant", variants(), ids=lambda v: v.name)
def test_a_variant_is_absent_at_zero_and_present_at_its_levels(variant):
    known = [k for k, levels in enumerate(variant.levels) if levels]
    base = Effects()
    assert EFFECTS[variant.effect].is_neutral(
        getattr(variant.effects(np.zeros(variant.size), base), variant.effect))
    for k in known:
        for level in variant.levels[k]:
            assert variant.low[k] <= level <= variant.high[k]
            u = np.zeros(variant.size)
            u[k] = level
            found = variant.effects(u, base)
            assert not EFFECTS[variant.effect].is_neutral(getattr(found, variant.effect))
            rest = {n for n in EFFECTS if getattr(found, n) != getattr(base, n)}
            assert rest == {variant.effect}


def test_what_knows_the_mechanical_angle_differs_from_turn_to_turn():
    """Five pole pairs: the same electrical angle at the start, in the first turn or the second."""
    model = load_model_file()
    actuator = model.actuator._replace(motor=model.actuator.motor._replace(pole_pairs=5))
    profile, differ = load_profile("step"), set()
    for variant in variants(actuator):
        u = np.zeros(variant.size)
        u[0] = max(variant.levels[0] or variant.high[:1], key=abs)
        first, second = (simulate(profile, actuator=actuator, seed=1, start_angle=1.0 + turn,
                                  effects=variant.effects(u, model.effects)).samples
                         for turn in (0.0, TURN))
        if np.abs(first - second).max() > 1e-6:
            differ.add(variant.effect)
    assert differ == OF_THE_ROTOR


def test_conditions_are_read_beside_a_load_that_turns_the_rotor_before_it_is_driven():
    """The shaft winds up by 200 N m: half a radian, at up to 45 rad/s, in 20 ms."""
    model = load_model_file()
    loaded = parse_effects(["surface_load.constant=-200"], model.effects)
    record = simulate(load_profile("step"), seed=5, start_angle=2.0, effects=loaded)
    turned = np.ptp(np.unwrap(record.channel("rotor_angle")[record.at_rest]))
    found = align(record, model)
    assert turned > 0.3
    assert found.start_angle == pytest.approx(2.0, abs=0.002)
    assert found.noise.speed == pytest.approx(1.0, abs=0.2)
    assert found.noise.current == pytest.approx(1.0, abs=0.2)


def test_every_effect_of_the_catalogue_is_a_candidate():
    assert {v.effect for v in variants()} == set(EFFECTS)


def test_sizes_follow_the_scales_of_the_actuator():
    """An actuator with a third of the friction and ten times the lost motion."""
    a = load_model_file().actuator
    other = a._replace(
        motor=a.motor._replace(dynamic_friction=a.motor.dynamic_friction / 3.0),
        surface=a.surface._replace(dynamic_friction=a.surface.dynamic_friction / 3.0,
                                   static_friction=10.0 * a.surface.static_friction),
        shaft=a.shaft._replace(backlash=10.0 * a.shaft.backlash))
    known = {v.name: v.levels for v in variants(a)}
    for variant in variants(other):
        found, before = np.array(variant.levels[0]), np.array(known[variant.name][0])
        if variant.effect in ("cogging_torque", "surface_load"):
            assert found == pytest.approx(before / 3.0, rel=0.05)
        elif variant.effect in ("backlash", "gear_mesh_ripple"):
            top = EFFECTS[variant.effect].fields[0].kind.upper
            assert np.abs(found[2:]) == pytest.approx(
                np.minimum(np.abs(10.0 * before[2:]), top), rel=0.05)
        elif variant.effect in ("turn_short", "current_sensor_offset", "control_delay"):
            assert variant.levels[0] == known[variant.name][0]


def test_sizes_stay_within_what_an_effect_may_be():
    a = load_model_file().actuator
    large = a._replace(surface=a.surface._replace(dynamic_friction=1e4, static_friction=1e4))
    for variant in variants(large):
        for k, levels in enumerate(variant.levels):
            assert all(variant.low[k] <= x <= variant.high[k] and x != 0.0 for x in levels)
            assert len(set(levels)) == len(levels)


@pytest.mark.parametrize("profile", ["step", "extended"])
def test_the_voltage_without_load_is_found_beside_a_weak_supply(profile):
    """A short test draws nearly the same current all the time: the law says what that costs."""
    model = load_model_file()
    sag = parse_effects(["bus_voltage_sag.resistance=1.15", "bus_voltage_change.change=-0.02"],
                        model.effects)
    record = simulate(load_profile(profile), actuator=model.actuator, effects=sag, seed=2)
    found = align(record, model)
    law = parse_effects(["bus_voltage_sag.resistance=1.15"], model.effects)
    _, there = realise(model, np.zeros(N_TOLERANCES), found, law)
    assert there.bus_voltage_change.change == pytest.approx(-0.02, abs=1e-3)
    assert (found.bus_current > 5.0) == (profile == "step")


def test_the_load_and_the_errors_of_sensors_are_those_of_the_kit(tmp_path):
    kit = make_kit(tmp_path / "kit", {"conditions": {"load": 3.0, "current_offset": 0.2}},
                   cascade=False)
    places = [index_of("surface_load.constant"), index_of("current_sensor_offset.phase_a")]
    assert half_widths(load_spread())[places].tolist() == [19.0, 0.05]
    with using_kit(kit):
        assert half_widths(load_spread())[places].tolist() == [3.0, 0.2]


def test_a_unit_of_a_kit_whose_bands_are_none_is_the_model_itself(tmp_path):
    none = {"load": 0.0, "current_offset": 0.0, "current_gain": 0.0}
    with using_kit(make_kit(tmp_path / "kit", {"conditions": none}, cascade=False)):
        model, spread = load_model_file(), load_spread()
        z = np.zeros(len(unit_numbers(model.actuator)))
        z[[index_of(name) for name in ("surface_load.constant", "current_sensor_offset.phase_a",
                                       "current_sensor_gain.phase_b")]] = 1.0
        z[unit_numbers(model.actuator).index("motor.stribeck_speed")] = -1.0  # at once
        _, effects = fleet_unit(model, spread, z, RecordConditions())
        assert effects == model.effects
        assert deviations(model.actuator, spread, z)["surface_load.constant"] == (0.0, "N m")


def test_the_model_file_can_be_read_back(tmp_path):
    model = load_model_file()
    z = np.zeros(N_TOLERANCES)
    z[index_of("motor.phase_resistance")] = 0.05
    effects = parse_effects(["cogging_torque.amplitude=0.01", "turn_short.fraction=0.05",
                             "turn_short.phase=c"])
    path = tmp_path / "model.yaml"
    actuator, _ = realise(model, z, RecordConditions())
    path.write_text(model_file_text(actuator, effects), encoding="utf-8")
    again = load_model_file(path)
    assert again.effects == effects
    assert again.actuator.motor.phase_resistance == pytest.approx(1.05 * 1.065)
    assert again.actuator.gear == model.actuator.gear


def test_the_cache_keeps_arrays_and_forgets_damage(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.load("a") is None
    cache.save("a", {"x": np.arange(3.0)})
    assert cache.load("a")["x"].tolist() == [0.0, 1.0, 2.0]
    (tmp_path / "ema_phm" / "a.npz").write_bytes(b"PK no archive")
    assert cache.load("a") is None
    assert [p.name for p in (tmp_path / "ema_phm").iterdir()] == ["a.npz"]


def test_what_is_kept_and_damaged_counts_as_absent_wherever_it_is(tmp_path):
    """Every bit of a small file in turn; a file of one array, or of more than may be unpacked."""
    cache.save("a", {"x": np.arange(40.0)}, tmp_path, compressed=True)
    whole = (tmp_path / "a.npz").read_bytes()
    for place in range(len(whole)):
        (tmp_path / "a.npz").write_bytes(
            whole[:place] + bytes([whole[place] ^ 0x40]) + whole[place + 1:])
        found = cache.load("a", tmp_path)
        assert found is None or np.array_equal(found["x"], np.arange(40.0))
    locked = bytearray(whole)
    locked[6] |= 1  # encrypted, says the header of the member and the list at the end
    locked[whole.index(b"PK\x01\x02") + 8] |= 1
    (tmp_path / "a.npz").write_bytes(locked)
    assert cache.load("a", tmp_path) is None
    with (tmp_path / "one.npz").open("wb") as file:
        np.save(file, np.arange(3.0))
    assert cache.load("one", tmp_path) is None


def test_other_arrays_than_were_kept_and_no_file_count_as_absent(tmp_path):
    arrays = {"x": np.arange(6.0).reshape(2, 3), "y": np.array(True), "z": np.empty(0)}
    cache.save("a", arrays, tmp_path)
    assert {k: v.tolist() for k, v in cache.load("a", tmp_path).items()} == {
        k: v.tolist() for k, v in arrays.items()}
    with np.load(tmp_path / "a.npz") as whole:
        kept = dict(whole)
    for other in ({"x": kept["x"][::-1]}, {"x": kept["x"].T}, {"y": np.array(False)},
                  {"z": np.zeros(1)}, {"more": kept["x"]}):
        np.savez(tmp_path / "b.npz", **kept | other)
        assert cache.load("b", tmp_path) is None
    np.savez(tmp_path / "old.npz", **arrays)  # without a hash
    assert cache.load("old", tmp_path) is None
    os.mkfifo(tmp_path / "pipe.npz")
    assert cache.load("pipe", tmp_path) is None


def test_what_unpacks_to_more_than_may_be_read_counts_as_absent(tmp_path, monkeypatch):
    cache.save("zeros", {"x": np.zeros(100_000)}, tmp_path, compressed=True)
    assert len(cache.load("zeros", tmp_path)["x"]) == 100_000
    monkeypatch.setattr(cache, "LARGEST", 400_000)
    assert (tmp_path / "zeros.npz").stat().st_size < cache.LARGEST
    assert cache.load("zeros", tmp_path) is None


def test_the_key_follows_the_model_and_the_numerical_packages(monkeypatch):
    module = "ema_identification.actuator.library.build"
    first = cache.key_of("model", module=module)
    assert first == cache.key_of("model", module=module)
    assert first != cache.key_of("other", module=module)
    monkeypatch.setattr(cache.metadata, "version", lambda _name: "0.0")
    assert cache.key_of("model", module=module) != first


def test_bounded_least_squares_stays_within_its_bounds():
    columns = np.diag([2.0, 1.0])
    free = bounded_least_squares(columns, np.array([2.0, 3.0]), np.full(2, -9.0), np.full(2, 9.0),
                                 np.zeros(2), np.zeros(2))
    assert free == pytest.approx([1.0, 3.0], abs=1e-6)
    held = bounded_least_squares(columns, np.array([2.0, 3.0]), np.full(2, -9.0),
                                 np.array([9.0, 1.0]), np.zeros(2), np.zeros(2))
    assert held == pytest.approx([1.0, 1.0], abs=1e-6)


def test_bounded_least_squares_is_that_of_the_whole_system():
    """The normal equations give what a solver of all rows gives, free and at a bound, damped."""
    rng = np.random.default_rng(0)
    columns, target = rng.normal(size=(200, 6)) * 10.0 ** np.arange(-2, 4), rng.normal(size=200)
    weight, centre, damping = np.array([0.0, 0.0, 3.0, 3.0, 3.0, 3.0]), rng.normal(size=6), 0.3
    power = np.diag(damping * ((columns**2).sum(axis=0) + weight)) ** 0.5
    rows = np.vstack([columns, np.diag(weight**0.5), power])
    rest = np.concatenate([target, -(weight**0.5) * centre, np.zeros(6)])
    for width in (9.0, 1e-3):
        found = bounded_least_squares(columns, target, np.full(6, -width), np.full(6, width),
                                      weight, centre, damping)
        plain = lsq_linear(rows, rest, (-width, width), method="bvls", tol=1e-14).x
        assert found == pytest.approx(plain, rel=1e-9, abs=1e-9)


def test_bounded_least_squares_leaves_alone_what_does_nothing():
    step = bounded_least_squares(np.array([[1.0, 0.0], [1.0, 0.0]]), np.ones(2), np.full(2, -9.0),
                                 np.full(2, 9.0), np.zeros(2), np.zeros(2))
    assert step == pytest.approx([1.0, 0.0])


def test_bounded_least_squares_weighs_where_it_ends_and_not_its_step():
    step = bounded_least_squares(np.eye(1), np.array([0.0]), np.array([-9.0]), np.array([9.0]),
                                 np.array([1.0]), np.array([2.0]))
    assert step == pytest.approx([-1.0], abs=1e-6)


def test_the_gaps_of_all_models_are_of_the_same_features():
    before, after = np.zeros(20), np.zeros(20)
    before[3], before[7], after[7], after[11] = 6.0, 2.0, 3.0, 4.0
    assert worst([before, after]) == pytest.approx([6.0 / 2**0.5, 4.0 / 2**0.5])
    assert worst([before]) == pytest.approx([20.0**0.5])


@pytest.mark.parametrize(("name", "u", "expected"), [
    ("turn_short b physical", [0.05], {"turn_short.phase": "b", "turn_short.mode": "physical"}),
    ("rotor_eccentricity static", [0.03, 0.04], {"rotor_eccentricity.mode": "static"}),
    ("phase_resistance_imbalance c", [0.3], {"phase_resistance_imbalance.phase": "c"}),
    ("backlash", [1e-3], {}),
])
def test_phase_and_mode_of_an_effect_are_told(name, u, expected):
    variant = next(v for v in variants() if v.name == name)
    assert choices_of(EffectTerm(variant=variant, signature=None, u=np.array(u))) == expected


def test_a_measured_temperature_is_used_beside_another_magnet_coefficient():
    model = load_model_file()
    warm = model.effects._replace(winding_temperature=model.effects.winding_temperature._replace(
        magnet_coefficient=-2e-3))
    _, effects = realise(model, np.zeros(N_TOLERANCES), RecordConditions(temperature=60.0), warm)
    assert effects.winding_temperature.temperature == 60.0


def test_a_library_depends_on_the_catalogue_and_not_on_the_report():
    found = sources_of("ema_identification.actuator.library.build")
    assert {f"ema_identification.actuator.{name}" for name in (
        "laws.catalogue", "laws.signatures", "decision.proposals")} <= set(found)
    assert "ema_sim.effects.turn_short" in found
    assert not any(name.startswith("ema_identification.report") for name in found)


def test_signatures_of_two_tests_are_stacked_at_the_levels_that_both_have():
    variant = next(v for v in variants() if v.name == "backlash")
    first = Signature(variant=variant, levels=(np.array([0.0, 1.0, 2.0]),),
                      values=(np.array([[0.0], [1.0], [2.0]]),))
    second = Signature(variant=variant, levels=(np.array([0.0, 2.0]),),
                       values=(np.array([[0.0, 0.0], [3.0, 5.0]]),))
    both = stacked([first, second])
    assert both.at(np.array([2.0])).tolist() == [2.0, 3.0, 5.0]
    assert both.at(np.array([1.0])).tolist() == [1.0, 1.5, 2.5]


@pytest.mark.parametrize(("days", "ends"), [
    ((0.0,), (61.0 - 17.1, 61.0 + 17.1)), ((1.0,), (80.0 - 17.1, 80.0 + 17.1)),
    ((1.0, -0.5), (80.0 - 17.1, 51.5 + 17.1)), ((1.0, -1.0), ())])
def test_a_law_that_adds_to_a_number_of_the_day_is_told_apart_by_days_alone(days, ends):
    """A load of 61 N m beside that of each day, at most 19: their sum is what a test tells."""
    load = index_of("surface_load.constant")
    places = [np.array([k * 40 + n for n in range(40)]) for k in range(len(days))]
    z = np.zeros(40 * len(days))
    for own, day in zip(places, days):
        z[own[load]] = day
    unit = SimpleNamespace(library=SimpleNamespace(spread=load_spread()), places=places)
    fit = SimpleNamespace(z=z)
    assert _shared_with_the_day(unit, fit, "surface_load.constant", 61.0) == pytest.approx(ends)
    assert _shared_with_the_day(unit, fit, "surface_load.slope", 1.0) == ()
