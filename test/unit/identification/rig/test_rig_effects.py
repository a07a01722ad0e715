"""Effects of a rig that a sensor, a converter or a spring makes, integrated by hand."""

import re

import numpy as np
import pytest
import yaml
from scipy import interpolate, signal

from ema_identification.rig.fit.model import RigModel, Settings
from ema_identification.rig.laws.dynamics import _build_up
from ema_identification.rig.prepare import prepare
from ema_identification.rig.signals.clocks import response_band
from ema_identification.rig.signals.trajectory import monotone_low_pass, windowed
from ema_identification.rig.workflow import identify_rig
from ema_rig.record import RigRecord


def values(found, name):
    own = [p for f in found.findings for p in f.parameters] + list(found.recalibrated)
    return next(p for p in own if p.name == name)


def shifted(record, lag):
    """Return the record with its input earlier by `lag` seconds."""
    curve = interpolate.CubicSpline(record.time, record.input)
    samples = record.samples[:-20].copy()
    samples[:, 1] = curve(samples[:, 0] + lag)
    return RigRecord(samples=samples, channels=record.channels, axis=record.axis, source="lag")


@pytest.mark.slow
def test_a_lag_below_one_interval_is_no_effect_and_a_longer_one_is_exact(bench):
    record = bench(noise=0.002, duration=12.0)
    held = identify_rig([shifted(record, 0.002)])
    assert held.verdict == "no disagreement"
    taken = re.search(r"input taken (\S+) ms later", " ".join(held.reasons))
    assert float(taken[1]) == pytest.approx(2.0, rel=0.05)
    late = identify_rig([shifted(record, 0.03)])
    assert [f.effect for f in late.findings] == ["control_delay"]
    delay = values(late, "control_delay.delay")
    assert delay.value == pytest.approx(0.03, rel=0.01)
    assert delay.low <= 0.03 <= delay.high
    again = identify_rig([shifted(record, 0.03)],
                         RigModel.model_validate(yaml.safe_load(late.model_text)))
    assert again.verdict == "no disagreement"
    assert values(again, "control_delay.delay").value == pytest.approx(0.03, rel=0.01)


def test_a_load_on_a_spring_is_named_with_its_resonance(bench):
    def load(t, q, v, a):
        """Return what a load on a spring adds, by the exact step response of its equation."""
        omega, damping = 2 * np.pi * 1.4, 0.05
        spring = ([2 * damping * omega, omega**2], [1.0, 2 * damping * omega, omega**2])
        _, late, _ = signal.lsim(spring, a - a[0], t)
        return 0.03 * (late + a[0] - a)
    found = identify_rig([bench(load, noise=0.005)])
    assert [f.effect for f in found.findings] == ["compliance"]
    assert values(found, "compliance.frequency").value == pytest.approx(1.4, rel=0.01)
    assert values(found, "compliance.damping").value == pytest.approx(0.05, rel=0.1)
    assert values(found, "compliance.load_inertia").value == pytest.approx(0.03, rel=0.03)


@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3))])
@pytest.mark.parametrize("frequency", [5.0, 7.0])
def test_a_load_on_a_spring_far_below_its_resonance_is_named_with_what_is_seen_of_it(
        bench, frequency, seed):
    omega = 2 * np.pi * frequency

    def load(t, q, v, a):
        """Return what the load adds, by the exact response to each of the sines."""
        spectrum = np.fft.rfft(a)
        w = 2 * np.pi * np.fft.rfftfreq(len(t), t[1])
        gain = 1.0 / (1.0 - (np.minimum(w, 0.5 * omega) / omega) ** 2)
        return 0.03 * (np.fft.irfft(gain * spectrum, len(t)) - a)
    found = identify_rig([bench(load, noise=0.002, seed=seed)])
    assert [{f.effect, *f.equivalent} for f in found.findings] == [
        {"quasi_static_compliance", "compliance"}]
    c = values(found, "quasi_static_compliance.value").value
    first = 0.03 / omega**2  # of Taylor's series; all of it at the fastest sine, 1.9 Hz
    assert 0.97 * first <= c <= 1.03 * first / (1.0 - (1.9 / frequency) ** 2)


@pytest.mark.slow
def test_friction_that_builds_up_slowly_is_named_with_its_distance(bench):
    found = identify_rig([bench(lambda t, q, v, a: 0.8 * _dahl(q, 0.12), duration=10.0)])
    assert [f.effect for f in found.findings] == ["coulomb_friction", "presliding_hysteresis"]
    assert values(found, "presliding_hysteresis.distance").value == pytest.approx(0.12, rel=0.1)
    assert found.gap_after < 0.1 * found.gap_before


def _dahl(position, distance):
    """Return Dahl's friction by small steps, from its differential equation."""
    state = np.zeros_like(position)
    for k, step in enumerate(np.diff(position)):
        state[k + 1] = state[k]
        for _ in range(50):
            state[k + 1] += (np.sign(step) - state[k + 1]) * abs(step) / 50 / distance
    return state


def test_the_state_of_dahls_model_is_that_of_its_equation():
    position = np.cumsum(np.random.default_rng(0).standard_normal(300)) * 0.02
    np.testing.assert_allclose(_build_up(position, 0.1), _dahl(position, 0.1), atol=0.01)


@pytest.mark.slow
def test_known_terms_off_by_one_factor_are_a_gain(bench):
    model = RigModel.model_validate({"rig": "r", "terms": [
        {"effect": "inertia", "parameters": {"value": 0.05 / 1.3}, "tolerance": 0.05},
        {"effect": "viscous_friction", "parameters": {"value": 0.4 / 1.3}, "tolerance": 0.05}]})
    found = identify_rig([bench(duration=10.0)], model)
    assert "all known terms are 1.3 times" in " ".join(found.reasons)
    assert values(found, "inertia.value").value == pytest.approx(0.05, rel=0.02)
    assert values(found, "viscous_friction.value").value == pytest.approx(0.4, rel=0.02)


@pytest.mark.slow
def test_an_inertia_below_its_tolerance_is_named_too(bench):
    model = RigModel.model_validate({"rig": "r", "terms": [
        {"effect": "inertia", "parameters": {"value": 0.08}, "tolerance": 0.1},
        {"effect": "viscous_friction"}]})
    found = identify_rig([bench(duration=10.0)], model)
    assert [f.effect for f in found.findings] == ["inertia_change"]
    assert values(found, "inertia.value").value == pytest.approx(0.05, rel=0.03)


def test_steps_of_a_converter_do_not_widen_the_band():
    """A slow motion seen by a coarse encoder: its steps are red, and no part of the response."""
    t = np.arange(25_000) / 1000.0
    motion = 0.9 * np.sin(2 * np.pi * 0.3 * t) + 0.3 * np.sin(2 * np.pi * 0.77 * t)
    steps = 2 * np.pi / 4096
    found = response_band(np.round(motion / steps) * steps, 1000.0, is_position=True)
    assert found.motion < 1.0
    assert found.edge < 20.0


def test_rows_beside_a_standstill_are_left_out_and_no_stop_rings(bench):
    t = np.arange(4000) / 1000.0
    speed = np.where(t < 2.0, 1.0, 0.0)
    smooth = monotone_low_pass(speed, 1000.0, 20.0)
    assert smooth.min() >= -1e-9
    assert smooth.max() <= 1.0 + 1e-9
    share = windowed((t >= 2.0).astype(float), 1000.0, 20.0)
    assert share[1700] == pytest.approx(0.0, abs=1e-3)
    assert share[2000] == pytest.approx(0.5, abs=0.02)
    assert prepare([bench()], Settings()).steady.mean() > 0.3
