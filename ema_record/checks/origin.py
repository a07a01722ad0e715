"""Rules on what was recorded, by whom, and of which test."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from ema_record.actuator_type import OWN_KIT, another_actuator, is_of_another_actuator
from ema_record.channels import CHANNELS, MOTOR_SPEED, REFERENCE_CURRENTS, TIME
from ema_record.checks.facts import BagFacts, Hit, Rule
from ema_record.errors import UsageError
from ema_record.kit import kit_name
from ema_record.version import VERSION
from ema_record.wire.topics import COMMAND, DC_BUS, SAMPLES, WEIGHT_ON_WHEELS, WINDING_TEMPERATURE
from ema_record.wire.trajectory import trajectory_points

RATE_TOLERANCE = 1e-3
JUDGED_RATES = 0.75, 5.0
"""Rates, of the acquisition's, between which features are as those at it; beyond, what a leg does
between two samples makes shorts of healthy windings (docs/recordings.md, "Another rate")."""
LENGTH_TOLERANCE = (2e-3, 2.0)
"""Of the length of a record: in s, and at least in samples."""
DRIVEN = 0.506
"""Share of its highest speed that the controller asks for where it surely wants motion."""
CONTENT = 0.5
"""Share of its limit below which a reference current says that the controller wants none."""
LEAST_DISTANCE = 0.02
"""Share of the travel that the surface may be off its command, whatever the loop's gain."""
STEADY_TIME = 1.3
"""In which a motor that is braked slows down (of the time that its run-up takes)."""
_REQUIRED = (SAMPLES, COMMAND, DC_BUS, WINDING_TEMPERATURE)


def other_actuator(facts: BagFacts) -> Iterator[Hit]:
    """Find a record that names another actuator than the kit's."""
    named = facts.provenance.actuator
    if is_of_another_actuator(named):
        yield Hit(another_actuator(named))


def missing_channels(facts: BagFacts) -> Iterator[Hit]:
    """Find channels that the kit's acquisition records and the record lacks."""
    if not facts.blocks:
        return
    lacking = [CHANNELS[c].name for c in facts.actuator.acquisition.columns
               if not facts.has(c)]
    if lacking:
        yield Hit(f"not recorded: {', '.join(lacking)}, which the acquisition of {kit_name()} "
                  "records", channel=lacking[0])


def missing_topics(facts: BagFacts) -> Iterator[Hit]:
    """Find topics without a message."""
    for topic in _REQUIRED:
        if topic not in facts.topics:
            yield Hit(f"no message on {topic}", channel=topic)


def undecodable(facts: BagFacts) -> Iterator[Hit]:
    """Find messages that are not what their topic says."""
    if facts.errors:
        yield Hit(facts.errors[0], size=float(len(facts.errors)), unit="messages")


def not_complete(facts: BagFacts) -> Iterator[Hit]:
    """Find tests that did not end as they should."""
    status = facts.provenance.status
    if status != "complete":
        end = float(facts.samples[-1, TIME]) if len(facts.samples) else 0.0
        length = facts.profile.duration if facts.profile else end
        yield Hit(f"the test was {status} at {end:.3f} s of {length:.3f} s", end,
                  max(0.0, length - end), "s")
    if facts.recovered is not None:
        missing = facts.recovered.get("missing_ms", "")
        amount = missing if re.fullmatch(r"\d{1,12}(\.\d{1,6})?", missing) else "unknown"
        yield Hit(f"recovered from a cut or damaged bag, {amount} ms missing")


def foreign(facts: BagFacts) -> Iterator[Hit]:
    """Find records of other software."""
    if not facts.has_start:
        yield Hit("no metadata of this software: recorded by another recorder")
        return
    found = facts.provenance.software_version
    if found.split(".")[:2] != VERSION.split(".")[:2]:
        yield Hit(f"recorded by version {found[:40]!r}, this is {VERSION!r}")


def wrong_profile(facts: BagFacts) -> Iterator[Hit]:
    """Find a profile that is not the one that was commanded or driven."""
    said, commanded = facts.said, facts.command
    if said is not None and commanded is not None and (
        trajectory_points(said) != trajectory_points(commanded)
    ):
        yield Hit(f"the metadata say {said.name!r}, {COMMAND} is another profile "
                  f"({commanded.name!r})", 0.0)
    profile, s, actuator = facts.profile, facts.samples, facts.actuator
    if profile is None:
        return
    try:
        profile.check_within(actuator.surface.end_stop)
    except UsageError as error:
        yield Hit(str(error))
    if len(s) < 2:
        return
    limit = actuator.control.speed_limit
    off_command = max(
        DRIVEN * limit / max(actuator.control.position_gain, 1.0),
        LEAST_DISTANCE * actuator.surface.end_stop,
    )
    command = profile.command(s[:, TIME])
    asked = REFERENCE_CURRENTS if facts.has_references else facts.currents
    content = (np.abs(s[:, MOTOR_SPEED]) < facts.standing) & (
        np.abs(s[:, asked]).max(axis=1) < CONTENT * actuator.inverter.current_limit
    ) & (s[:, TIME] > profile.inverter_off + 0.01)
    away = np.abs(facts.surface - command)
    wrong = content & (away > off_command)
    if wrong.sum() * facts.interval > 0.01:
        row = int(np.argmax(wrong))
        yield Hit(
            f"the surface rests at {facts.surface[row]:.3f} rad, {profile.name!r} commands "
            f"{command[row]:.3f} rad", float(s[row, TIME]), float(away[wrong].max()), "rad",
        )
        return
    lag = max(2, round(STEADY_TIME * facts.run_up / facts.interval))
    speed = s[:, MOTOR_SPEED]
    flees = (away > off_command) & (np.abs(speed) > facts.standing) & (
        speed * (command - facts.surface) < 0.0
    )
    flees[lag:] &= speed[lag:] * np.sign(speed[:-lag]) > 0.95 * np.abs(speed[:-lag])
    flees[:lag] = False
    if flees.sum() > lag:
        row = int(np.argmax(flees))
        yield Hit(
            f"the surface is driven away from the {command[row]:.3f} rad that {profile.name!r} "
            "commands", float(s[row, TIME]), float(away[flees].max()), "rad",
        )


def wrong_rate(facts: BagFacts) -> Iterator[Hit]:
    """Find another sampling rate than the acquisition's."""
    if len(facts.samples) > 1:
        rate, expected = 1.0 / facts.interval, facts.actuator.acquisition.rate
        if abs(rate / expected - 1.0) > RATE_TOLERANCE:
            yield Hit(f"{rate:.1f} samples a second, expected {expected:g}", None,
                      rate / expected, "")


def wrong_length(facts: BagFacts) -> Iterator[Hit]:
    """Find records that are shorter or longer than their test."""
    if facts.profile is None or not facts.blocks:
        return
    if len(facts.samples) < 2:
        yield Hit(f"{len(facts.samples)} usable samples", 0.0, facts.profile.duration, "s")
        return
    rest = 1.0 - facts.actuator.acquisition.time_at
    end = float(facts.samples[-1, TIME]) + rest * facts.interval
    missing = facts.profile.duration - end
    if abs(missing) > max(LENGTH_TOLERANCE[0], LENGTH_TOLERANCE[1] * facts.interval):
        yield Hit(
            f"the record ends at {end:.4f} s, its profile {facts.profile.name!r} at "
            f"{facts.profile.duration:.4f} s", end, missing, "s",
        )


def off_wheels(facts: BagFacts) -> Iterator[Hit]:
    """Find a test during which the weight was off the wheels."""
    off = facts.weight_on_wheels.count(False)
    if off:
        yield Hit(f"{off} messages on {WEIGHT_ON_WHEELS} say that the aircraft is not on its "
                  "wheels", size=float(off), unit="messages", channel=WEIGHT_ON_WHEELS)


OTHER_ACTUATOR = Rule(name="other_actuator", find=other_actuator, remedy=OWN_KIT)
"""What makes all other rules pointless."""
RULES = (
    OTHER_ACTUATOR,
    Rule(name="missing_channel", find=missing_channels,
         remedy="record it; or say in the kit's acquisition that it is not there and train anew"),
    Rule(name="missing_topic", find=missing_topics,
         remedy="record all topics of the test ('ema bit' does)"),
    Rule(name="undecodable", find=undecodable,
         remedy="record the channels of this version, or convert the file with 'ema import'"),
    Rule(name="test_not_complete", find=not_complete, remedy="run the built-in test again"),
    Rule(name="foreign_software", find=foreign, level="warning",
         remedy="check that units and channels are those of this version"),
    Rule(name="wrong_profile", find=wrong_profile,
         remedy="record the test with the profile that is commanded"),
    Rule(name="sample_rate", find=wrong_rate,
         remedy="set the acquisition to the rate of its actuator and record the test again, or "
                "commission a kit whose acquisition has this rate"),
    Rule(name="record_length", find=wrong_length,
         remedy="record from the command to the end of the profile"),
    Rule(name="weight_on_wheels", find=off_wheels,
         remedy="check the interlock; run the built-in test on the ground"),
)
