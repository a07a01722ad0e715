"""`ema recover`: a recorder killed with SIGKILL, cuts anywhere, damage in the middle."""

import dataclasses
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter

from ema_cli.main import run
from ema_record.bag.read import read_bag, write_bag
from ema_record.bag.recover import recover_bag
from ema_record.bag.writer import BagWriter
from ema_record.errors import IncompleteRecordError, OutputError, RecordError, UsageError
from ema_record.profile import load_profile
from ema_record.wire.samples import encode_block
from ema_record.wire.topics import COMMAND, SAMPLES
from ema_record.wire.trajectory import encode_command
from ema_sim.simulate import simulate
from support.simulations import record_of

RECORDER = """
import sys, time
from ema_record.bag.read import read_bag
from ema_record.bag.writer import BagWriter
from ema_record.wire.samples import encode_block
from ema_record.wire.topics import SAMPLES
record = read_bag(sys.argv[1])
writer = BagWriter(sys.argv[2], profile=record.profile, provenance=record.provenance)
begin = time.monotonic()
for first in range(0, len(record), 200):
    block = record.samples[first:first + 200]
    time.sleep(max(0.0, begin + block[-1, 0] - time.monotonic()))
    print(first + len(block), flush=True)
    writer.write_raw(SAMPLES, encode_block(block), int(block[-1, 0] * 1e9))
time.sleep(60)
"""


@pytest.fixture(scope="module")
def record():
    return simulate(load_profile("step"), seed=3)


@pytest.fixture(scope="module")
def good(record, tmp_path_factory):
    with pytest.MonkeyPatch.context() as small:
        small.setattr("ema_record.bag.writer.CHUNK_SIZE", 256 << 10)
        return write_bag(record, tmp_path_factory.mktemp("good") / "good")


def content(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def cut(good, folder, size):
    folder.mkdir()
    (folder / "cut_0.mcap").write_bytes((good / "good_0.mcap").read_bytes()[:size])
    return folder


def test_killed_recorder_loses_less_than_100_ms(good, record, tmp_path):
    bag = tmp_path / "killed"
    child = subprocess.Popen(
        [sys.executable, "-c", RECORDER, str(good), str(bag)], stdout=subprocess.PIPE
    )
    given = 0
    while given < 6000:
        given = int(child.stdout.readline())
    os.kill(child.pid, signal.SIGKILL)
    rest = child.stdout.read().split()
    child.wait()
    child.stdout.close()
    given = int(rest[-1]) if rest else given
    with pytest.raises(IncompleteRecordError, match="cut"):
        read_bag(bag)
    before = content(bag)
    report = recover_bag(bag)
    assert content(bag) == before
    back = read_bag(report.bag)
    assert back.provenance.status == "interrupted" and len(back) == report.samples
    assert np.array_equal(back.samples, record.samples[: len(back)])
    assert given - len(back) <= 0.1 * record.rate
    assert report.missing_samples == len(record) - len(back)


def test_a_full_disk_loses_less_than_100_ms(record, tmp_path):
    """The file may not grow any more: what was handed over before that is recovered."""
    bag, given = tmp_path / "full", 0
    writer = BagWriter(bag, profile=record.profile, provenance=record.provenance)
    writer.write_raw(COMMAND, encode_command(record.profile, 1), 1)
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, limit[1]))
    try:
        with pytest.raises(OutputError, match="free space"):
            for first in range(0, len(record), 200):
                block = record.samples[first:first + 200]
                given += len(block)
                writer.write_raw(SAMPLES, encode_block(block), 1 + int(block[-1, 0] * 1e9))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert 2000 < given < len(record)
    with pytest.raises(IncompleteRecordError, match="cut"):
        read_bag(bag)
    report = recover_bag(bag)
    assert report.status == "interrupted"
    assert given - report.samples <= 0.1 * record.rate
    assert np.array_equal(read_bag(report.bag).samples, record.samples[:report.samples])


@pytest.mark.parametrize("part", [0.2, 0.5, 0.77, 0.95, 0.9999])
def test_cut_bags_give_the_samples_before_the_cut(good, record, tmp_path, part):
    size = (good / "good_0.mcap").stat().st_size
    bag = cut(good, tmp_path / "cut", int(part * size))
    report = recover_bag(bag)
    assert report.status == "interrupted"
    assert report.samples + report.missing_samples == len(record)
    assert report.samples >= (part - 0.2) * len(record)  # zstd works in blocks of 128 KiB
    back = read_bag(report.bag)
    assert back.provenance.status == "interrupted"
    assert back.provenance.serial_number == record.provenance.serial_number
    assert back.profile == record.profile
    assert np.array_equal(back.samples, record.samples[: len(back)])


def test_damaged_chunk_is_left_out_and_told(good, record, tmp_path):
    bag = shutil.copytree(good, tmp_path / "damaged")
    file = bag / "good_0.mcap"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0x10
    file.write_bytes(data)
    report = recover_bag(bag)
    (gap,) = report.gaps
    assert gap.samples == report.missing_samples > 0
    assert any("left out" in damage for damage in report.damages)
    back = read_bag(report.bag)
    assert back.provenance.status == "interrupted"
    kept = np.isin(record.time, back.time)
    assert np.array_equal(back.samples, record.samples[kept])


def test_damaged_start_record_gives_way_to_the_command(good, record, tmp_path):
    """In a cut file no checksum of the file covers it; its own does."""
    bag = cut(good, tmp_path / "cut", 300_000)
    file = bag / "cut_0.mcap"
    data = file.read_bytes()
    assert data.count(b"[0.022,0.4]") == 1
    file.write_bytes(data.replace(b"[0.022,0.4]", b"[0.022,0.5]"))
    report = recover_bag(bag)
    assert any("ema_phm.start" in damage for damage in report.damages)
    assert read_bag(report.bag).profile == record.profile


def test_only_the_metadata_file_is_missing(good, record, tmp_path):
    bag = shutil.copytree(good, tmp_path / "bag")
    (bag / "metadata.yaml").unlink()
    report = recover_bag(bag)
    assert (report.missing_samples, report.status) == (0, "interrupted")
    back = read_bag(report.bag)
    assert np.array_equal(back.samples, record.samples)
    assert back.provenance.status == "interrupted"


def test_a_link_to_itself_is_one_line(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(RecordError, match="no such file"):
        recover_bag(tmp_path / "loop")


def test_whole_bags_existing_output_and_rubbish_are_refused(good, tmp_path):
    (one,) = good.glob("*.mcap")
    with pytest.raises(UsageError, match="whole"):
        recover_bag(one, tmp_path / "one")
    with pytest.raises(UsageError, match="whole"):
        recover_bag(good, tmp_path / "out")
    bag = cut(good, tmp_path / "cut", 200_000)
    with pytest.raises(OutputError, match="never overwritten"):
        recover_bag(bag, good)
    with pytest.raises(OutputError, match="would lie inside"):  # the original is only read
        recover_bag(bag, bag / "out")
    with pytest.raises(OutputError, match="would lie inside"):
        recover_bag(bag, good / "out")
    for size in (0, 5, 20):
        with pytest.raises(RecordError):
            recover_bag(cut(good, tmp_path / f"cut{size}", size))
    (tmp_path / "rubbish.mcap").write_bytes(b"no bag at all")
    with pytest.raises(RecordError, match="not an MCAP file"):
        recover_bag(tmp_path / "rubbish.mcap")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["\t- x:", "rosbag2_bagfile_information: 3\n", "\0"])
def test_a_bag_whose_metadata_file_is_damaged_is_recovered(good, tmp_path, text):
    bag = cut(good, tmp_path / "bag", None)
    (bag / "metadata.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(RecordError, match=r"metadata\.yaml"):
        read_bag(bag)
    report = recover_bag(bag)
    assert report.missing_samples == 0 and "metadata.yaml" in report.damages[0]
    assert np.array_equal(read_bag(report.bag).samples, read_bag(good).samples)


@pytest.mark.parametrize(("name", "what"), [("empty", "a directory that is no bag"),
                                            ("bag", "named by metadata.yaml and missing"),
                                            ("nowhere", "no such file or directory")])
def test_where_there_is_no_recording_that_is_said(good, tmp_path, name, what):
    (tmp_path / "empty").mkdir()
    (tmp_path / "bag").mkdir()
    shutil.copy(good / "metadata.yaml", tmp_path / "bag")
    with pytest.raises(RecordError, match=what):
        recover_bag(tmp_path / name)
    assert {p.name for p in tmp_path.iterdir()} == {"empty", "bag"}


def test_an_empty_file_is_named_with_its_folder(tmp_path):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "a_0.mcap").touch()
    with pytest.raises(RecordError, match=re.escape(f"{tmp_path / 'bag' / 'a_0.mcap'}: empty")):
        recover_bag(tmp_path / "bag")


def test_command(good, tmp_path, capsys):
    bag = cut(good, tmp_path / "cut", 250_000)
    assert run(["recover", str(bag), "--out", str(tmp_path / "new"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["status"] == "interrupted" and report["missing_ms"] > 0
    assert len(read_bag(tmp_path / "new")) == report["samples"]
    assert run(["recover", str(bag), "--out", str(tmp_path / "new")]) == 2
    assert "never overwritten" in capsys.readouterr().err


def test_several_bags_have_a_line_each_and_the_worst_status(good, tmp_path, capsys):
    (tmp_path / "two").mkdir()
    bags = [cut(good, tmp_path / "two" / name, size)
            for name, size in (("first", 250_000), ("last", 200_000), ("short", 4000))]
    out = tmp_path / "new"
    assert run(["recover", str(tmp_path / "two"), "--out", str(out)]) == 3
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and str(bags[2]) in printed.err
    for bag, line in zip(bags, printed.out.splitlines(), strict=False):
        samples = len(read_bag(out / bag.name))
        assert line.startswith(f"{bag}: {samples} of ") and line.endswith(str(out / bag.name))
    assert sorted(p.name for p in out.iterdir()) == ["first", "last"]
    assert run(["recover", *map(str, bags[:2]), "--out", str(out)]) == 2
    assert "never overwritten" in capsys.readouterr().err
    assert run(["recover", *map(str, bags), str(tmp_path / "no"), "--json"]) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 2
    assert [json.loads(line)["source"] for line in printed.out.splitlines()] == [
        str(bag) for bag in bags[:2]]


def test_a_bag_without_a_sample_left_is_status_3_in_one_line(good, tmp_path, capsys):
    """The start record stands before the first chunk, which the cut takes away."""
    bag = cut(good, tmp_path / "cut", 4000)
    assert run(["recover", str(bag), "--out", str(tmp_path / "new"), "--json"]) == 3
    captured = capsys.readouterr()
    assert (captured.out, captured.err.count("\n")) == ("", 1)
    assert "no sample can be read" in captured.err
    assert not (tmp_path / "new").exists()


def test_a_link_out_of_the_bag_is_not_followed(good, tmp_path):
    """Neither by a name of the bag's own nor beside a whole file, as reading refuses it."""
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "bag_0.mcap").symlink_to(good / "good_0.mcap")
    with pytest.raises(RecordError, match="a link out of the bag"):
        recover_bag(bag, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_cut_bag_of_a_recorder_with_few_channels(tmp_path):
    record = record_of("step", seed=3)
    record.samples[:, 4:10] = np.nan
    named = dataclasses.replace(
        record, provenance=dataclasses.replace(record.provenance, actuator="0123456789abcdef"))
    bag = write_bag(named, tmp_path / "bag", views=False)
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-40_000])
    (bag / "metadata.yaml").unlink()
    report = recover_bag(bag, tmp_path / "again")
    found = read_bag(tmp_path / "again")
    assert 0 < report.samples < len(record) and found.columns == (0, 1, 2, 3)
    np.testing.assert_array_equal(found.samples, record.samples[:report.samples])
    assert found.provenance.actuator == "0123456789abcdef"


def test_a_foreign_channel_without_schema_is_left_out(good, tmp_path):
    folder = tmp_path / "cut"
    folder.mkdir()
    with (folder / "cut_0.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        channels = {}
        (source,) = good.glob("*.mcap")
        with source.open("rb") as of:
            for schema, channel, message in make_reader(of).iter_messages():
                if channel.topic not in channels:
                    schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.topic] = writer.register_channel(
                        channel.topic, channel.message_encoding, schema_id, channel.metadata)
                writer.add_message(channels[channel.topic], message.log_time, message.data,
                                   message.publish_time)
            of.seek(0)
            for metadata in make_reader(of).iter_metadata():
                writer.add_metadata(metadata.name, metadata.metadata)
        foo = writer.register_channel("/foo", "cdr", 0)
        writer.add_message(foo, 10**9, b"x", 10**9)
        writer.finish()
    whole = (folder / "cut_0.mcap").read_bytes()
    (folder / "cut_0.mcap").write_bytes(whole[:-200])
    recover_bag(folder, tmp_path / "out")
    assert len(read_bag(tmp_path / "out")) > 0


def test_samples_of_another_actuator_are_left_out(good, tmp_path):
    """Two were recorded into one file: the record is of the one that comes first."""
    folder = tmp_path / "cut"
    folder.mkdir()
    (source,) = good.glob("*.mcap")
    with (folder / "cut_0.mcap").open("wb") as stream, source.open("rb") as of:
        writer = McapWriter(stream)
        writer.start()
        channels = {}
        for schema, channel, message in make_reader(of).iter_messages(topics=[COMMAND, SAMPLES]):
            for name in ("/left", "/right"):
                topic = name + channel.topic
                if topic not in channels:
                    channels[topic] = writer.register_channel(
                        topic, channel.message_encoding,
                        writer.register_schema(schema.name, schema.encoding, schema.data))
                writer.add_message(channels[topic], message.log_time, message.data,
                                   message.publish_time)
        writer.finish()
    report = recover_bag(folder, tmp_path / "out")
    back = read_bag(tmp_path / "out")
    assert np.array_equal(back.samples, read_bag(good).samples)
    assert back.provenance.namespace == "/left"
    assert set(report.left_out) == {f"/right{COMMAND}", f"/right{SAMPLES}"}


def test_the_test_is_the_one_commanded_before_the_first_sample(record, tmp_path):
    """Neither what the recorder was told nor what is commanded later, to bring it back."""
    bag, block, begin = tmp_path / "cut", record.samples[:2000], 10**18
    other = load_profile("extended")
    known = dataclasses.replace(record.provenance, start_time=begin)
    writer = BagWriter(bag, profile=other, provenance=known)
    writer.write_raw(COMMAND, encode_command(record.profile, begin), begin + 5)
    writer.write_raw(SAMPLES, encode_block(block), begin + 10**8)
    writer.write_raw(COMMAND, encode_command(other, begin), begin + 2 * 10**8)
    writer.flush()
    back = read_bag(recover_bag(bag).bag)
    writer.close("aborted")
    assert (back.profile, len(back)) == (record.profile, len(block))
    assert back.provenance.start_time == begin, "of its acceptance, not when the command came"


def test_files_of_several_tests_are_no_record(good, tmp_path):
    """Whole records under the name of their folder were joined, and nothing was missing."""
    (tmp_path / "SN-1").mkdir()
    (file,) = good.glob("*.mcap")
    for k in (17, 18):
        shutil.copy(file, tmp_path / "SN-1" / f"SN-1_{k}.mcap")
    with pytest.raises(RecordError, match="several tests, time begins anew"):
        recover_bag(tmp_path / "SN-1", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("rest", [b"", b"\0" * 4096, b"no MCAP at all"])
def test_a_part_that_holds_nothing_hides_no_other(good, tmp_path, rest):
    """Power that is lost as a recorder begins the next file leaves one of 0 bytes."""
    cut = tmp_path / "cut"
    cut.mkdir()
    (file,) = good.glob("*.mcap")
    data = file.read_bytes()
    (cut / "cut_0.mcap").write_bytes(data[:len(data) * 2 // 3])
    (cut / "cut_1.mcap").write_bytes(rest)
    report = recover_bag(cut, tmp_path / "out")
    assert report.samples > 1000
    assert any("cut_1.mcap" in text for text in report.damages)
