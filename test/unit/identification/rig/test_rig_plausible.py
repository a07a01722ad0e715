"""Columns that cannot be what they are called are named; real limits and weights are not."""

from dataclasses import replace

import numpy as np
import pytest

from ema_identification.rig.fit.model import Settings
from ema_identification.rig.fit.visible import what_shows
from ema_identification.rig.prepare import prepare
from ema_identification.rig.signals.sensor_range import check_range
from ema_record.errors import InvalidRecordError

BOTH = ("position", "speed")


def friction(_t, _q, v, _a):
    return 0.3 * np.sign(v)


def changed(record, **columns):
    """Return the record with columns replaced by a function of its samples by name."""
    names = [c.name for c in record.channels]
    samples = record.samples.copy()
    for name, function in columns.items():
        samples[:, names.index(name)] = function(
            {n: record.samples[:, k] for k, n in enumerate(names)})
    return replace(record, samples=samples)


def said(record):
    with pytest.raises(InvalidRecordError) as caught:
        prepare([record], Settings())
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("keep", [BOTH, ("position",), ("speed",)])
def test_a_reversed_input_is_named(bench, keep):
    record = bench(friction, keep=keep)
    prepare([record], Settings())
    text = said(changed(record, input_torque=lambda c: -c["input_torque"]))
    assert "the torque is reversed" in text
    assert "set 'scale: -1' of the input in the map" in text


def test_a_weight_or_a_spring_that_drives_is_no_reversed_input(bench):
    for extra in (lambda t, q, v, a: 9.0 * np.cos(q - 0.4), lambda t, q, v, a: -8.0 * q,
                  lambda t, q, v, a: -30.0 + 0.0 * q):
        prepare([bench(extra, keep=BOTH)], Settings())


@pytest.mark.parametrize("keep", [BOTH, ("position",)])
def test_an_input_without_a_sign_is_named(bench, keep):
    record = bench(friction, keep=keep)
    assert "the torque has no sign" in said(
        changed(record, input_torque=lambda c: np.abs(c["input_torque"])))
    prepare([bench(lambda t, q, v, a: 30.0 + 0.0 * q, keep=keep)], Settings())


@pytest.mark.parametrize("keep", [BOTH, ("position",)])
def test_a_counter_that_starts_again_is_named(bench, keep):
    record = bench(friction, keep=keep)
    wrapped = changed(record, position=lambda c: np.mod(c["position"] + 1.0, 1.5))
    text = said(wrapped)
    assert "a counter that starts again: set 'unwrap:'" in text
    assert float(text.split("times by ")[1].split()[0]) == pytest.approx(1.5, rel=0.02)


def test_ten_spikes_are_no_counter(bench):
    record = bench(friction, keep=BOTH)
    samples = record.samples.copy()
    samples[np.arange(100, 2100, 200), 2] += 4.0
    try:
        prepare([replace(record, samples=samples)], Settings())
    except InvalidRecordError as error:
        assert "starts again" not in str(error)


def test_a_clipped_input_is_named_and_a_drive_at_its_limit_is_not(bench, recorded, axis):
    record = bench(friction)
    limit = float(np.quantile(np.abs(record.input), 0.85))
    text = said(changed(record, input_torque=lambda c: np.clip(c["input_torque"], -limit, limit)))
    assert f"the torque is clipped at {limit:.4g} N m" in text
    # A drive at its limit: the same plateau, but the motion is that of the limited torque.
    t = np.arange(0.0, 16.0, 0.001)
    u = np.clip(1.6 * np.sin(2 * np.pi * 0.7 * t) + np.sin(2 * np.pi * 1.9 * t), -1.2, 1.2)
    q, v = np.zeros((2, len(t)))
    for k in range(1, len(t)):
        v[k] = v[k - 1] + 0.001 * (u[k - 1] - 0.4 * v[k - 1]) / 0.05
        q[k] = q[k - 1] + 0.001 * v[k]
    prepare([recorded(t, u, axis, noise=0.0, position=q, speed=v)], Settings())


@pytest.mark.parametrize("keep", [BOTH, ("position",)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_clipped_position_is_named(bench, keep, seed):
    record = bench(friction, keep=keep, seed=seed)
    prepare([record], Settings())
    top = float(np.quantile(record.channel("position"), 0.9))
    text = said(changed(record, position=lambda c: np.minimum(c["position"], top)))
    assert f"the position is clipped at {top:.5g} rad for 10 % of the samples" in text
    assert ("leave it out of the map, as the speed is there" in text) == (keep == BOTH)
    low = float(np.quantile(record.channel("position"), 0.05))
    text = said(changed(record, position=lambda c: np.clip(c["position"], low, top)))
    assert "the position is clipped" in text


@pytest.mark.parametrize("samples", [3, 6, 20])
@pytest.mark.parametrize("step", [1e-4, 3e-3])
def test_a_rest_at_the_end_of_the_travel_is_no_clipped_position(recorded, axis, samples, step):
    n = 9000
    a = np.zeros(n)
    for k, start in enumerate(range(100, n - 900, 400)):  # to and fro between two places
        a[start:start + samples] = (-1) ** k
        a[start + 200:start + 200 + samples] = -(-1) ** k
    speed = np.cumsum(a) * 2.0 / samples
    position = np.r_[0.0, np.cumsum(speed)[:-1]] * 0.004
    record = recorded(0.004 * np.arange(n), 25.0 / samples * a + 0.4 * speed, axis,
                      position=np.round(position / step) * step)
    check_range(record, 0.005)


@pytest.mark.parametrize(("one", "other"), [
    ("position", "speed"), ("input_torque", "position"), ("input_torque", "speed")])
def test_swapped_columns_are_named(bench, one, other):
    record = bench(friction, keep=BOTH)
    text = said(changed(record, **{one: lambda c: c[other], other: lambda c: c[one]}))
    assert f"{one.replace('_torque', '')} and {other} are swapped" in text


@pytest.mark.parametrize("output", ["position", "speed"])
def test_an_input_swapped_with_the_only_output_is_named(bench, output):
    record = bench(friction, keep=(output,))
    assert f"input and {output} are swapped" in said(changed(
        record, input_torque=lambda c: c[output], **{output: lambda c: c["input_torque"]}))


def test_a_time_in_milliseconds_is_named(bench):
    record = bench(keep=BOTH)
    assert "time is in ms" in said(changed(record, time=lambda c: 1000.0 * c["time"]))


def test_runs_with_gaps_between_are_compared_each_for_itself(bench):
    """The position jumps between the runs, as after an axis that was carried back."""
    records = [bench(friction, keep=BOTH, seed=k, duration=6.0).samples for k in range(4)]
    for k, samples in enumerate(records):
        samples[:, 0] += 100.0 * k
        samples[:, 2] += 50.0 * k
    record = replace(bench(keep=BOTH), samples=np.concatenate(records))
    prepare([record], Settings())


def shown(record):
    return {p.name: p for p in what_shows(prepare([record], Settings())).parameters}


def test_the_check_says_what_is_apart(bench, recorded, axis):
    check = what_shows(prepare([bench(friction)], Settings()))
    assert all(p.shown for p in check.parameters)
    assert 1.0 < check.condition < 20.0
    assert check.lines == (
        "this record can show inertia, viscous friction, Coulomb friction, an offset, a stiffness "
        f"(condition number {check.condition:.3g})",)
    # One sine: the acceleration is the position, turned over.
    t = np.arange(0.0, 16.0, 0.004)
    w = 2 * np.pi * 0.8
    record = recorded(t, np.sin(w * t), axis, position=np.sin(w * t), speed=w * np.cos(w * t))
    found = shown(record)
    assert not found["inertia"].shown
    assert not found["spring"].shown
    assert found["viscous_friction"].shown
    line = next(x for x in what_shows(prepare([record], Settings())).lines if "inertia apart" in x)
    assert "it cannot show inertia apart from a stiffness" in line
    assert "a second sine at least twice as fast" in line


def test_one_way_motion_cannot_tell_friction_from_an_offset(recorded, axis):
    t = np.arange(0.0, 16.0, 0.004)
    v = 6.0 + 2.0 * np.sin(3 * t) + np.sin(7.3 * t)
    q = 6.0 * t - 2.0 / 3 * np.cos(3 * t) - np.cos(7.3 * t) / 7.3
    found = shown(recorded(t, v, axis, position=q, speed=v))
    assert not found["coulomb_friction"].shown
    assert found["coulomb_friction"].alike == "offset"
    assert found["coulomb_friction"].motion == "both directions"
    assert found["inertia"].shown


def test_the_lost_motion_between_two_sensors_is_seen(bench, moving):
    t, q, v, a = moving(16.0, seed=1)
    record = bench(friction, keep=BOTH)
    gap, wound = 0.02, 1e-5
    output = q - 0.5 * gap * np.sign(v) - wound * a + 2e-4 * np.random.default_rng(4).normal(
        size=len(t))
    two = replace(record, samples=np.column_stack([record.samples, output]),
                  channels=(*record.channels, record.axis.channels[4]))
    line = next(n for n in prepare([two], Settings()).notes if "lost motion" in n)
    low, high = (float(x) for x in line.split("90 %: ")[1].split(")")[0].split(" to "))
    assert low - 0.02 * gap < gap < high + 0.02 * gap
    assert high - low < 0.05 * gap
    far = replace(two, samples=two.samples * np.array([1, 1, 1, 1, 1.2]))
    line = next(n for n in prepare([far], Settings()).notes if "correct its scale" in n)
    assert float(line.split("moves ")[1].split()[0]) == pytest.approx(1.2, rel=0.02)
