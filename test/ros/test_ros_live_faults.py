"""Faults of the live system during a test: bounded, said, nothing lost, mixed or left behind."""

import os
from random import Random

import psutil
import pytest

from ema_ros.domain import local_environment
from support.chain import Clock, chain, left_in_shared_memory
from support.live_faults import HIDDEN, KINDS, one

pytestmark = pytest.mark.slow

SILENCE = 3.0
"""When the acquisition counts as lost (s): longer than a busy machine needs to begin a move."""
EARLY = 0.3
"""When the fault strikes, since the recording began (s)."""


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """Yield a chain of real nodes whose clock can be stepped; at its end nothing may be left."""
    out = tmp_path_factory.mktemp("live")
    clock = Clock(out)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", "0")
        for name, value in {**local_environment(), **clock.environment}.items():
            patch.setenv(name, value)
        parameters = {**HIDDEN, "serial_number": "EMA-1"}
        with chain(out, simulator=parameters, monitor={"stream_timeout": SILENCE}) as found:
            found.clock = clock
            litter = left_in_shared_memory()
            yield found
        assert [pid for pid in found.pids if psutil.pid_exists(pid)] == [], "a node is left"
        assert left_in_shared_memory() <= litter, "shared memory is left"
        assert "Traceback" not in (out / "nodes.log").read_text()


def early(kind):
    """Return the kind with its fault soon after the recording began."""

    def make(found, rng):
        fault = kind.make(found, rng)
        fault.at = EARLY
        return fault

    return kind._replace(make=make)


@pytest.mark.parametrize("name", [
    "neighbour", "slow_consumer", "wheels_flap", "aircraft_silent", "prognostics_killed",
    "clock_back", "simulator_restarted", "peer_lost", "monitor_killed",
])
def test_live_fault(live, name):
    result = one(live, early(KINDS[name]), Random(3))
    assert result["wrong"] == [], result
    assert result["ended"] in KINDS[name].ends


def test_a_whole_test_after_all_that(live):
    result = one(live, KINDS["nothing"], Random(4))
    assert result["wrong"] == [], result
    assert result["records"] == ["complete"]
    assert result["verdict"] == "fault"
    assert "ROS_DOMAIN_ID" in os.environ
