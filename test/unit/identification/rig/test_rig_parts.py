"""The parts of the rig workflow against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ema_identification.rig.fit.balance import Design, rms
from ema_identification.rig.fit.known import known_balance
from ema_identification.rig.fit.model import DEFAULT_MODEL, RigModel, Settings, load_rig_model
from ema_identification.rig.fit.regression import (
    Blocks,
    CoefficientBounds,
    correlation_time,
    covariance,
    fit,
    half_width,
    held_out,
)
from ema_identification.rig.fit.sign_flips import p_of_much, screen_by_sign_flips
from ema_identification.rig.laws import LAWS
from ema_identification.rig.laws.base import Term, unit_of
from ema_identification.rig.laws.dynamics import _since_reversal
from ema_identification.rig.prepare import prepare
from ema_identification.rig.report.words import binned
from ema_identification.rig.signals.clocks import response_band
from ema_identification.rig.signals.trajectory import derivative, low_pass
from ema_record.errors import UsageError
from ema_rig.record import Axis


def even_blocks(rows, count):
    return Blocks(of_row=np.arange(rows) * count // rows, count=count, length=1.0)


def test_derivative_is_of_sixth_order():
    errors = []
    for n in (100, 200):
        t = np.linspace(0, 2 * np.pi, n, endpoint=False)
        found = derivative(np.sin(3 * t), t[1])
        errors.append(np.abs(found - 3 * np.cos(3 * t))[4:-4].max())
    assert errors[0] / errors[1] == pytest.approx(2**6, rel=0.15)


def test_the_filter_has_no_delay_and_unit_gain_in_its_band():
    t = np.arange(4000) / 1000.0
    slow = np.sin(2 * np.pi * 5 * t)
    np.testing.assert_allclose(low_pass(slow, 1000.0, 50.0)[500:-500], slow[500:-500], atol=1e-3)
    fast = np.sin(2 * np.pi * 200 * t)
    assert rms(low_pass(fast, 1000.0, 50.0)[500:-500]) < 1e-3


@pytest.mark.parametrize("edge", [10.0, 40.0, 90.0])
def test_the_band_is_where_the_response_leaves_its_noise(edge):
    rng = np.random.default_rng(3)
    signal = low_pass(rng.standard_normal(40_000), 1000.0, edge)
    found = response_band(signal + 1e-3 * rng.standard_normal(40_000), 1000.0, is_position=False)
    # Five harmonics of the motion, which fills the whole band here, but no more than fs / 5.
    assert found.motion == pytest.approx(edge, rel=0.15)
    assert found.edge == pytest.approx(min(5 * found.motion, 200.0))
    assert found.noise_density == pytest.approx(2 * 1e-6 / 1000.0, rel=0.2)


def test_a_slow_sine_in_noise_keeps_its_harmonics_and_sharp_ones_the_noise_limit():
    t = np.arange(20_000) / 1000.0
    rng = np.random.default_rng(0)
    sine = np.sin(2 * np.pi * 2 * t) + 0.01 * rng.standard_normal(len(t))
    assert response_band(sine, 1000.0, is_position=False).edge == pytest.approx(10.0, rel=0.15)
    sharp = low_pass(np.sign(np.sin(2 * np.pi * 0.7 * t)), 1000.0, 60.0)
    found = response_band(sharp + 1e-4 * rng.standard_normal(len(t)), 1000.0, is_position=False)
    assert 60.0 < found.edge < 200.0


def test_correlation_time_of_first_order_noise():
    rng = np.random.default_rng(1)
    values = np.zeros(60_000)
    pole = np.exp(-1 / 50.0)
    for k, kick in enumerate(rng.standard_normal(len(values) - 1)):
        values[k + 1] = pole * values[k] + kick
    assert correlation_time(values, 100.0) == pytest.approx(0.5, rel=0.25)


def test_held_out_residuals_are_those_of_explicit_refits():
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((120, 3)), rng.standard_normal(120)
    blocks = even_blocks(120, 8)
    found = held_out(x, y, blocks)
    for b in range(8):
        own = blocks.of_row == b
        theta = np.linalg.lstsq(x[~own], y[~own], rcond=None)[0]
        np.testing.assert_allclose(found[own], y[own] - x[own] @ theta, atol=1e-10)


def test_bounds_hold_and_say_where_they_are_active():
    rng = np.random.default_rng(0)
    x = rng.standard_normal((500, 2))
    bounds = CoefficientBounds(low=np.array([0.0, -5.0]), high=np.array([2.0, 5.0]))
    found = fit(x, x @ [3.0, -1.0], bounds)
    assert found.coefficients[0] == pytest.approx(2.0)
    assert found.active.tolist() == [True, False]


def test_intervals_hold_with_coloured_noise():
    """90 % intervals of a mean under first-order noise: 90 % of 300, 3.3 deviations wide."""
    rng = np.random.default_rng(5)
    blocks, hits = even_blocks(1200, 24), 0
    for _ in range(300):
        noise = np.zeros(1200)
        kicks = rng.standard_normal(1200)
        for k in range(1, 1200):
            noise[k] = 0.8 * noise[k - 1] + kicks[k]
        x = np.ones((1200, 1))
        found = fit(x, 2.0 + noise)
        wide = half_width(covariance(x, found.residual, blocks)[0, 0], blocks)
        hits += abs(found.coefficients[0] - 2.0) <= wide
    assert 0.84 <= hits / 300 <= 0.95


def test_sign_flips_reject_by_chance_as_often_as_they_say(monkeypatch):
    """5 % of 400 draws with coloured noise and 30 candidates, a constant among them."""
    monkeypatch.setattr("ema_identification.rig.fit.sign_flips.FLIPS", 199)
    rng = np.random.default_rng(7)
    blocks, small = even_blocks(600, 30), 0
    t = np.arange(600)
    candidates = [np.ones((600, 1))] + [
        np.column_stack([np.cos(0.07 * k * t), np.sin(0.07 * k * t)]) for k in range(1, 30)]
    for _ in range(400):
        noise = np.convolve(rng.standard_normal(604), np.ones(5), mode="valid")
        found = screen_by_sign_flips(candidates, np.empty((600, 0)), noise, blocks)
        small += found.family_p_value.min() <= 0.05
    assert 0.02 <= small / 400 <= 0.09


def test_sign_flips_find_a_constant_which_circular_shifts_cannot():
    rng = np.random.default_rng(2)
    noise = rng.standard_normal(600)
    blocks = even_blocks(600, 30)
    found = screen_by_sign_flips([np.ones((600, 1))], np.empty((600, 0)), noise + 0.5, blocks)
    assert found.family_p_value[0] <= 0.001
    assert found.coefficients[0][0] == pytest.approx(0.5, abs=0.12)


def test_what_takes_nearly_all_in_a_few_blocks_is_not_hidden_by_itself():
    """A bump in three blocks of thirty, ten times the noise; and noise, which stays chance."""
    rng = np.random.default_rng(4)
    blocks, known = even_blocks(600, 30), np.empty((600, 0))
    noise = rng.standard_normal(600)
    bump = np.where(np.arange(600) % 200 < 20, 1.0, 0.0)[:, None]
    before = noise + 10.0 * bump[:, 0]
    after = fit(bump, before).residual
    hidden = screen_by_sign_flips([bump], known, before, blocks)
    assert hidden.family_p_value[0] > 0.005
    assert p_of_much(bump, known, before, after, blocks, looks=600) == pytest.approx(0.001)
    left = fit(bump, noise).residual
    assert p_of_much(bump, known, noise, left, blocks, looks=600) > 0.5


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 1000), st.floats(0.05, 2.0))
def test_the_stop_operator_is_that_of_its_definition(seed, width):
    position = np.cumsum(np.random.default_rng(seed).standard_normal(200)) * 0.3
    state, expected = 0.0, [0.0]
    for step in np.diff(position):
        state = min(width, max(-width, state + step))
        expected.append(state)
    np.testing.assert_allclose(_since_reversal(position, width), expected, atol=1e-9)


def test_units_of_parameters():
    screw = Axis(name="a", motion="linear", input="force")
    motor = Axis(name="b", motion="rotary", input="current")
    assert [unit_of(u, screw) for u in ("u/a", "u/v", "u/x")] == ["kg", "N s/m", "N/m"]
    assert [unit_of(u, motor) for u in ("u/a", "u/v")] == ["A s²/rad", "A s/rad"]
    for law in LAWS.values():
        for unit in law.units.values():
            assert unit_of(unit, screw)


@pytest.mark.parametrize("name", list(LAWS))
def test_every_law_says_what_it_is_and_is_finite(name, bench):
    law = LAWS[name]
    assert law.equation
    assert law.reference
    assert law.meaning
    named = {"amplitude", "phase"} if law.periodic else set(law.coefficients)
    assert set(law.units) == named | set(law.shape)
    trajectory = prepare([bench()], Settings())
    design = Design(trajectory)
    balance, _ = known_balance(DEFAULT_MODEL, design)
    for shape in list(law.grid(trajectory))[:3]:
        term = Term(law=law, shape=shape)
        columns = design.of_prediction(term, balance.terms) if law.of_prediction \
            else design.columns(term)
        assert columns.shape == (len(trajectory.target), len(law.coefficients))
        assert np.isfinite(columns).all()


@pytest.mark.parametrize("name", [n for n, law in LAWS.items() if not law.of_prediction])
def test_no_regressor_looks_at_the_input(name, bench):
    """The same motion with another input has the same regressors."""
    one = prepare([bench()], Settings(band=20.0, standstill=0.01))
    two = prepare([bench(lambda t, q, v, a: 7.0 + np.sign(v))],
                  Settings(band=20.0, standstill=0.01))
    law = LAWS[name]
    for shape in list(law.grid(one))[:2]:
        np.testing.assert_array_equal(Design(one).columns(Term(law=law, shape=shape)),
                                      Design(two).columns(Term(law=law, shape=shape)))


def test_known_terms_move_only_within_their_tolerance(bench):
    model = RigModel.model_validate({"rig": "r", "terms": [
        {"effect": "inertia", "parameters": {"value": 0.04}, "tolerance": 0.1},
        {"effect": "viscous_friction"}]})
    design = Design(prepare([bench()], Settings()))
    balance, _ = known_balance(model, design)
    assert balance.fit.coefficients[0] == pytest.approx(0.044)
    assert balance.fixed.tolist() == [True, False]


@pytest.mark.parametrize(("text", "match"), [
    ("terms: []", "terms"),
    ("rig: a", "no model of a rig"),
    ("terms: [{effect: coulomb}]", "did you mean 'coulomb_friction'"),
    ("terms: [{effect: inertia, parameters: {mass: 1}}]", "unknown parameter of inertia"),
    ("terms: [{effect: stribeck_friction}]", "lacks 'speed'"),
    ("terms: [{effect: cogging_torque, parameters: {order: 4, amplitude: 1}}]",
     "amplitude and phase"),
    ("terms: [{effect: inertia, tolerance: -1}]", "tolerance"),
    ("terms: [{effect: inertia}]\nsettings: {bnad: 3}", "bnad"),
])
def test_wrong_model_files_are_one_line(tmp_path, text, match):
    path = tmp_path / "m.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=match) as caught:
        load_rig_model(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("rows", [0, 1, 2, 5, 40, 119, 1000])
def test_means_over_bins_are_never_empty_where_there_are_rows(rows):
    """A wave that few rows show left no bin with enough of them, and the report died of it."""
    x = np.linspace(0.0, 1.0, rows)
    mean_x, mean_y = binned(x, 2.0 * x, 60)
    assert len(mean_x) == len(mean_y)
    assert (len(mean_x) > 0) == (rows > 0)
    assert mean_y == pytest.approx(2.0 * mean_x)
