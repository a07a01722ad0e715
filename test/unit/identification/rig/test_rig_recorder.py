"""What a recorder does is seen and said; a band is taken in which noise does not hide inertia."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from ema_identification.rig.fit.model import Settings
from ema_identification.rig.prepare import prepare
from ema_identification.rig.signals.agree import agreeing_band
from ema_identification.rig.signals.recorder import cleaned, held_for, spikes_of, step_of
from ema_record.errors import IncompleteRecordError
from support.rigs import changed


def friction(_t, _q, v, _a):
    return 0.3 * np.sign(v)


@pytest.mark.parametrize("name", ["position", "input_torque"])
def test_spikes_are_taken_out_and_told_and_steps_are_not(bench, name):
    record = bench(friction)
    rows = np.arange(200, 3800, 400)

    def spoilt(values):
        values = values.copy()
        values[rows] += 3.0 * np.ptp(values) * (-1.0) ** np.arange(len(rows))
        return values

    notes = []
    mended = cleaned(changed(record, **{name: spoilt}), notes)
    assert f"{len(rows)} spike(s) of one sample taken out of {name}" in notes[0]
    np.testing.assert_allclose(mended.channel(name), record.channel(name), atol=0.1)
    assert spikes_of(record.channel("input_torque")).size == 0  # it steps at each reversal
    assert spikes_of(np.repeat([0.0, 1.0, 0.0], 50)).size == 0


def test_many_outliers_are_noise_and_no_spikes():
    values = np.zeros(1000)
    values[5::20] = 1.0
    assert spikes_of(values).size == 0


@pytest.mark.parametrize("held", [2, 4, 10])
def test_held_values_are_left_out_and_told(bench, held):
    record = bench(friction, keep=("position", "speed"), duration=32.0)
    notes = []
    found = cleaned(
        changed(record, input_torque=lambda u: u[np.arange(len(u)) // held * held]), notes)
    assert f"input_torque for {held} samples" in notes[0]
    assert found.rate == pytest.approx(record.rate / held)
    np.testing.assert_array_equal(found.input, record.input[::held])


def test_a_quantised_or_resting_motion_is_not_held(bench):
    t = np.arange(4000) / 500.0
    assert held_for(np.round(np.sin(2 * np.pi * 0.3 * t) * 400)) == (1, 0)
    assert held_for(np.repeat(np.random.default_rng(0).standard_normal(40), 100)) == (1, 0)
    assert held_for(np.random.default_rng(0).standard_normal(4000)) == (1, 0)
    assert held_for(np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 400), 10)) == (1, 0)


def test_too_few_that_are_left_stay_and_are_told(bench):
    record = bench(friction, keep=("position", "speed"), duration=8.0)
    notes = []
    found = cleaned(changed(record, speed=lambda v: v[np.arange(len(v)) // 10 * 10]), notes)
    assert len(found) == len(record)
    assert "too long for this record" in notes[0]


def test_the_steps_of_an_encoder_are_told_in_counts(bench):
    counts = 2000 / (2 * np.pi)
    notes = []
    cleaned(changed(bench(friction), position=lambda q: np.round(q * counts) / counts), notes)
    assert "2000 a turn" in notes[0]
    assert step_of(np.random.default_rng(0).standard_normal(500)) is None
    assert step_of(np.repeat(np.cumsum(np.random.default_rng(0).random(90)), 4)) is None


def pieces_of(q, u, rate):
    return [{"position": q, "input": u, "rate": np.array(rate)}]


def test_noise_that_hides_inertia_makes_the_band_narrower():
    rng = np.random.default_rng(4)
    t = np.arange(8000) / 1000.0
    v = sum(size * np.sin(2 * np.pi * f * t) for size, f in ((1.0, 0.9), (0.5, 2.47), (0.3, 4.1)))
    q, a = np.cumsum(v) / 1000.0, np.gradient(v, t)
    u = 2e-3 * a + 0.01 * v + 2e-4 * rng.standard_normal(len(t))
    notes = []
    coarse = np.round(q / 1e-3) * 1e-3
    assert agreeing_band(pieces_of(coarse, u, 1000.0), 80.0, 4.1, notes) == 20.0
    assert "20.0 Hz instead of 80 Hz: above it noise makes the inertia too small" in notes[0] \
        or "20 Hz instead of 80 Hz: above it noise makes the inertia too small" in notes[0]
    assert "without any other law 0.00199 and 0.0102, agree" in notes[1]
    notes.clear()
    assert agreeing_band(pieces_of(q, u, 1000.0), 80.0, 4.1, notes) == 80.0
    assert "agree over bands" in notes[0]


def test_a_resonance_does_not_make_the_band_narrower():
    rng = np.random.default_rng(2)
    t = np.arange(8000) / 500.0
    a = signal.lfilter(*signal.butter(2, 0.2), rng.standard_normal(len(t)))
    v = np.cumsum(a) / 500.0
    omega, damping = 2 * np.pi * 15.0, 0.05
    _, load, _ = signal.lsim(([2 * damping * omega, omega**2],
                              [1.0, 2 * damping * omega, omega**2]), a, t)
    u = 1.0 * a + 2.0 * load + 0.5 * v + 0.01 * rng.standard_normal(len(t))
    q = np.cumsum(v) / 500.0
    assert agreeing_band(pieces_of(q, u, 500.0), 40.0, 2.0, []) == 40.0


def test_one_step_to_a_speed_is_used_where_it_shows_the_axis(axis, recorded):
    t = np.arange(5000) / 500.0
    v = 8.0 * (1 - np.exp(-np.maximum(t - 1.0, 0.0) / 1.5)) * (t > 1.0) \
        + 2.0 * (1 - np.exp(-np.maximum(t - 6.0, 0.0) / 0.5)) * (t > 6.0)
    a, q = np.gradient(v, t), np.cumsum(v) / 500.0
    found = prepare([recorded(t, 0.05 * a + 0.4 * v, axis, position=q)], Settings())
    assert len(found.target) >= 60
    flat = np.full_like(t, 3.0) + 1e-6 * t
    with pytest.raises(IncompleteRecordError, match="cycles"):
        prepare([recorded(t, 0.4 * flat, axis, position=np.cumsum(flat) / 500.0)], Settings())


def test_where_samples_are_missing_the_band_is_what_they_tell(bench):
    """Lines over the holes bent as a load on a spring would: it was named."""
    record = bench(friction, duration=32.0)
    kept = np.random.default_rng(3).random(len(record.samples)) < 0.6
    holes = replace(record, samples=record.samples[kept])
    trajectory = prepare([holes], Settings())
    assert "many samples are missing" in " ".join(trajectory.notes)
    assert trajectory.band < prepare([record], Settings()).band
