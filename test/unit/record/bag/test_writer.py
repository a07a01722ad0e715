"""`BagWriter`: what the live recorder relies on."""

import dataclasses
import errno
import os
import resource
import shutil
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from ema_record.bag.mcap_stream import McapMessage, McapStream
from ema_record.bag.read import read_bag, write_bag
from ema_record.bag.writer import CHUNK_SIZE, BagWriter
from ema_record.errors import IncompleteRecordError, OutputError, UsageError
from ema_record.limits import MAX_MESSAGE_BYTES
from ema_record.profile import load_profile
from ema_record.record import Provenance
from ema_record.wire.samples import encode_block
from ema_record.wire.topics import COMMAND, SAMPLES, WEIGHT_ON_WHEELS
from ema_record.wire.trajectory import encode_command


def new_writer(path, **options):
    return BagWriter(
        path, profile=load_profile("step"),
        provenance=Provenance(serial_number="EMA-1", software_version="1", start_time=5),
        **options,
    )


def names_in(directory):
    return sorted(path.name for path in directory.iterdir())


def messages_in(file):
    with file.open("rb") as stream:
        reader = McapStream(stream, file.stat().st_size, str(file))
        try:
            for item in reader:
                if isinstance(item, McapMessage):
                    yield item.channel.topic, bytes(item.data), item.log_time, item.publish_time
        except IncompleteRecordError:
            pass


def test_messages_are_kept_as_they_came(tmp_path, record):
    """Bytes, order, log and publish times; the counters agree."""
    written = [
        (SAMPLES, encode_block(record.samples[k:k + 7]), 10**9 + 3 * k, 10**9 + 2 * k)
        for k in range(0, 700, 7)
    ]
    writer = new_writer(tmp_path / "bag")
    for topic, data, log_time, publish_time in written:
        writer.write_raw(topic, data, log_time, publish_time)
    assert writer.counts[SAMPLES] == 100 and writer.counts[COMMAND] == 0
    assert writer.close() == tmp_path / "bag"
    assert list(messages_in(tmp_path / "bag" / "bag_0.mcap")) == written
    np.testing.assert_array_equal(read_bag(tmp_path / "bag").samples, record.samples[:700])


def test_metadata_comes_last(tmp_path, record):
    writer = new_writer(tmp_path / "bag")
    writer.write_raw(SAMPLES, encode_block(record.samples[:9]), 1)
    assert names_in(tmp_path / "bag") == ["bag_0.mcap"]
    with pytest.raises(IncompleteRecordError, match=r"no metadata\.yaml"):
        read_bag(tmp_path / "bag")
    writer.close()
    assert names_in(tmp_path / "bag") == ["bag_0.mcap", "metadata.yaml"]


def test_flushed_messages_survive_kill_9(tmp_path, repository):
    """A process that dies by SIGKILL: what it flushed is in the file."""
    code = """
import os, signal, sys, numpy as np
from ema_record.profile import load_profile
from ema_record.record import Provenance
from ema_record.bag.writer import BagWriter
from ema_record.wire.samples import encode_block
w = BagWriter(sys.argv[1], profile=load_profile("step"), provenance=Provenance())
for k in range(30):
    w.write_raw("/ema/samples", encode_block(np.full((500, 10), float(k))), k)
    if k % 10 == 9 and k < 29:
        w.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""
    run = subprocess.run([sys.executable, "-c", code, str(tmp_path / "bag")], cwd=repository,
                         check=False)
    assert run.returncode == -signal.SIGKILL
    found = list(messages_in(tmp_path / "bag" / "bag_0.mcap"))
    assert [time for *_, time in found[:20]] == list(range(20))
    with pytest.raises(IncompleteRecordError):
        read_bag(tmp_path / "bag")


def test_chunk_sizes(tmp_path, record):
    data = encode_block(record.samples[:500])
    with new_writer(tmp_path / "bag", flush_interval=None) as writer:
        for k in range(80):
            writer.write_raw(SAMPLES, data, k)
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        records = list(StreamReader(stream, emit_chunks=True).records)
    sizes = [r.uncompressed_size for r in records if isinstance(r, Chunk)]
    assert len(sizes) > 2
    assert all(CHUNK_SIZE < s < CHUNK_SIZE + len(data) + 20_000 for s in sizes[:-1])


def test_without_close_the_bag_is_interrupted(tmp_path, record):
    with pytest.raises(KeyboardInterrupt), new_writer(tmp_path / "bag") as writer:
        writer.write_raw(SAMPLES, encode_block(record.samples[:9]), 1)
        raise KeyboardInterrupt
    found = read_bag(tmp_path / "bag")
    assert found.provenance.status == "interrupted" and len(found) == 9


def test_start_time_may_be_known_late(tmp_path, record):
    with new_writer(tmp_path / "bag") as writer:
        writer.write_raw(SAMPLES, encode_block(record.samples[:9]), 1)
        writer.close("aborted", start_time=77)
        writer.close("complete")
    found = read_bag(tmp_path / "bag").provenance
    assert (found.status, found.start_time) == ("aborted", 77)


def test_existing_output_is_not_touched(tmp_path, make):
    for name in ("directory", "file"):
        path = tmp_path / name
        if name == "file":
            path.write_text("mine")
        else:
            path.mkdir()
        for action in (new_writer, lambda p: write_bag(make(100), p)):
            with pytest.raises(OutputError, match="exists and is never overwritten"):
                action(path)
    assert (tmp_path / "file").read_text() == "mine"
    assert list((tmp_path / "directory").iterdir()) == []


def test_no_permission_to_write(tmp_path, make):
    record = make(100)
    write_bag(record, tmp_path / "warm up", views=False)
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o555)
    root = os.geteuid() == 0
    if root:  # permissions do not bind root: write as nobody
        os.seteuid(65534)
    try:
        with pytest.raises(OutputError, match=r"cannot be written \(Permission denied\)"):
            write_bag(record, closed / "bag", views=False)  # no kit to read
    finally:
        if root:
            os.seteuid(0)
    assert list(closed.iterdir()) == []


def test_a_name_that_metadata_cannot_hold_is_refused_and_a_folder_of_any_name_is_not(
        tmp_path, make):
    odd = tmp_path / os.fsdecode(b"a\xff")
    with pytest.raises(OutputError, match="the name is not UTF-8"):
        write_bag(make(100), odd)
    assert not odd.exists()
    with pytest.raises(OutputError, match="begins with a dot is hidden"):
        write_bag(make(100), tmp_path / ".bag")
    assert not (tmp_path / ".bag").exists()
    assert len(read_bag(write_bag(make(100), odd / "b \u6a5f"))) == 100


def test_times_that_do_not_increase_are_refused(tmp_path, make):
    record = make(100)
    with pytest.raises(UsageError, match="times do not increase"):
        write_bag(dataclasses.replace(record, samples=0.0 * record.samples), tmp_path / "bag")
    assert names_in(tmp_path) == []


def test_below_a_file(tmp_path, make):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written"):
        write_bag(make(100), tmp_path / "file" / "bag")


def test_disk_full(tmp_path, make):
    """The file may not grow: one clear error, no second error, and no part of a bag."""
    record = make(9000)
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, limit[1]))
    try:
        with pytest.raises(OutputError, match=os.strerror(errno.EFBIG)) as caught:
            write_bag(record, tmp_path / "bag")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert "\n" not in str(caught.value)
    assert not names_in(tmp_path)


@pytest.mark.parametrize("whole", [True, False])
def test_a_removed_directory_costs_no_sample(tmp_path, make, whole):
    """The file is put back under its name as long as it is open, and the record goes on."""
    record, bag = make(9000), tmp_path / "records" / "bag"
    with BagWriter(bag, profile=record.profile, provenance=record.provenance,
                   flush_interval=0.0) as writer:
        writer.write_raw(COMMAND, encode_command(record.profile, 1), 1)
        for first in range(0, 9000, 500):
            if first in (2000, 6000):
                shutil.rmtree(bag.parent if whole else bag)
            block = record.samples[first:first + 500]
            writer.write_raw(SAMPLES, encode_block(block), 1 + first)
        writer.close()
    assert np.array_equal(read_bag(bag).samples, record.samples)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (("/ema/verdict", b"\0\1\0\0", 1), "not in the bag"),
        ((WEIGHT_ON_WHEELS, b"", 1), "message of 0 bytes"),
        ((WEIGHT_ON_WHEELS, bytes(MAX_MESSAGE_BYTES + 1), 1), "message of 16777217 bytes"),
        ((WEIGHT_ON_WHEELS, b"\0\1\0\0\1", -1), "ns since the epoch"),
        ((WEIGHT_ON_WHEELS, b"\0\1\0\0\1", 1, 1 << 63), "ns since the epoch"),
    ],
)
def test_wrong_messages_are_refused(tmp_path, arguments, match):
    with new_writer(tmp_path / "bag") as writer:
        with pytest.raises(UsageError, match=match):
            writer.write_raw(*arguments)
        assert sum(writer.counts.values()) == 0


def test_closed_bags_take_nothing(tmp_path, record):
    writer = new_writer(tmp_path / "bag")
    with pytest.raises(UsageError, match="status 'fine'"):
        writer.close("fine")
    writer.close()
    with pytest.raises(UsageError, match="closed"):
        writer.write_raw(SAMPLES, encode_block(record.samples[:9]), 1)


def test_records_that_cannot_be_written_leave_nothing_behind(tmp_path, record):
    late = record.samples[:10].copy()
    late[:, 0] -= 1.0
    for samples, match in ((record.samples[:0], "no sample"), (late, "negative")):
        with pytest.raises(UsageError, match=match):
            write_bag(dataclasses.replace(record, samples=samples), tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_two_writers_in_two_threads(tmp_path, make):
    records = [make(9000, seed=k) for k in range(2)]
    threads = [
        threading.Thread(
            target=write_bag, args=(records[k], tmp_path / str(k)),
            kwargs={"views": False},
        )
        for k in range(2)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k in range(2):
        np.testing.assert_array_equal(read_bag(tmp_path / str(k)).samples, records[k].samples)


def test_a_record_that_cannot_be_written_leaves_no_part_of_its_bag(tmp_path, record):
    early = record.samples - np.eye(1, record.samples.shape[1]) * 0.01
    with pytest.raises(UsageError, match="since the epoch"):
        write_bag(dataclasses.replace(
            record, samples=early, provenance=Provenance()), tmp_path / "bag")
    assert not names_in(tmp_path)
    write_bag(record, tmp_path / "bag")
