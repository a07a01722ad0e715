"""A message after the last one: whole bags at every moment, that others read."""

import json
import os
import shutil

import pytest
from mcap.reader import NonSeekingReader, make_reader
from rosbags.rosbag2 import Reader

from ema_record.bag import annotate
from ema_record.bag.annotate import VERDICT, add_last_message
from ema_record.bag.read import read_bag
from ema_record.checks.run import lint_bag
from ema_record.errors import InvalidRecordError, OutputError
from ema_record.wire.topics import TOPICS
from ema_record.wire.topics import VERDICT as TOPIC
from ema_record.wire.types import message_class, serialize

LATE = 1_900_000_000_000_000_000
SAID = {"verdict": "fault", "fault_code": "EMA_TURN_SHORT_B"}


def message():
    kind = TOPICS[TOPIC].type
    return serialize(message_class(kind)(
        level=2, name="verdict", message="fault", hardware_id="EMA-1", values=[]), kind)


@pytest.fixture
def bag(repository, tmp_path):
    return shutil.copytree(repository / "bags" / "sim_0000_step", tmp_path / "sim_0000_step")


def add(bag):
    add_last_message(bag, TOPICS[TOPIC], message(), LATE, SAID, b'{"verdict": "fault"}')


def test_the_message_is_the_last_one_and_the_record_is_as_it_was(bag):
    before = read_bag(bag)
    add(bag)
    after = read_bag(bag)
    assert (after.samples == before.samples).all()
    assert after.provenance == before.provenance
    assert lint_bag(bag).findings == ()
    assert sorted(p.name for p in bag.iterdir()) == ["metadata.yaml", "sim_0000_step_0.mcap"]


def test_it_is_the_last_one_where_the_clock_was_set_back(bag):
    with Reader(bag) as reader:
        *_, (_, last, _) = reader.messages()
    add_last_message(bag, TOPICS[TOPIC], message(), 1, SAID)
    with Reader(bag) as reader:
        *_, (connection, stamp, _) = reader.messages()
    assert (connection.topic, stamp) == (TOPIC, last)


def test_other_readers_find_it_by_their_index_and_by_their_checksums(bag):
    add(bag)
    with Reader(bag) as reader:
        *_, (connection, stamp, data) = reader.messages()
        assert (connection.topic, stamp, bytes(data)) == (TOPIC, LATE, message())
        count = reader.message_count
    with (bag / "sim_0000_step_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_summary().statistics.message_count == count
        ((_, channel, found),) = reader.iter_messages(topics=[TOPIC])
        assert (channel.topic, bytes(found.data)) == (TOPIC, message())
        records = {m.name: m.metadata for m in reader.iter_metadata()}
        (attached,) = reader.iter_attachments()
        assert reader.get_summary().statistics.attachment_count == 1
        stream.seek(0)
        assert [a.data for a in NonSeekingReader(stream).iter_attachments()] == [attached.data]
    assert (attached.name, attached.media_type) == ("verdict.json", "application/json")
    assert json.loads(attached.data) == {"verdict": "fault"}
    assert records[VERDICT] == SAID
    assert f"message_count: {count}" in records["rosbag2"]["serialized_metadata"]


def test_a_second_verdict_is_refused(bag):
    add(bag)
    whole = [path.read_bytes() for path in sorted(bag.iterdir())]
    with pytest.raises(InvalidRecordError, match="/ema/verdict already"):
        add(bag)
    assert [path.read_bytes() for path in sorted(bag.iterdir())] == whole


@pytest.mark.parametrize("steps", range(4))
def test_a_death_at_any_step_leaves_a_whole_bag(bag, monkeypatch, steps):
    """Each of the file and the metadata is written beside the old one, then renamed."""
    done = []

    def die(*_):
        done.append(1)
        if len(done) > steps:
            raise OSError(28, "No space left on device")

    fsync, replaced = os.fsync, annotate.Path.replace
    monkeypatch.setattr(annotate.os, "fsync", lambda fd: (die(), fsync(fd)))
    monkeypatch.setattr(annotate.Path, "replace", lambda a, b: (die(), replaced(a, b)))
    monkeypatch.setattr(annotate, "sync_directory", lambda _: None)
    with pytest.raises(OutputError, match="No space left"):
        add(bag)
    assert len(read_bag(bag)) == 9000
    with Reader(bag) as reader:
        assert sum(1 for _ in reader.messages()) >= 1800
    assert sorted(p.name for p in bag.iterdir()) == ["metadata.yaml", "sim_0000_step_0.mcap"]
