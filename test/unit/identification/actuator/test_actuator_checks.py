"""Records that cannot be identified are refused in one line that says what to do."""

from dataclasses import replace

import numpy as np
import pytest

from ema_cli.main import run
from ema_identification.identify import _is_alike, identify
from ema_record.bag.read import write_bag
from ema_record.channels import CHANNEL_NAMES
from ema_record.errors import EmaError, IncompleteRecordError, InvalidRecordError, UsageError
from ema_record.profile import load_profile
from ema_record.record import Provenance
from ema_sim.simulate import simulate


@pytest.fixture(scope="module")
def record():
    return simulate(load_profile("step"), seed=1)


def changed(record, factor=1.0, value=None, channels=(), part=slice(None)):
    samples = record.samples[part].copy()
    for name in channels:
        at = CHANNEL_NAMES.index(name)
        samples[:, at] = samples[:, at] * factor if value is None else value
    return replace(record, samples=samples)


CURRENTS = [f"{k}_current_{p}" for k in ("phase", "reference") for p in "abc"]


@pytest.mark.parametrize(("change", "error", "said"), [
    ({"part": slice(0, 800)}, IncompleteRecordError, "too short"),
    ({"part": slice(0, 6000)}, IncompleteRecordError, "ends at 0.30 s"),
    ({"factor": 9.5493, "channels": ["motor_speed"]}, InvalidRecordError, "rpm"),
    ({"factor": 57.296, "channels": ["motor_speed"]}, InvalidRecordError, "deg/s"),
    ({"factor": 0.159155, "channels": ["motor_speed"]}, InvalidRecordError, "turns/s"),
    ({"factor": -1.0, "channels": ["motor_speed"]}, InvalidRecordError, "opposite senses"),
    ({"factor": 57.296, "channels": ["surface_position"]}, InvalidRecordError, "degrees"),
    ({"factor": 57.296, "channels": ["rotor_angle"]}, InvalidRecordError, "degrees, expected rad"),
    ({"factor": 1e3, "channels": CURRENTS}, InvalidRecordError, "mA"),
    ({"factor": 1e3, "channels": CURRENTS[:3]}, InvalidRecordError, "mA"),
    ({"factor": 1e3, "channels": CURRENTS[3:]}, InvalidRecordError, "mA"),
    ({"factor": 1e-3, "channels": CURRENTS[:3]}, InvalidRecordError, "one of the two is in mA"),
    ({"value": 0.0, "channels": ["phase_current_b"]}, InvalidRecordError, "phase current b"),
    ({"value": 0.0, "channels": ["motor_speed"]}, InvalidRecordError, "motor_speed"),
    ({"value": np.nan, "channels": ["phase_current_b"]}, InvalidRecordError,
     "no channel phase_current_b"),
    ({"value": np.nan, "channels": ["phase_current_b", "phase_current_c"]}, InvalidRecordError,
     "not finite|no channel"),
])
def test_a_record_that_cannot_be_used_is_named(record, change, error, said):
    with pytest.raises(error, match=said) as caught:
        identify([changed(record, **change)])
    assert "\n" not in str(caught.value)


def test_a_record_too_short_is_unusable_data_for_the_command(record, tmp_path, capsys):
    write_bag(changed(record, part=slice(0, 800)), tmp_path / "short")
    (write_bag(record, tmp_path / "cut") / "metadata.yaml").unlink()
    for name, problem in (("short", "too short"), ("cut", "no metadata.yaml")):
        assert run(["identify", str(tmp_path / name), "--out", str(tmp_path / "out")]) == 2, name
        error = capsys.readouterr().err
        assert problem in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_too_few_samples_a_turn_and_another_actuator(record):
    """The rate that is needed is the actuator's: 24 samples an electrical turn."""
    slow = simulate(load_profile("step"), seed=1, rate=2_500.0)
    with pytest.raises(InvalidRecordError, match="2500 samples/s, at least 3020"):
        identify([slow])
    named = replace(record, provenance=replace(record.provenance, actuator="0123456789abcdef"))
    with pytest.raises(UsageError, match="give the kit that it was recorded with") as caught:
        identify([named])
    assert "\n" not in str(caught.value)


def test_no_excitation_names_the_test_to_run(record):
    quiet = load_profile("step").model_copy(update={
        "name": "quiet", "points": ((0.0, -0.4), (0.022, -0.4), (0.022, -0.399), (0.45, -0.399))})
    with pytest.raises(IncompleteRecordError, match=r"no excitation.*run the profile 'extended'"):
        identify([simulate(quiet, seed=1)])


@pytest.mark.parametrize("points", [
    ((0.0, 0.4), (0.022, 0.4), (0.022, -0.4), (0.45, -0.4)),
    ((0.0, -0.4), (0.022, -0.4), (0.022, 0.4), (0.2, 0.4), (0.2, -0.4), (0.45, -0.4))])
def test_a_record_of_another_profile_is_refused(record, points):
    """The other way, or there and back."""
    other = load_profile("step").model_copy(update={"name": "other", "points": points})
    with pytest.raises(InvalidRecordError, match="another profile"):
        identify([replace(record, profile=other)])


def of(record, serial, source):
    return replace(record, provenance=Provenance(serial_number=serial, source=source))


def test_records_of_two_units_are_refused_wherever_they_stand(record):
    one, other = of(record, "SN-1", "bags/one"), of(record, "SN-2", "bags/other")
    for measured, validate in (([one], [other]), ([one, other], [])):
        with pytest.raises(UsageError, match=r"bags/one .* SN-1, bags/other .* SN-2") as caught:
            identify(measured, validate=validate)
        assert "\n" not in str(caught.value)


def test_a_record_without_a_serial_number_may_be_of_any_unit(record):
    another = simulate(record.profile, seed=2)
    short = changed(of(another, "unknown", ""), part=slice(0, 800))
    with pytest.raises(IncompleteRecordError, match="too short"):
        identify([of(record, "SN-1", "bags/one")], validate=[short])


def test_the_same_record_cannot_validate(record):
    with pytest.raises(UsageError, match="as measured and for validation"):
        identify([record], validate=[record])


def test_a_part_of_a_record_cannot_validate_it_and_another_test_can(record):
    part = changed(record, part=slice(40, len(record.time) - 40))
    with pytest.raises(UsageError, match="as measured and for validation"):
        identify([record], validate=[part])
    other = simulate(record.profile, seed=12)
    assert not _is_alike(record.samples, other.samples)


def test_a_value_that_is_no_reading_is_named(record):
    samples = record.samples.copy()
    samples[100, 3] = 1e300
    with pytest.raises(InvalidRecordError, match=r"phase_current_b reads 1e\+300, at most 1e\+06"):
        identify([replace(record, samples=samples)])


def test_the_same_record_does_not_count_as_two(record):
    with pytest.raises(UsageError, match="twice as measured: it would count as two"):
        identify([record, replace(record)])


def test_a_baseline_is_checked_before_anything_is_fitted(record):
    told = []
    for other, error, said in (
            (record, UsageError, "as measured and as baseline: nothing has changed"),
            (simulate(load_profile("extended"), seed=2), UsageError, "give one of the same test"),
            (simulate(load_profile("step"), seed=2, rate=10_000.0), UsageError, "same test"),
            (changed(simulate(record.profile, seed=2), part=slice(0, 6000)),
             IncompleteRecordError, "ends at 0.30 s")):
        with pytest.raises(error, match=said) as caught:
            identify([record], baseline=[other], progress=lambda *said: told.append(said))
        assert "\n" not in str(caught.value)
    assert told == []


def test_an_unknown_effect_is_named_with_the_nearest(record):
    with pytest.raises(UsageError, match="did you mean 'cogging_torque'"):
        identify([record], without=["coging_torque"])


def test_a_model_with_an_unknown_effect_is_refused(record, tmp_path):
    path = tmp_path / "model.yaml"
    path.write_text("effects:\n  coging_torque:\n    amplitude: 0.1\n", encoding="utf-8")
    with pytest.raises(EmaError, match="did you mean 'cogging_torque'"):
        identify([record], path)


def test_no_record_at_all():
    with pytest.raises(UsageError, match="at least one"):
        identify([])
