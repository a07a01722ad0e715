"""Parts of the workflow that need no library: tolerances, cache, model file, least squares."""

from types import SimpleNamespace

import numpy as np
import pytest

from ema_identification import cache
from ema_identification.actuator.measure.tolerances import (
    N_TOLERANCES,
    TOLERANCES,
    Conditions,
    Tolerances,
    draw_tolerances,
    realise,
)
from ema_identification.actuator.naming.answer import Answer, Case, one_effect
from ema_identification.actuator.naming.decision import agrees
from ema_identification.actuator.naming.estimates import model_text
from ema_identification.actuator.naming.gap import Gap
from ema_identification.actuator.naming.judged import settled
from ema_identification.actuator.naming.sizes import grid
from ema_identification.actuator.surrogate.catalogue import ALIASES, variants
from ema_identification.actuator.surrogate.evidence import Whitening, solve
from ema_identification.actuator.surrogate.fit import Fit, Term
from ema_identification.actuator.surrogate.likelihood import bounded_least_squares
from ema_identification.actuator.surrogate.signatures import Scale, unpack
from ema_sim.effects import EFFECTS, Effects, parse_effects
from ema_sim.model_file import load_model_file

NOTHING = np.zeros(1)


def gap(value, floor):
    return Gap(value=value, floor=floor, residual=())


def fit_of(name, cost):
    variant = next(v for v in variants() if v.effect == name)
    return Fit(terms=(Term(variant=variant, signature=None, u=NOTHING),), z=NOTHING, cost=cost,
               covariance=NOTHING, mean=(NOTHING,), runs=10, slopes=NOTHING)


def index_of(name):
    return [t.name for t in TOLERANCES].index(name)


def test_no_tolerance_at_the_reference_is_the_model_itself():
    model = load_model_file()
    assert realise(model, np.zeros(N_TOLERANCES), Conditions()) == (model.actuator, model.effects)


def test_a_tolerance_moves_its_parameter_by_its_width():
    model, z = load_model_file(), np.zeros(N_TOLERANCES)
    z[index_of("motor.dry_friction")] = 1.0
    z[index_of("current_sensor_offset.phase_c")] = -1.0
    actuator, effects = realise(model, z, Conditions(temperature=60.0, bus=0.05))
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
    step, covariance, cost = solve(columns, columns @ truth, np.zeros(3), 1, 0.0)
    assert step == pytest.approx(truth, abs=1e-3)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(1.0 / (20.0 * np.sqrt(300)), rel=0.2)
    assert cost < 5.0


def test_a_coordinate_that_is_a_tolerance_is_as_uncertain_as_that():
    column = np.random.default_rng(2).normal(size=(300, 1)) * 50.0
    _, covariance, _ = solve(np.hstack([column, column]), column[:, 0], np.zeros(1), 1, 0.0)
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


def test_the_key_follows_the_sources(tmp_path):
    source = tmp_path / "features.py"
    source.write_text("a", encoding="utf-8")
    first = cache.key_of("model", sources=[source])
    assert first == cache.key_of("model", sources=[source])
    source.write_text("b", encoding="utf-8")
    assert first != cache.key_of("model", sources=[source])
    assert first != cache.key_of("other", sources=[source])


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


@pytest.mark.parametrize(("after", "verdict"), [(3.0, "explained"), (6.0, "partly explained")])
def test_a_held_out_record_without_a_gap_settles_what_the_fit_left_open(after, verdict):
    found = settled(Answer(verdict="partly explained"), gap(20.0, 2.2), gap(after, 2.7))
    assert found.verdict == verdict


def test_a_held_out_record_that_shows_no_gap_settles_nothing():
    found = settled(Answer(verdict="partly explained"), gap(2.5, 2.2), gap(2.3, 2.2))
    assert found.verdict == "partly explained"


def test_an_unknown_effect_stays_unknown():
    assert settled(Answer(verdict="unknown effect"), gap(9.0, 2.0), gap(2.0, 2.0)).verdict == (
        "unknown effect")


ALIKE = ("motor_friction", "viscous_friction", "backlash", "surface_load")


@pytest.mark.parametrize("names", [1, 2, 3, 4])
def test_up_to_three_names_are_a_set_and_more_are_no_answer(names):
    arena = SimpleNamespace(evidence=SimpleNamespace(size=100), null_cost=300.0)
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
