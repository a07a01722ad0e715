"""Export: other tools get every number."""

import csv
import dataclasses
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest
from rosbags.highlevel import AnyReader

from ema_record.bag.export import (
    COMMANDED,
    FORMATS,
    PHASE,
    REFERENCE_CURRENTS_TOPIC,
    default_path,
    export_record,
    phases,
)
from ema_record.channels import CHANNELS
from ema_record.errors import OutputError, UsageError
from ema_record.profile import Profile
from ema_record.wire.topics import DC_BUS, JOINT_STATES, PHASE_CURRENTS, WINDING_TEMPERATURE


@pytest.fixture
def short(record):
    return dataclasses.replace(record, samples=record.samples[:1200])


def test_csv_is_exact(short, tmp_path):
    path = export_record(short, tmp_path / "a.csv", "csv")
    with path.open(newline="") as file:
        first, *rows = csv.reader(file)
    assert first[:3] == ["time[s]", "motor_speed[rad/s]", "phase_current_a[A]"]
    np.testing.assert_array_equal(np.array(rows, dtype=float), short.samples)


def test_parquet_is_exact_and_has_units(short, tmp_path):
    table = pq.read_table(export_record(short, tmp_path / "a.parquet", "parquet"))
    assert table.column_names == [c.name for c in CHANNELS]
    for index, channel in enumerate(CHANNELS):
        assert table.schema.field(channel.name).metadata[b"unit"].decode() == channel.unit
        np.testing.assert_array_equal(table.column(index).to_numpy(), short.samples[:, index])
    profile = Profile.model_validate_json(table.schema.metadata[b"profile"])
    assert profile == short.profile


def test_messages_one_a_sample(short, tmp_path):
    path = export_record(short, tmp_path / "plot", "mcap")
    found = {topic: [] for topic in (JOINT_STATES, PHASE_CURRENTS, REFERENCE_CURRENTS_TOPIC)}
    others = {topic: [] for topic in (COMMANDED, PHASE, DC_BUS, WINDING_TEMPERATURE)}
    with AnyReader([path]) as reader:
        for connection, time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if connection.topic in others:
                others[connection.topic].append((time, message))
                continue
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time
            if connection.topic == JOINT_STATES:
                row = [*message.position, *message.velocity]
            else:
                row = [message.vector.x, message.vector.y, message.vector.z]
            found[connection.topic].append(row)
    states = np.array(found[JOINT_STATES])
    np.testing.assert_array_equal(states[:, :3], short.samples[:, [8, 9, 1]])
    assert states[:, 3].mean() == pytest.approx(1.58, rel=1e-2)
    np.testing.assert_array_equal(found[PHASE_CURRENTS], short.samples[:, 2:5])
    np.testing.assert_array_equal(found[REFERENCE_CURRENTS_TOPIC], short.samples[:, 5:8])
    np.testing.assert_array_equal(
        [message.data for _, message in others[COMMANDED]],
        short.profile.command(short.samples[:, 0]))
    assert [message.data for _, message in others[PHASE]] == [
        text for _, text in phases(short.profile)]
    bus, winding = short.dc_bus, short.winding_temperature
    assert [m.voltage for _, m in others[DC_BUS]] == pytest.approx(bus[:, 1])
    assert [m.current for _, m in others[DC_BUS]] == pytest.approx(-bus[:, 2])
    assert [m.temperature for _, m in others[WINDING_TEMPERATURE]] == pytest.approx(winding[:, 1])


def test_phases_are_what_is_commanded_from_when_on():
    points = ((0.0, -0.4), (0.02, -0.4), (0.02, 0.4), (1.0, 0.4), (2.0, 0.3), (2.5, 0.3))
    assert phases(Profile(name="test", points=points)) == [
        (0.0, "rest"), (0.02, "slew to +0.4 rad"), (1.0, "ramp to +0.3 rad at 0.1 rad/s"),
        (2.0, "rest")]


@pytest.mark.parametrize("file_format", FORMATS)
def test_existing_output_is_not_touched(short, tmp_path, file_format):
    (tmp_path / "a").write_text("mine")
    with pytest.raises(OutputError, match="exists and is never overwritten"):
        export_record(short, tmp_path / "a", file_format)
    assert (tmp_path / "a").read_text() == "mine"


@pytest.mark.parametrize("file_format", FORMATS)
def test_no_folder_to_write_to(short, tmp_path, file_format):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written"):
        export_record(short, tmp_path / "file" / "a", file_format)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file"]


def test_wrong_format(short, tmp_path):
    with pytest.raises(UsageError, match="unknown export format 'parket': did you mean 'parquet'"):
        export_record(short, tmp_path / "a", "parket")


def test_empty_record(record, tmp_path):
    with pytest.raises(UsageError, match="no sample"):
        export_record(dataclasses.replace(record, samples=record.samples[:0]), tmp_path / "a",
                      "csv")


def test_parquet_without_pyarrow(short, tmp_path, monkeypatch):
    """An environment without the optional package says what to do."""
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(UsageError, match="pip install pyarrow, or export to csv"):
        export_record(short, tmp_path / "a.parquet", "parquet")
    assert list(tmp_path.iterdir()) == []


def test_default_paths():
    assert str(default_path("x/bag", "csv")) == "x/bag.csv"
    assert str(default_path("x/bag", "mcap")) == "x/bag_messages"
    assert str(default_path("x/a.mcap", "parquet")) == "x/a.parquet"
