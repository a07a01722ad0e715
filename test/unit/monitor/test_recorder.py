"""The recorder: names that are never taken twice, counts, and bags that read back."""

from pathlib import Path

import numpy as np
import pytest

from ema_monitor.recorder import BitRecorder, LogClock, new_bag_path
from ema_record.bag.read import read_bag
from ema_record.channels import SURFACE_POSITION
from ema_record.errors import InvalidRecordError
from ema_record.profile import load_profile
from ema_record.wire.samples import encode_block
from ema_record.wire.topics import DIAGNOSTICS, SAMPLES
from ema_sim.simulate import simulate

STAMP = 1_700_000_000_000_000_000


def test_names_tell_serial_time_and_profile_and_are_unique(tmp_path):
    first = new_bag_path(tmp_path, "EMA 1/7", STAMP, "step")
    assert first.name == "EMA-1-7_20231114T221320Z_step"
    first.mkdir()
    for number in (2, 3):
        other = new_bag_path(tmp_path, "EMA 1/7", STAMP, "step")
        assert other.name == f"{first.name}_{number}"
        other.mkdir()
    assert new_bag_path(tmp_path, "../..", STAMP, "step").parent == tmp_path


def test_a_home_folder_is_found(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert new_bag_path(Path("~/records"), "A", STAMP, "step").parent == tmp_path / "records"
    assert new_bag_path(Path("~nobody-here/x"), "A", STAMP, "step").parent.name == "x"


def test_counts_always_and_keeps_only_what_belongs_to_the_bag(tmp_path):
    record = simulate(load_profile("step"), seed=1)
    recorder = BitRecorder()
    recorder.take(SAMPLES, encode_block(record.samples[:400]), STAMP, STAMP)
    assert (recorder.samples_received, recorder.samples_recorded) == (400, 0)
    recorder.reset_count()
    recorder.open(tmp_path / "bag", record.profile, "EMA-1", STAMP)
    recorder.take(DIAGNOSTICS, b"ignored", STAMP, STAMP)
    for first in range(0, len(record), 400):
        block = record.samples[first:first + 400]
        time = STAMP + round(block[-1, 0] * 1e9)
        recorder.take(SAMPLES, encode_block(block), time, time)
    assert recorder.samples_received == recorder.samples_recorded == len(record)
    assert recorder.last_sample == record.samples[-1, 0]
    assert np.array_equal(recorder.record(record.profile).samples, record.samples)
    path = recorder.close("aborted", STAMP + 5)
    found = read_bag(path)
    assert np.array_equal(found.samples, record.samples)
    assert found.provenance.status == "aborted"
    assert found.provenance.start_time == STAMP + 5
    assert recorder.close("complete", None) is None
    recorder.open(tmp_path / "next", record.profile, "EMA-1", STAMP)
    recorder.take(SAMPLES, encode_block(record.samples[:400]), STAMP, STAMP)
    recorder.close("aborted", None)
    assert len(recorder.record(record.profile)) == recorder.samples_recorded == 400


def test_a_position_that_is_no_number_is_none():
    """The surface would be commanded to stay there."""
    record = simulate(load_profile("step"), seed=1)
    recorder, block = BitRecorder(), record.samples[:400].copy()
    recorder.take(SAMPLES, encode_block(block), STAMP, STAMP)
    assert recorder.last_position == block[-1, SURFACE_POSITION]
    block[:, SURFACE_POSITION] = np.nan
    recorder.take(SAMPLES, encode_block(block), STAMP, STAMP)
    assert recorder.last_position is None


def test_a_damaged_block_is_an_error(tmp_path):
    recorder = BitRecorder()
    recorder.open(tmp_path / "bag", load_profile("step"), "EMA-1", STAMP)
    with pytest.raises(InvalidRecordError):
        recorder.take(SAMPLES, b"\x00\x01\x00\x00garbage", STAMP, STAMP)
    path = recorder.close("aborted", None)
    assert (path / "metadata.yaml").is_file()


class Clocks:
    """A host whose clock may step."""

    def __init__(self):
        self.steady, self.step = 100.0, 0.0

    def wall(self):
        return 10**18 + round((self.steady - 100.0 + self.step) * 1e9)


@pytest.mark.parametrize("step", [-3600.0, -0.3, 0.05, 7200.0])
def test_log_times_stay_in_order_when_the_clock_steps(step):
    clocks = Clocks()
    clock = LogClock(clocks.wall, lambda: clocks.steady)
    found = []
    for turn in range(100):
        received = [(clocks.wall(), clocks.steady)]
        clocks.steady += 0.01
        if turn == 50:
            clocks.step = step
        received.append((clocks.wall(), clocks.steady))
        clocks.steady += 0.01
        clock.look()
        found += [(clock.log_time("/a", wall), steady) for wall, steady in received]
    times = np.array([time for time, _ in found], dtype=np.int64)
    true = np.array([steady for _, steady in found])
    assert np.all(np.diff(times) >= 0)
    assert np.abs((times - 10**18) / 1e9 - (true - 100.0)).max() <= 0.021
    assert clock.shift == pytest.approx(step)


def test_topics_have_log_times_of_their_own():
    clocks = Clocks()
    clock = LogClock(clocks.wall, lambda: clocks.steady)
    clocks.steady += 1.0
    clock.look()
    assert clock.log_time("/a", 10**18 + 900) == 10**18 + 900
    assert clock.log_time("/b", 10**18 + 100) == 10**18 + 100
    assert clock.log_time("/a", 10**18 + 500) == 10**18 + 900
