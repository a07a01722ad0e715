"""Bad input: every case is one clear line of the right kind, never a traceback."""

import dataclasses
import shutil
import struct
import tracemalloc
import zlib

import lz4.frame
import numpy as np
import pytest
import yaml
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import CompressionType

from ema_record.bag import container, mcap_stream, recover
from ema_record.bag.mcap_stream import MAGIC
from ema_record.bag.read import read_bag, write_bag
from ema_record.bag.writer import BagWriter
from ema_record.channels import CHANNEL_LABEL, MOTOR_SPEED, TIME
from ema_record.errors import IncompleteRecordError, InvalidRecordError, RecordError
from ema_record.limits import MAX_CHUNK_BYTES
from ema_record.profile import load_profile
from ema_record.record import Provenance
from ema_record.wire.samples import encode_block
from ema_record.wire.sensors import encode_bool
from ema_record.wire.topics import COMMAND, SAMPLES, WEIGHT_ON_WHEELS
from ema_record.wire.trajectory import encode_command
from support.recording import write_mcap


@pytest.fixture
def copy(bag, tmp_path):
    return shutil.copytree(bag, tmp_path / "copy")


@pytest.fixture(scope="module")
def small(tmp_path_factory, record):
    """The bytes of a whole .mcap file of 60 samples."""
    short = dataclasses.replace(record, samples=record.samples[:60], dc_bus=record.dc_bus[:2],
                                winding_temperature=record.winding_temperature[:2])
    bag = write_bag(short, tmp_path_factory.mktemp("small") / "small")
    return (bag / "small_0.mcap").read_bytes()


def fails(path, kind, match):
    with pytest.raises(kind, match=match) as caught:
        read_bag(path)
    text = str(caught.value)
    assert "\n" not in text and len(text) < 500
    assert str(path) in text


def mcap_of(path, messages, **options):
    """Write an .mcap file with the given (topic, CDR) pairs."""
    timed = [(topic, time, data) for time, (topic, data) in enumerate(messages)]
    return write_mcap(path, timed, compression=CompressionType.NONE, **options)


COMMANDED = (COMMAND, encode_command(load_profile("step")))


def test_missing_path(tmp_path):
    fails(tmp_path / "nothing", InvalidRecordError, "no such file or directory")


def test_directory_that_is_no_bag(tmp_path):
    fails(tmp_path, InvalidRecordError, "a directory that is no bag")


def test_special_file():
    fails("/dev/null", InvalidRecordError, "neither a file nor a directory")


def test_name_that_no_file_can_have():
    fails("x" * 300, InvalidRecordError, "cannot be read")


def test_empty_mcap(tmp_path):
    (tmp_path / "a.mcap").touch()
    fails(tmp_path / "a.mcap", InvalidRecordError, r"empty file \(0 bytes\)")


def test_mcap_without_a_message(tmp_path):
    fails(mcap_of(tmp_path / "a.mcap", []), InvalidRecordError, "no topic /ema/samples.*none")


def test_bag_with_an_empty_mcap(copy):
    (copy / "healthy_0.mcap").write_bytes(b"")
    fails(copy, InvalidRecordError, "empty file")


def test_file_of_another_kind(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"SQLite format 3\x00" + bytes(100))
    fails(path, InvalidRecordError, "not an MCAP file")


def test_bag_without_metadata_is_incomplete(copy):
    (copy / "metadata.yaml").unlink()
    fails(copy, IncompleteRecordError, "no metadata.yaml.*the recording was cut")


@pytest.mark.parametrize("part", [0.3, 0.5, 0.9, 0.999])
def test_mcap_cut_in_the_middle_is_incomplete(copy, part):
    """With and without metadata.yaml, as a bag and as a file."""
    file = copy / "healthy_0.mcap"
    data = file.read_bytes()
    file.write_bytes(data[: int(part * len(data))])
    fails(copy, IncompleteRecordError, "was cut at byte")
    fails(file, IncompleteRecordError, "was cut at byte")
    (copy / "metadata.yaml").unlink()
    fails(copy, IncompleteRecordError, "was cut")


def test_cuts_anywhere_in_a_small_file_are_found(small, tmp_path):
    path = tmp_path / "a.mcap"
    for length in [*range(8, len(small), 17), *range(len(small) - 300, len(small))]:
        path.write_bytes(small[:length])
        with pytest.raises(IncompleteRecordError):
            read_bag(path)


@settings(max_examples=400, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_bytes_are_found_or_harmless(small, tmp_path, data, record):
    """Any overwritten bytes: an error of one line, or exactly the record that was written."""
    at = data.draw(st.integers(0, len(small) - 1))
    damage = data.draw(st.binary(min_size=1, max_size=9))
    path = tmp_path / "a.mcap"
    path.write_bytes((small[:at] + damage + small[at + len(damage):])[: len(small)])
    try:
        found = read_bag(path)
    except RecordError as error:
        assert "\n" not in str(error)
    else:
        np.testing.assert_array_equal(found.samples, record.samples[:60])
        assert found.profile == record.profile


@settings(max_examples=200, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(noise=st.binary(max_size=300))
def test_noise_after_the_magic_is_refused(tmp_path, noise):
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + noise)
    with pytest.raises(RecordError) as caught:
        read_bag(path)
    assert "\n" not in str(caught.value)


def test_wrong_checksum(copy):
    """One bit of one sample, stored uncompressed: only the checksum can tell."""
    file = copy / "healthy_0.mcap"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    fails(copy, InvalidRecordError, "damaged")


def test_checksum_of_an_uncompressed_chunk(tmp_path, record):
    block = encode_block(record.samples[:500])
    path = mcap_of(tmp_path / "a.mcap", [COMMANDED, (SAMPLES, block)])
    data = bytearray(path.read_bytes())
    data[data.index(block) + 1000] ^= 1
    path.write_bytes(data)
    fails(path, InvalidRecordError, "checksum of a chunk")


def test_bag_without_samples(tmp_path):
    path = mcap_of(tmp_path / "a.mcap", [COMMANDED])
    fails(path, InvalidRecordError, r"no topic /ema/samples \(its topics: /ema/command\)")


def test_bag_whose_samples_were_never_published(tmp_path):
    for status, kind, match in (
        ("aborted", IncompleteRecordError, "the test was aborted before a sample"),
        ("complete", InvalidRecordError, "no message on /ema/samples"),
    ):
        with BagWriter(tmp_path / status, profile=load_profile("step"),
                       provenance=Provenance()) as writer:
            writer.write_raw(WEIGHT_ON_WHEELS, encode_bool(True), 1)
            writer.close(status)
        fails(tmp_path / status, kind, match)


def test_samples_of_another_type(tmp_path):
    path = mcap_of(tmp_path / "a.mcap", [(SAMPLES, b"\0\1\0\0\1")],
                   types={SAMPLES: "std_msgs/msg/Bool"})
    fails(path, InvalidRecordError, "is 'std_msgs/msg/Bool' in 'cdr', expected")


def test_samples_of_another_encoding(tmp_path, record):
    path = mcap_of(tmp_path / "a.mcap", [(SAMPLES, encode_block(record.samples[:9]))],
                   encoding="json")
    fails(path, InvalidRecordError, "in 'json'")


def test_wrong_channel_list(tmp_path, record):
    block = encode_block(record.samples[:500])
    label = CHANNEL_LABEL.encode()
    wrong = block.replace(label, label.replace(b"motor_speed[rad/s]", b"motor_speed[rpm/1]"))
    path = mcap_of(tmp_path / "a.mcap", [COMMANDED, (SAMPLES, wrong)])
    fails(path, InvalidRecordError, r"channel 1 is 'motor_speed\[rpm/1\]', expected")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_value_that_is_not_finite(tmp_path, record, value):
    samples = record.samples[:700].copy()
    samples[601, MOTOR_SPEED] = value
    bag = write_bag(dataclasses.replace(record, samples=samples), tmp_path / "bag")
    fails(bag, InvalidRecordError, f"sample 601, motor_speed is {value}")
    assert len(read_bag(bag, validate_values=False)) == 700


@pytest.mark.parametrize("step", [0.0, -1e-3])
def test_time_running_backwards(tmp_path, record, step):
    samples = record.samples[:700].copy()
    samples[300:, TIME] += samples[299, TIME] - samples[300, TIME] + step
    path = mcap_of(tmp_path / "a.mcap", [COMMANDED, (SAMPLES, encode_block(samples))])
    fails(path, InvalidRecordError, "time does not increase at sample 300")


def test_record_too_long(tmp_path, record):
    samples = record.samples[:2].copy()
    samples[1, TIME] = 61.5
    path = mcap_of(tmp_path / "a.mcap", [COMMANDED, (SAMPLES, encode_block(samples))])
    fails(path, InvalidRecordError, "61.5 s long, at most 60 s")


def test_rate_too_high(tmp_path, record):
    samples = record.samples[:2].copy()
    samples[1, TIME] = samples[0, TIME] + 1e-7
    path = mcap_of(tmp_path / "a.mcap", [COMMANDED, (SAMPLES, encode_block(samples))])
    fails(path, InvalidRecordError, "interval of 1e-07 s")


def test_no_profile_anywhere(tmp_path, record):
    path = mcap_of(tmp_path / "a.mcap", [(SAMPLES, encode_block(record.samples[:500]))])
    fails(path, InvalidRecordError, "neither test metadata nor a message on /ema/command")


# metadata.yaml --------------------------------------------------------------------------


def edit(bag, change):
    place = bag / "metadata.yaml"
    data = yaml.safe_load(place.read_text())
    change(data["rosbag2_bagfile_information"])
    place.write_text(yaml.safe_dump(data))


def test_file_of_the_bag_is_missing(copy):
    (copy / "healthy_0.mcap").unlink()
    with pytest.raises(InvalidRecordError, match=r"healthy_0.mcap: named by metadata.yaml and m"):
        read_bag(copy)


def test_files_outside_the_bag_are_not_opened(copy, tmp_path, bag):
    shutil.copy(bag / "healthy_0.mcap", tmp_path / "secret.mcap")
    edit(copy, lambda i: i.update(relative_file_paths=["../secret.mcap"]))
    with pytest.raises(InvalidRecordError, match="missing"):
        read_bag(copy)


def test_a_command_that_is_not_the_profile_of_the_metadata(tmp_path, make):
    record = make(700)
    other = encode_command(load_profile("extended"), 5)
    with BagWriter(tmp_path / "bag", profile=record.profile, provenance=record.provenance,
                   flush_interval=None) as writer:
        writer.write_raw(COMMAND, other, 5)
        writer.write_raw(SAMPLES, encode_block(record.samples), 6)
        writer.close()
    fails(tmp_path / "bag", InvalidRecordError,
          "the metadata say that the test was 'step', /ema/command is another profile")


def test_other_storage(copy):
    edit(copy, lambda i: i.update(storage_identifier="sqlite3"))
    fails(copy, InvalidRecordError, "storage 'sqlite3', expected 'mcap': convert it")


def test_other_compression(copy):
    edit(copy, lambda i: i.update(compression_mode="file", compression_format="fake"))
    fails(copy, InvalidRecordError, "compression 'fake' by file")


@pytest.mark.parametrize("text", ["", "[", "- 1", "rosbag2_bagfile_information: 3", "\x00",
                                  "rosbag2_bagfile_information: {relative_file_paths: []}",
                                  "a: &a [1]\nb: [*a, *a]", "x" * (2 << 20)])
def test_damaged_metadata(copy, text):
    (copy / "metadata.yaml").write_text(text)
    with pytest.raises(InvalidRecordError) as caught:
        read_bag(copy)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "values", "match"),
    [
        ("ema_phm.end", {"status": "fine"}, "status in its metadata is 'fine'"),
        ("ema_phm.end", {"status": "complete", "start_time": "-1"}, "start_time .* is '-1'"),
        ("ema_phm.start", {"profile": "{"}, "profile in its metadata"),
        ("ema_phm.start", {"profile": '{"name": "x", "points": []}'}, "test profile: points"),
        ("ema_phm.start", {"profile": "[" * 100_000}, "profile in its metadata"),
    ],
)
def test_damaged_own_metadata(tmp_path, record, name, values, match):
    path = tmp_path / "a.mcap"
    write_mcap(path, [(SAMPLES, 0, encode_block(record.samples[:9]))], metadata={name: values})
    fails(path, InvalidRecordError, match)


# Files made to exhaust the memory -------------------------------------------------------


def text(value):
    return struct.pack("<I", len(value)) + value


def mcap_with(*records):
    """Return a file of raw (opcode, body) records."""
    body = b"".join(struct.pack("<BQ", opcode, len(data)) + data for opcode, data in records)
    return MAGIC + body + MAGIC


def chunk(data, size, method=b"zstd", crc=0):
    head = struct.pack("<QQQI", 0, 0, size, crc) + text(method)
    return Opcode.CHUNK, head + struct.pack("<Q", len(data)) + data


ZEROS = bytes(MAX_CHUNK_BYTES)
BOMBS = {
    "announced too large": chunk(zstandard.compress(ZEROS), 1 << 40),
    "larger than announced, zstd": chunk(zstandard.compress(ZEROS), 1000),
    "larger than announced, zstd stream": chunk(
        zstandard.ZstdCompressor(write_content_size=False).compress(ZEROS), 1000),
    "larger than announced, lz4": chunk(lz4.frame.compress(ZEROS), 1000, b"lz4"),
    "unknown method": chunk(b"abc", 3, b"xz"),
    "smaller than announced": chunk(zstandard.compress(b"abc"), 1 << 20),
    "wrong checksum": chunk(zstandard.compress(b"abc"), 3, crc=zlib.crc32(b"abd")),
    "huge record": (Opcode.METADATA, bytes(2 << 20)),
    "text beyond its record": (Opcode.HEADER, b""),
    "text beyond its metadata": (Opcode.METADATA, struct.pack("<I", 0xFFFFFFFF)),
    "message of no channel": (Opcode.MESSAGE, bytes(30)),
    "record beyond its chunk": chunk(struct.pack("<BQ", Opcode.MESSAGE, 1 << 60), 9, b""),
    "record longer than the file": (Opcode.CHUNK, b""),
}


@pytest.mark.parametrize("name", BOMBS)
def test_bombs(tmp_path, name):
    path = tmp_path / "a.mcap"
    data = mcap_with(BOMBS[name])
    if name == "record longer than the file":
        data = MAGIC + struct.pack("<BQ", Opcode.CHUNK, 1 << 62) + bytes(20) + MAGIC
    path.write_bytes(data)
    tracemalloc.start()
    try:
        with pytest.raises(RecordError) as caught:
            read_bag(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 8 << 20
    assert "\n" not in str(caught.value)


def test_whole_file_bomb(tmp_path, bag):
    """A compressed file is unpacked with a bound as well."""
    from ema_record.bag.compression import unpack_zstd_stream

    with pytest.raises(InvalidRecordError, match="more than 1000 bytes"):
        unpack_zstd_stream(zstandard.compress(ZEROS), 1000, "a.mcap.zstd")
    path = tmp_path / "a.mcap.zstd"
    path.write_bytes(zstandard.compress((bag / "healthy_0.mcap").read_bytes()))
    assert len(read_bag(path)) == 9000
    path.write_bytes(b"no zstd at all")
    fails(path, InvalidRecordError, "zstd data are damaged")


def test_messages_that_are_compressed_one_by_one_are_bounded_together(tmp_path, monkeypatch):
    """Each is small: a file of some kilobytes could fill the memory with them."""
    folder = tmp_path / "bag"
    folder.mkdir()
    block = encode_block(np.zeros((2000, 10)))
    mcap_of(folder / "bag_0.mcap", [
        (topic, zstandard.compress(data)) for topic, data in (COMMANDED, *[(SAMPLES, block)] * 9)])
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": {
        "version": 9, "storage_identifier": "mcap", "relative_file_paths": ["bag_0.mcap"],
        "compression_mode": "MESSAGE", "compression_format": "zstd", "message_count": 10}}))
    assert (folder / "bag_0.mcap").stat().st_size < len(block)
    with pytest.raises(RecordError) as caught:
        read_bag(folder)  # nothing wrong but the times of the samples
    assert "unpacks" not in str(caught.value)
    monkeypatch.setattr(container, "MAX_TOTAL_BYTES", 5 * len(block))
    with pytest.raises(InvalidRecordError, match=r"unpacks to more than .* split"):
        read_bag(folder)
    monkeypatch.setattr(recover, "MAX_TOTAL_BYTES", 5 * len(block))
    (folder / "metadata.yaml").unlink()
    found = recover.Salvage(room=5 * len(block))
    recover._salvage_file(folder / "bag_0.mcap", found)
    assert sum(len(m.data) for m in found.messages) <= 5 * len(block)
    assert not found.whole


def test_so_many_records_take_no_hours(bag, monkeypatch):
    """An empty record takes nine bytes that compress to nothing, and some time."""
    monkeypatch.setattr(mcap_stream, "MOST_RECORDS", 20)
    fails(next(bag.glob("*.mcap")), InvalidRecordError, "more than 20 records")


@pytest.mark.parametrize(("change", "why"), [
    (1, "a file of the bag is missing in its list"), (-1, "that of another bag")])
def test_metadata_that_counts_otherwise(copy, change, why):
    place = copy / "metadata.yaml"
    data = yaml.safe_load(place.read_text())
    for row in data["rosbag2_bagfile_information"]["topics_with_message_count"]:
        if row["topic_metadata"]["name"] == SAMPLES:
            row["message_count"] += change
    place.write_text(yaml.safe_dump(data))
    fails(copy, InvalidRecordError, why)
