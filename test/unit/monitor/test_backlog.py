"""A backlog of messages on a machine that is loaded: who watches the surface still says so."""

from types import SimpleNamespace

import pytest

from ema_monitor import monitor_node
from ema_monitor.messages import READ
from ema_monitor.monitor_node import SIGN_PERIOD, MonitorNode
from ema_monitor.sequence import Stage
from ema_record.errors import InvalidRecordError
from ema_record.wire.topics import BAG_TOPICS, DC_BUS, DIAGNOSTICS, SAMPLES, WEIGHT_ON_WHEELS
from ema_ros.messages import Taken


@pytest.mark.parametrize("stage", [Stage.TESTING, Stage.IDLE])
def test_a_sign_of_life_comes_between_the_messages_of_a_backlog(monkeypatch, stage):
    """100 blocks of 30 ms each, 3 s: more than the driver waits without a sign."""
    clock, signs = [100.0], []

    def take(*_):
        clock[0] += 0.03

    monkeypatch.setattr(monitor_node, "take_all",
                        lambda _: [Taken(b"", 0, 0, number) for number in range(100)])
    monkeypatch.setattr(monitor_node.time, "monotonic", lambda: clock[0])
    node = MonitorNode.__new__(MonitorNode)
    node._recorder = SimpleNamespace(clock=SimpleNamespace(look=lambda: None), take=take)
    node._polled, node._last_block = {SAMPLES: None}, 0.0
    node._sequence = SimpleNamespace(stage=stage)
    node._deadman = SimpleNamespace(publish=lambda header: signs.append((clock[0], header)))
    node._next_sign, node._last_sent = 0.0, 7_000_000_005
    node._drain()
    if stage is Stage.IDLE:
        assert signs == []
        return
    times = [time for time, _ in signs]
    assert max(b - a for a, b in zip(times, times[1:])) <= SIGN_PERIOD + 0.03
    assert times[-1] > clock[0] - 0.1
    assert {(h.stamp.sec, h.stamp.nanosec) for _, h in signs} == {(7, 5)}


def test_behind_a_damaged_message_the_others_are_taken(monkeypatch):
    taken = []

    def take(topic, data, *_):
        taken.append((topic, data))
        if data == b"bad":
            raise InvalidRecordError(f"{topic}: damaged")

    monkeypatch.setattr(monitor_node, "take_all", lambda _: [
        Taken(b"bad", 0, 0, 1), Taken(b"bad", 0, 0, 2), Taken(b"good", 0, 0, 3)])
    node = MonitorNode.__new__(MonitorNode)
    node._recorder = SimpleNamespace(clock=SimpleNamespace(look=lambda: None), take=take)
    node._polled, node._last_block = {SAMPLES: None, DC_BUS: None}, 0.0
    node._sequence = SimpleNamespace(stage=Stage.IDLE)
    assert node._drain() == f"{SAMPLES}: damaged"
    assert taken == [(t, d) for t in (SAMPLES, DC_BUS) for d in (b"bad", b"bad", b"good")]


def test_what_aborts_is_read_before_what_is_recorded():
    assert READ[0] == WEIGHT_ON_WHEELS
    assert sorted(READ) == sorted([DIAGNOSTICS, *(topic.name for topic in BAG_TOPICS)])
