"""Records from live topics: complete, in any order of topics, pre-empted, silent."""

import numpy as np
import pytest

from ema_prognostics.node.assembler import RecordAssembler
from ema_record.errors import IncompleteRecordError, InvalidRecordError
from ema_record.profile import load_profile
from ema_record.wire.samples import encode_block
from ema_record.wire.sensors import encode_dc_bus, encode_temperature
from ema_record.wire.topics import COMMAND, DC_BUS, SAMPLES, WINDING_TEMPERATURE
from ema_record.wire.trajectory import encode_command
from ema_sim.simulate import simulate

EPOCH = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def record():
    """Return a record of the step profile."""
    return simulate(load_profile("step"), seed=8)


def blocks_of(record, size=400):
    return [encode_block(record.samples[k:k + size]) for k in range(0, len(record), size)]


def feed(assembler, blocks, now=0.0):
    """Give blocks; return the first record that is finished, and how many blocks it took."""
    for index, block in enumerate(blocks):
        assembler.take(SAMPLES, block, now)
        found = assembler.finished(now)
        if found is not None:
            return found, index + 1
    return None, len(blocks)


def test_the_record_is_finished_with_its_last_sample(record):
    assembler = RecordAssembler()
    assembler.take(COMMAND, encode_command(record.profile, EPOCH), 0.0)
    assembler.take(DC_BUS, encode_dc_bus(
        np.array([EPOCH + 10**8]), np.array([96.0]), np.array([2.0]))[0], 0.0)
    assembler.take(WINDING_TEMPERATURE, encode_temperature(
        np.array([EPOCH + 2 * 10**8]), np.array([20.0]))[0], 0.0)
    blocks = blocks_of(record)
    found, count = feed(assembler, blocks)
    assert count == len(blocks)
    assert np.array_equal(found.samples, record.samples)
    assert found.profile == record.profile
    assert np.allclose(found.dc_bus, [[0.1, 96.0, 2.0]])
    assert np.allclose(found.winding_temperature, [[0.2, 20.0]])
    assert assembler.finished(100.0) is None, "the same record twice"


def test_a_message_that_comes_twice_counts_once(record):
    assembler = RecordAssembler()
    assembler.take(COMMAND, encode_command(record.profile, EPOCH), 0.0)
    blocks = blocks_of(record)
    feed(assembler, blocks[:6])
    with pytest.raises(InvalidRecordError, match="came twice and is left out: look for a second"):
        feed(assembler, blocks[5:6])
    found, _ = feed(assembler, blocks[6:])
    assert np.array_equal(found.samples, record.samples)


def test_a_command_that_arrives_after_the_first_samples(record):
    assembler = RecordAssembler()
    blocks = blocks_of(record)
    feed(assembler, blocks[:2])
    assembler.take(COMMAND, encode_command(record.profile, EPOCH), 0.0)
    found, _ = feed(assembler, blocks[2:])
    assert np.array_equal(found.samples, record.samples)


def test_a_stream_that_stops_gives_what_there_is_after_a_pause(record):
    assembler = RecordAssembler()
    assembler.take(COMMAND, encode_command(record.profile, EPOCH), 0.0)
    feed(assembler, blocks_of(record)[:5], now=1.0)
    assert assembler.finished(2.9) is None
    found = assembler.finished(3.1)
    assert len(found) == 2000


def test_a_new_run_begins_a_new_record(record):
    assembler = RecordAssembler()
    blocks = blocks_of(record)
    assembler.take(COMMAND, encode_command(record.profile, EPOCH), 0.0)
    feed(assembler, blocks[:3])
    assembler.take(COMMAND, encode_command(record.profile, EPOCH + 5), 0.0)
    found, count = feed(assembler, blocks)
    assert count == len(blocks)
    assert np.array_equal(found.samples, record.samples)
    assert found.provenance.start_time == EPOCH + 5


def test_samples_without_a_command_are_reported_and_forgotten(record):
    assembler = RecordAssembler()
    feed(assembler, blocks_of(record))
    with pytest.raises(IncompleteRecordError, match="without their command"):
        assembler.finished(10.0)
    assert assembler.finished(10.0) is None
    assembler.take(COMMAND, encode_command(record.profile, EPOCH), 11.0)
    assert assembler.finished(20.0) is None


def test_damaged_messages_are_errors_and_the_assembler_lives_on(record):
    assembler = RecordAssembler()
    with pytest.raises(InvalidRecordError):
        assembler.take(SAMPLES, b"\x00\x01\x00\x00rubbish", 0.0)
    assembler.take(COMMAND, b"\x00\x01\x00\x00rubbish", 0.0)
    blocks = blocks_of(record)
    with pytest.raises(InvalidRecordError):
        feed(assembler, blocks)
    assembler.take(COMMAND, encode_command(record.profile, EPOCH), 0.0)
    found, _ = feed(assembler, blocks)
    assert np.array_equal(found.samples, record.samples)


def test_samples_before_their_command_after_a_test_that_was_cut(record):
    assembler = RecordAssembler()
    assembler.take(COMMAND, encode_command(record.profile, EPOCH), 0.0)
    blocks = blocks_of(record)
    assert feed(assembler, blocks[:10]) == (None, 10)
    assert feed(assembler, blocks[:3], now=1.0) == (None, 3)
    assembler.take(COMMAND, encode_command(record.profile, EPOCH + 10**10), 1.0)
    found, _ = feed(assembler, blocks[3:], now=1.0)
    assert found is not None and len(found) == len(record)
