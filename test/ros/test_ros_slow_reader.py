"""A reader of the samples that takes nothing: bounded, said, and the actuator lives on."""

import time

import pytest
from ros_processes import SIMULATOR

from ema_monitor.moves import step_to
from ema_record.profile import load_profile_dict
from ema_record.wire.topics import SAMPLES
from ema_ros.messages import PolledGroup, make_polled_subscription

LONG = {"name": "long", "points": [[0.0, -0.4], [0.03, -0.4], [6.0, 0.4]]}
"""In blocks of 10 samples more messages than both ends of a connection keep (5000 each)."""


def idle_reader(watcher):
    """Return a subscription to the samples that takes none; a long command has begun."""
    watcher.wait_for_simulator()
    idle = make_polled_subscription(watcher.node, SAMPLES, PolledGroup())
    watcher.wait(lambda: watcher.actuator["sample_readers"] == "2", what="both readers")
    watcher.command(load_profile_dict(LONG, "long"))
    return idle


@pytest.mark.slow
def test_a_reader_that_takes_nothing_ends_the_run_and_the_actuator_lives_on(nodes, watcher):
    nodes.start(SIMULATOR, block_size=10, real_time_factor=0.0, slow_reader_timeout=0.5)
    idle = idle_reader(watcher)
    watcher.wait(lambda: "took nothing for 0.5 s: run given up" in watcher.actuator["message"],
                 60.0, "the end of the run")
    assert watcher.actuator["state"] == "idle"
    assert int(watcher.actuator["samples_published"]) < 120_000
    watcher.node.destroy_subscription(idle)
    stamp = watcher.command(step_to(-0.3))
    watcher.wait(lambda: watcher.actuator["command_stamp"] == stamp
                 and watcher.actuator["state"] == "idle", what="the next command")
    assert watcher.actuator["message"] == "command executed"


@pytest.mark.slow
def test_an_open_interlock_is_seen_while_a_reader_takes_nothing(nodes, watcher):
    nodes.start(SIMULATOR, block_size=10, real_time_factor=0.0, slow_reader_timeout=20.0)
    idle = idle_reader(watcher)
    watcher.wait(lambda: len(watcher.blocks) >= 5000, 60.0, "a full history")
    watcher.spin_for(1.0)
    watcher.node.weight_on_wheels = False
    watcher.node.send_weight_on_wheels()
    begin = time.monotonic()
    watcher.wait(lambda: "stopped: no weight on wheels" in watcher.actuator["message"],
                 5.0, "the stop")
    assert time.monotonic() - begin < 1.0
    watcher.node.destroy_subscription(idle)
    watcher.wait(lambda: watcher.actuator["state"] == "idle", what="the end of the run")
    assert int(watcher.actuator["samples_published"]) < 120_000
