"""Records that cannot be used: each says what is wrong and which test to run."""

import numpy as np
import pytest

from ema_identification.identify import identify
from ema_identification.rig.fit.model import Settings
from ema_identification.rig.prepare import prepare
from ema_identification.rig.workflow import identify_rig
from ema_record.errors import EmaError, IncompleteRecordError, InvalidRecordError, UsageError
from ema_rig.record import Axis, RigRecord
from support.rigs import changed


@pytest.mark.parametrize(("factor", "match"), [
    (60 / (2 * np.pi), r"rev/min \(rpm\)"),
    (180 / np.pi, "deg/s"),
    (1 / (2 * np.pi), "rev/s"),
    (np.pi / 180, "position is in degrees"),
    (2 * np.pi, "position is in turns"),
    (-1.0, "opposite signs"),
    (1.7, r"integrates to 1\.7 times the position: correct"),
])
def test_a_wrong_unit_is_named(bench, factor, match):
    record = bench(keep=("position", "speed"))
    with pytest.raises(InvalidRecordError, match=match):
        prepare([changed(record, speed=lambda v: v * factor)], Settings())
    prepare([record], Settings())


def test_a_linear_axis_in_millimetres_is_named(bench):
    axis = Axis(name="l", motion="linear", input="force")
    record = bench(keep=("position", "speed"), own_axis=axis)
    with pytest.raises(InvalidRecordError, match="position is in mm and speed in m/s"):
        prepare([changed(record, position=lambda q: q * 1000)], Settings())


@pytest.mark.parametrize(("columns", "match"), [
    ({"position": lambda q: q * 0.0 + 1.0}, "position is 1 rad throughout"),
    ({"input_torque": lambda u: u * 0.0}, "input_torque is 0 N m throughout"),
    ({"position": lambda q: 1e-7 * np.random.default_rng(0).standard_normal(len(q))},
     "record a run with reversals"),
])
def test_no_excitation_says_which_test_to_run(bench, columns, match):
    with pytest.raises(EmaError, match=match):
        identify_rig([changed(bench(), **columns)])


def test_a_record_is_given_once(bench):
    record = bench()
    for measured, held, says in (([record], [changed(record)], "a gap shown on the data"),
                                 ([record, changed(record)], [], "would count as two")):
        with pytest.raises(UsageError, match=says) as caught:
            identify(measured, validate=held)
        assert "\n" not in str(caught.value)


def test_speed_that_does_not_belong_to_the_position(bench):
    record = bench(keep=("position", "speed"))
    noise = np.random.default_rng(0).standard_normal(len(record))
    with pytest.raises(InvalidRecordError, match="does not follow the position"):
        prepare([changed(record, speed=lambda v: noise)], Settings())


def test_too_short_says_so(bench):
    record = bench()
    short = RigRecord(samples=record.samples[:120], channels=record.channels, axis=record.axis,
                      source="s")
    with pytest.raises(IncompleteRecordError, match="120 samples, at least 200"):
        identify_rig([short])
    cut = changed(RigRecord(samples=record.samples[:210], channels=record.channels,
                            axis=record.axis, source="s"),
                  position=lambda q: np.sin(2 * np.pi * 0.4 * np.arange(len(q)) / 250.0))
    with pytest.raises(IncompleteRecordError, match="several cycles"):
        identify_rig([cut])


def test_records_of_two_axes_are_not_mixed(bench):
    other = bench(own_axis=Axis(name="o", motion="rotary", input="current"))
    with pytest.raises(UsageError, match="identify records of one axis"):
        identify_rig([bench(), other])
    with pytest.raises(UsageError, match="give at least one"):
        identify_rig([])


def test_an_unknown_name_to_hide_is_named(bench):
    with pytest.raises(UsageError, match="did you mean 'coulomb_friction'"):
        identify_rig([bench()], without=("coulomb_frction",))


def test_gaps_split_the_record_and_are_said(bench):
    record = bench()
    samples = np.delete(record.samples, slice(1500, 1700), axis=0)
    holed = RigRecord(samples=samples, channels=record.channels, axis=record.axis, source="s")
    trajectory = prepare([holed], Settings())
    assert len(trajectory.segments) == 2
    assert "1 gap of" in trajectory.notes[0]
    edge = 1.0 / trajectory.band
    assert not ((trajectory.time > 6.0 - 0.3 * edge) & (trajectory.time < 6.8)).any()


@pytest.mark.parametrize(("first", "second"), [
    (("position", "speed"), ("position",)), (("position",), ("speed",)),
])
def test_records_of_one_axis_have_the_same_channels(bench, first, second):
    with pytest.raises(UsageError, match="identify records with the same channels together"):
        prepare([bench(keep=first), bench(keep=second)], Settings())
