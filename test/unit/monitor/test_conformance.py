"""The contract of a driver, line by line: what is right, absent, and wrong."""

import dataclasses

import numpy as np
import pytest

from ema_monitor.conformance import DriverRun, Endpoint, Heard, report
from ema_record.actuator import load_actuator
from ema_record.wire.topics import COMMAND, SAMPLES, TOPICS, WEIGHT_ON_WHEELS

ACTUATOR = load_actuator()
VALUES = {"state": "idle", "surface_position": "0.1", "command_stamp": "0", "start_time": "0",
          "samples_published": "0"}


def endpoint(topic, **changes):
    return Endpoint("driver", TOPICS[topic].type, reliable=True)._replace(**changes)


def hold():
    """Return half a second of samples as the default kit takes them, and what was said."""
    samples = np.zeros((10_000, 10))
    samples[:, 0] = (np.arange(10_000) + 0.5) / 20_000.0
    said = {**VALUES, "command_stamp": "7", "start_time": "9"}
    return DriverRun(stamp=7, sent=8, duration=0.5, blocks=[samples], statuses=[
        {**said, "state": "active"}, {**said, "samples_published": "10000"}])


def good():
    return Heard(
        "/left", publishers={SAMPLES: [endpoint(SAMPLES)]},
        subscribers={topic: [endpoint(topic)] for topic in (COMMAND, WEIGHT_ON_WHEELS)},
        hardware_id="EMA-1", values=VALUES, problem="", gaps=[1.0, 1.01], skew=-0.01,
        bus=(96.0, -1.0), held=hold(), refused=DriverRun(stamp=5),
        stopped=DriverRun(stamp=6, opened=10.0, idle=10.2),
    )


def outcomes(heard):
    return {line.item: line.outcome for line in report(heard, ACTUATOR)}


def test_a_driver_that_does_what_it_must_has_no_wrong_line():
    found = outcomes(good())
    assert set(found.values()) == {"ok", "absent"}
    assert [item for item, outcome in found.items() if outcome == "absent"] == [
        "publishes ema/dc_bus", "publishes ema/winding_temperature", "follows ema/deadman"]


def blocks(change):
    def apply(heard):
        change(heard.held.blocks[0])
    return apply


def with_status(**changes):
    def apply(heard):
        heard.held.statuses[-1] = {**heard.held.statuses[-1], **changes}
    return apply


def shifted(samples):
    samples[:, 0] += 0.1


def swapped(samples):
    samples[[4, 5], 0] = samples[[5, 4], 0]


def missing(samples):
    samples[5000:, 0] += 1e-4


def no_speed(samples):
    samples[:, 1] = np.nan


def put(**changes):
    def apply(heard):
        for name, value in changes.items():
            setattr(heard, name, value)
    return apply


@pytest.mark.parametrize(("item", "spoil"), [
    ("publishes ema/samples", put(publishers={SAMPLES: [endpoint(SAMPLES)] * 2})),
    ("publishes ema/samples", put(publishers={})),
    ("publishes ema/samples", put(publishers={SAMPLES: [endpoint(SAMPLES, reliable=False)]})),
    ("follows ema/command", put(subscribers={COMMAND: [endpoint(COMMAND, type="x/msg/Y")]})),
    ("follows aircraft/weight_on_wheels", put(subscribers={COMMAND: [endpoint(COMMAND)]})),
    ("status", put(problem="it lacks state", names=["driver: actuator"])),
    ("status rate", put(gaps=[2.0])),
    ("status rate", put(gaps=[])),
    ("serial number", put(hardware_id="")),
    ("stamp", put(skew=3600.0)),
    ("dc_bus values", put(bus=(96.0, 3.0))),
    ("command accepted", put(held=DriverRun(stamp=3))),
    ("state while it runs", lambda heard: heard.held.statuses.pop(0)),
    ("start_time", put(held=dataclasses.replace(hold(), sent=10**10))),
    ("samples", put(held=dataclasses.replace(hold(), blocks=[]))),
    ("samples", put(held=dataclasses.replace(hold(), errors=["damaged"]))),
    ("channels", blocks(no_speed)),
    ("time order", blocks(swapped)),
    ("rate", lambda heard: heard.held.blocks.__setitem__(0, heard.held.blocks[0][::2])),
    ("time of samples", blocks(shifted)),
    ("gaps", blocks(missing)),
    ("end", with_status(state="active")),
    ("samples_published", with_status(samples_published="9600")),
    ("obeys on the wheels alone", put(refused=DriverRun(
        stamp=5, statuses=[{**VALUES, "command_stamp": "5"}]))),
    ("stops off the wheels", put(stopped=DriverRun(stamp=6, opened=10.0))),
    ("stops off the wheels", put(stopped=DriverRun(stamp=6, opened=10.0, idle=12.0))),
])
def test_what_is_wrong_is_the_line_that_says_so(item, spoil):
    heard = good()
    spoil(heard)
    assert outcomes(heard)[item] == "WRONG"


def test_with_another_aircraft_on_the_domain_the_interlock_is_not_tested():
    found = outcomes(dataclasses.replace(good(), refused=None, stopped=None))
    assert found["stops off the wheels"] == found["obeys on the wheels alone"] == "untested"
