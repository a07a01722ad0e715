"""The record checks: a good record passes, each flaw is found by its own check."""

import re
from dataclasses import replace

import numpy as np
import pytest

from ema_record.channels import CHANNEL_NAMES
from ema_record.checks.facts import facts_of_record
from ema_record.checks.guard import guard_findings, reason_of
from ema_record.checks.live import Level, check_counters, check_record, expected_course, worst
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate


@pytest.fixture(scope="module")
def good():
    """Return the record of a healthy actuator."""
    return simulate(load_profile("step"), seed=3)


def levels(record):
    return {result.name: result.level for result in check_record(record)}


def flawed(record, change):
    samples = record.samples.copy()
    changed = change(samples)
    return replace(record, samples=samples if changed is None else changed)


def put(column, value, rows=slice(100, 101)):
    def change(samples):
        samples[rows, column] = value
    return change


def test_a_healthy_record_passes_all(good):
    assert set(levels(good).values()) == {Level.OK}


@pytest.mark.parametrize(("change", "name", "level"), [
    (lambda s: np.delete(s, slice(500, 700), axis=0), "count", Level.ERROR),
    (lambda s: s[:-1], "count", Level.ERROR),
    (lambda s: np.concatenate([s[:600], s[400:]]), "time order", Level.ERROR),
    (put(2, np.nan), "finite", Level.ERROR),
    (put(9, np.inf), "finite", Level.ERROR),
    (put(1, 1200.0), "range", Level.ERROR),
    (put(9, -0.9), "range", Level.ERROR),
    (put(8, 7.5), "range", Level.ERROR),
    (put(5, 22.0, slice(1000, 4000)), "saturation", Level.WARN),
    (lambda s: s.__setitem__((slice(None), 3), s[:, 3] + 0.5), "current sum", Level.WARN),
    (lambda s: s.__setitem__((slice(None), 3), s[:, 3] + 5.0), "current sum", Level.ERROR),
    (lambda s: s.__setitem__((slice(None), 1), s[:, 1] * 0.9), "speed against position",
     Level.ERROR),
    (lambda s: s.__setitem__((slice(4000, None), 9), s[4000, 9]), "command reached",
     Level.WARN),
])
def test_each_flaw_is_found(good, change, name, level):
    assert levels(flawed(good, change))[name] is level


def test_a_jammed_actuator_is_unusual_and_its_record_still_good():
    record = simulate(
        load_profile("step"), effects=parse_effects(["motor_friction.increase=2.0"])
    )
    found = levels(record)
    assert found["saturation"] is Level.WARN
    assert found["command reached"] is Level.WARN
    assert worst(check_record(record)) is Level.WARN


def test_an_empty_record_fails_and_does_not_raise(good):
    results = check_record(replace(good, samples=np.empty((0, 10))))
    assert worst(results) is Level.ERROR


def test_counters():
    assert check_counters(9000, 9000).level is Level.OK
    lost = check_counters(9000, 8600)
    assert lost.level is Level.ERROR
    assert lost.message == "400 samples lost"
    assert lost.values == {"samples_published": "9000", "samples_recorded": "8600"}
    assert check_counters(None, 9000).level is Level.ERROR


def test_the_expected_course_is_the_limited_first_order_lag(good):
    course = expected_course(facts_of_record(good))
    slewing = (good.time > 0.1) & (good.time < 0.4)
    speed = np.diff(course[slewing]) * good.rate
    assert speed == pytest.approx(790.6 / 500.0)


@pytest.mark.parametrize("channel", ["time", "phase_current_b", "surface_position"])
def test_numbers_beyond_all_sense_are_short(good, channel):
    samples = good.samples.copy()
    samples[:, CHANNEL_NAMES.index(channel)] *= 1e300
    record = replace(good, samples=samples)
    said = [text for result in check_record(record)
            for text in (result.message, *result.values.values())]
    said += [reason_of(finding) for finding in guard_findings(record)]
    assert "e+" in " ".join(said)
    assert max(map(len, said)) < 600 and not any(re.search(r"\d{20}", text) for text in said)


def test_a_short_record_without_rotor_angle_is_looked_at(good):
    samples = good.samples[:100].copy()
    samples[:, CHANNEL_NAMES.index("rotor_angle")] = np.nan
    assert [f.rule for f in guard_findings(replace(good, samples=samples))] == [
        "record_length", "missing_channel"]


@pytest.mark.parametrize("ppm", [-400, -37, 3, 250])
def test_a_clock_that_is_a_little_off_loses_no_sample(ppm):
    """Of a recorder of its own the samples are as many as fit into the test."""
    record = simulate(load_profile("step"), seed=3, rate=20_000.0 * (1.0 + 1e-6 * ppm))
    assert levels(record)["count"] is Level.OK
    assert levels(replace(record, samples=record.samples[:-2]))["count"] is Level.ERROR
