"""Parts of the workflow that need no library: tolerances, cache, model file, least squares."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ema_identification.actuator.measure.tolerances import (
    N_TOLERANCES,
    TOLERANCES,
    RecordConditions,
    Tolerances,
    draw_tolerances,
    realise,
)
from ema_identification.actuator.naming.answer import order_of, stages_of
from ema_identification.actuator.naming.criteria import Case, one_effect
from ema_identification.actuator.naming.decision import agrees, two_effects
from ema_identification.actuator.naming.estimates import choices_of, model_text
from ema_identification.actuator.naming.gap import LEVEL, ModelGap, worst
from ema_identification.actuator.surrogate import calibration
from ema_identification.actuator.surrogate.calibration import scale_of
from ema_identification.actuator.surrogate.catalogue import ALIASES, variants
from ema_identification.actuator.surrogate.evidence import Whitening, solve
from ema_identification.actuator.surrogate.fit import EffectTerm, Fit
from ema_identification.actuator.surrogate.library import Scale
from ema_identification.actuator.surrogate.library_runs import unpack
from ema_identification.actuator.surrogate.likelihood import bounded_least_squares
from ema_identification.actuator.surrogate.screening import grid
from ema_record import array_cache as cache
from ema_record.kit import LIBRARY, using_kit
from ema_record.profile import load_profile
from ema_record.sources import sources_of
from ema_sim.effects import EFFECTS, Effects, parse_effects
from ema_sim.model_file import load_model_file
from support.simulations import make_kit

NOTHING = np.zeros(1)


def fit_of(name, cost):
    variant = next(v for v in variants() if v.effect == name)
    return Fit(terms=(EffectTerm(variant=variant, signature=None, u=NOTHING),), z=NOTHING,
               cost=cost, covariance=NOTHING, mean=(NOTHING,), runs=10, slopes=NOTHING)


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
    actuator, effects = realise(model, z, RecordConditions(temperature=60.0, bus=0.05))
    assert actuator.motor.dynamic_friction == pytest.approx(0.33)
    assert actuator.motor.static_friction == pytest.approx(0.44)
    assert effects.current_sensor_offset.phase_c == pytest.approx(-0.05)
    assert effects.winding_temperature.temperature == 60.0
    assert effects.bus_voltage_change.change == 0.05


def test_draws_stay_within_the_tolerances():
    z = np.array([draw_tolerances(np.random.default_rng(k)) for k in range(50)])
    assert np.abs(z).max() <= 1.0


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


def test_the_load_and_the_errors_of_sensors_are_those_of_the_kit(tmp_path):
    kit = make_kit(tmp_path / "kit", {"conditions": {"load": 3.0, "current_offset": 0.2}},
                   cascade=False)
    load, offset = (next(t for t in TOLERANCES if t.name == name)
                    for name in ("surface_load.constant", "current_sensor_offset.phase_a"))
    before = load.half_width, offset.half_width
    with using_kit(kit):
        assert (load.half_width, offset.half_width) == (3.0, 0.2)
    assert (load.half_width, offset.half_width) == before != (3.0, 0.2)


def test_aliases_name_variants_and_tolerances():
    names = {v.name: v for v in variants()}
    for (variant, coordinate), (tolerance, _) in ALIASES.items():
        assert coordinate < names[variant].size
        assert tolerance in {t.name for t in TOLERANCES}


def test_shared_tolerances_stand_once():
    t = Tolerances(2)
    own = sum(not x.shared for x in TOLERANCES)
    assert t.size == N_TOLERANCES + own
    z = np.arange(t.size, dtype=float)
    first, second = t.of(0, z), t.of(1, z)
    differ = [TOLERANCES[k].shared for k in np.flatnonzero(first != second)]
    assert differ == [False] * own


def test_least_squares_finds_a_coordinate_next_to_a_tolerance():
    rng = np.random.default_rng(1)
    columns = rng.normal(size=(300, 4)) * 20.0
    truth = np.array([3.0, 0.4, -0.7, 0.1])
    step, covariance = solve(columns, columns @ truth, np.zeros(3), 1, 0.0)
    assert step == pytest.approx(truth, abs=1e-3)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(1.0 / (20.0 * np.sqrt(300)), rel=0.2)


def test_a_coordinate_that_is_a_tolerance_is_as_uncertain_as_that():
    column = np.random.default_rng(2).normal(size=(300, 1)) * 50.0
    _, covariance = solve(np.hstack([column, column]), column[:, 0], np.zeros(1), 1, 0.0)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(1.0 / np.sqrt(3.0), rel=0.01)


def test_whitening_gives_unit_covariance():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(5, 5))
    covariance = root @ root.T + np.eye(5)
    white = Whitening(covariance)
    assert white(np.linalg.cholesky(covariance)) == pytest.approx(np.eye(5), abs=1e-12)


def test_a_larger_gain_is_rarer():
    scale = Scale(factor=np.ones(3), gain=(10.0, 5.0))
    assert scale.p_gain(10.0) == pytest.approx(0.5)
    assert scale.p_gain(10.0 + 5.0 * np.log(50.0)) == pytest.approx(0.01)
    assert scale.p_gain(-1e9) == 1.0
    assert scale.p_fit(np.exp(scale.fit[0])) == pytest.approx(0.5)


def test_the_model_file_can_be_read_back(tmp_path):
    model = load_model_file()
    z = np.zeros(N_TOLERANCES)
    z[index_of("motor.phase_resistance")] = 0.5
    effects = parse_effects(["cogging_torque.amplitude=0.01", "turn_short.fraction=0.05",
                             "turn_short.phase=c"])
    path = tmp_path / "model.yaml"
    path.write_text(model_text(model, z, effects), encoding="utf-8")
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


def test_the_key_follows_the_model_and_the_numerical_packages(monkeypatch):
    module = "ema_identification.actuator.surrogate.calibration"
    first = cache.key_of("model", module=module)
    assert first == cache.key_of("model", module=module)
    assert first != cache.key_of("other", module=module)
    monkeypatch.setattr(cache.metadata, "version", lambda _name: "0.0")
    assert cache.key_of("model", module=module) != first


def test_a_library_is_that_of_the_kit(tmp_path, monkeypatch):
    """Its key follows the spread of the kit; the kit's own folder is looked into first."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    kit = make_kit(tmp_path / "kit", {"tolerances": {"inertia": 0.2}})
    made = {name: np.array([k]) for k, name in enumerate(("cache", "kit"))}
    cache.save("null", {"x": made["cache"]})
    cache.save("null", {"x": made["kit"]}, kit / LIBRARY)
    profile, model = load_profile("step"), load_model_file()
    key = calibration._key(model, profile, 1e4, scale_of, 0)
    assert calibration._kept("null")["x"] == made["cache"]
    with using_kit(kit):
        assert calibration._kept("null")["x"] == made["kit"]
        assert calibration._key(model, profile, 1e4, scale_of, 0) != key
        assert calibration._kept("none") is None


def test_the_null_of_the_gain_depends_on_the_catalogue_that_it_was_measured_with():
    found = sources_of("ema_identification.actuator.surrogate.calibration")
    assert {f"ema_identification.actuator.surrogate.{name}" for name in (
        "catalogue", "library_runs", "screening")} <= set(found)
    assert "ema_sim.effects.turn_short" in found
    assert not any(name.startswith("ema_identification.report") for name in found)


def test_bounded_least_squares_stays_within_its_bounds():
    columns = np.diag([2.0, 1.0])
    free = bounded_least_squares(columns, np.array([2.0, 3.0]), np.full(2, -9.0), np.full(2, 9.0),
                                 np.zeros(2), np.zeros(2))
    assert free == pytest.approx([1.0, 3.0], abs=1e-6)
    held = bounded_least_squares(columns, np.array([2.0, 3.0]), np.full(2, -9.0),
                                 np.array([9.0, 1.0]), np.zeros(2), np.zeros(2))
    assert held == pytest.approx([1.0, 1.0], abs=1e-6)


def test_bounded_least_squares_weighs_where_it_ends_and_not_its_step():
    step = bounded_least_squares(np.eye(1), np.array([0.0]), np.array([-9.0]), np.array([9.0]),
                                 np.array([1.0]), np.array([2.0]))
    assert step == pytest.approx([-1.0], abs=1e-6)


def test_an_effect_is_compared_at_all_its_sizes_and_never_at_none():
    by_name = {v.name: v for v in variants()}
    for name in ("surface_friction", "cogging_torque 12 a turn", "surface_load"):
        variant = by_name[name]
        signature = unpack((variant,), np.ones((sum(map(len, variant.levels)), 3)))[0]
        points = grid(signature)
        assert all(np.any(u != 0.0) for u in points)
        for k, levels in enumerate(variant.levels):
            assert max(u[k] for u in points) >= max(levels)
            assert min(u[k] for u in points) <= min(levels)


def arena_of(null_cost):
    library = SimpleNamespace(scale=Scale(factor=np.ones(100)))
    return SimpleNamespace(null_cost=null_cost, evidence=SimpleNamespace(
        size=100, blocks=[SimpleNamespace(library=library)]))


def test_each_effect_of_a_pair_has_the_p_value_of_adding_nothing_to_the_other():
    first, second = fit_of("backlash", 400.0), fit_of("viscous_friction", 115.0)
    pair = replace(first, terms=(*first.terms, *second.terms), cost=100.0)
    case = Case(arena_of(900.0), None, 800.0, 0.0, ())
    found = two_effects(case, [pair], [second, first])
    assert found.alone == (first, second)
    assert found.p_value == (case.p_of(115.0, pair), case.p_of(400.0, pair))
    assert found.p_value[0] > 0.1 > 1e-9 > found.p_value[1]
    assert order_of(found) == [1, 0]  # what explains more alone was found first
    assert stages_of(found) == [second, pair]


def test_the_gaps_of_all_models_are_of_the_same_features():
    before, after = np.zeros(20), np.zeros(20)
    before[3], before[7], after[7], after[11] = 6.0, 2.0, 3.0, 4.0
    assert worst([[before[:9], before[9:]], [after[:9], after[9:]]]) == pytest.approx(
        [6.0 / 2**0.5, 4.0 / 2**0.5])
    assert worst([[before]]) == pytest.approx([20.0**0.5])


def test_the_bound_of_the_noise_is_the_rank_of_a_run():
    draws = np.column_stack([np.zeros(39), np.arange(39.0)])
    found = ModelGap(values=(5.0, 36.5), draws=draws, residual=(), held=True)
    assert (found.floor, found.bound) == (19.0, 37.0)
    assert found.p_value == pytest.approx(3.0 / 40.0)  # two runs and itself
    beyond = replace(found, values=(5.0, found.bound + 0.1))
    assert beyond.p_value == pytest.approx(LEVEL)
    none = replace(found, draws=np.zeros((0, 2)))
    assert np.isnan(none.bound)


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


ALIKE = ("motor_friction", "viscous_friction", "backlash", "surface_load")


@pytest.mark.parametrize("names", [1, 2, 3, 4])
def test_up_to_three_names_are_a_set_and_more_are_no_answer(names):
    arena = arena_of(300.0)
    fits = [fit_of(name, 100.0 + 40.0 * (k >= names)) for k, name in enumerate(ALIKE)]
    found = one_effect(Case(arena, None, 60.0, 1e-4, ()), "explained", fits)
    alike = [f.terms[0].variant.effect for f in found.equivalent[0]]
    if names <= 3:
        assert found.verdict == "explained"
        assert found.fit is fits[0]
        assert alike == list(ALIKE[1:names])
    else:
        assert found.verdict == "unknown effect"
        assert found.fit is None
        assert alike == list(ALIKE)


@pytest.mark.parametrize(("p_gain", "p_null", "expected"), [
    (0.5, 0.5, True), (0.16, 2e-4, True),
    (0.001, 0.5, False), (1.0, 1e-8, False),  # either alone
    (0.05, 1e-5, False), (0.004, 4e-4, False),  # both together
    (0.0, 0.0, False),
])
def test_a_gain_and_a_cost_that_are_improbable_together_are_a_disagreement(
        p_gain, p_null, expected):
    assert agrees(p_gain, p_null) is expected
