"""What is wrong with records or request, each with its remedy, before anything is fitted."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ema_identification.actuator.measure.features import nominal_rate
from ema_identification.actuator.measure.segments import path
from ema_record.channels import CHANNEL_NAMES, PHASE_CURRENTS, REFERENCE_CURRENTS
from ema_record.checks.facts import facts_of_record
from ema_record.checks.physics import ratios
from ema_record.errors import (
    IncompleteRecordError,
    InvalidRecordError,
    RecordError,
    UsageError,
    unknown_name,
)
from ema_record.record import Record
from ema_sim.effects import EFFECTS
from ema_sim.machine import TURN
from ema_sim.model_file import Model

SHORTEST = 0.15
"""s."""
LEAST_RATE = 24.0
"""Samples an electrical turn at the motor's highest speed."""
LEAST_TURNS = 3.0
"""Of the rotor; below it nothing excites the effects."""
MISSING = 0.05
"""Part of the profile that may be missing at the end."""
LARGEST_VALUE = 1e6
"""Of any channel, in its SI unit; beyond it is no reading."""
SAME = 0.1
"""By which angle and speed may differ, relative, and be the same motion in another unit."""
RPM = 60.0 / TURN


def check_records(
    measured: Sequence[Record], validate: Sequence[Record], model: Model,
    without: Sequence[str], baseline: Sequence[Record] = (),
) -> None:
    """Refuse what cannot be identified.

    Raises
    ------
    RecordError
        Too short, nothing moves, wrong units, a channel without values.
    UsageError
        An effect that is not known, a baseline of another test than the first record's.
    """
    for name in without:
        if name not in EFFECTS:
            raise unknown_name("effect", name, EFFECTS, "'ema effects' lists them")
    for record in (*measured, *validate, *baseline):
        _check(record, model)
    for record in baseline:
        if tuple(record.profile.points) != tuple(measured[0].profile.points) or not math.isclose(
                nominal_rate(record), nominal_rate(measured[0])):
            raise UsageError(f"baseline {_name(record)}: not the command and rate of the measured "
                             "record: give one of the same test")


def _name(record: Record) -> str:
    return record.provenance.source or f"record of {record.profile.name}"


def _check(record: Record, model: Model) -> None:
    name = _name(record)
    if len(record) < 2 or record.duration < SHORTEST:
        raise IncompleteRecordError(
            f"{name}: {record.duration:.3g} s, at least {SHORTEST:g} s: too short to identify "
            "anything; run the profile 'extended'")
    bad = ~np.isfinite(record.samples).all(axis=0)
    if bad.any():
        raise InvalidRecordError(
            f"{name}: channel {CHANNEL_NAMES[int(np.argmax(bad))]} holds values that are not "
            "finite: repeat the test")
    most = np.abs(record.samples).max(axis=0)
    if most.max() > LARGEST_VALUE:
        raise InvalidRecordError(
            f"{name}: channel {CHANNEL_NAMES[int(np.argmax(most))]} reads {most.max():.3g}, at "
            f"most {LARGEST_VALUE:g} is believed: 'ema lint' says where; repeat the test")
    if np.diff(record.time).min() <= 0.0:
        raise InvalidRecordError(f"{name}: time runs back: 'ema lint' says where")
    motor, highest = model.actuator.motor, model.actuator.control.speed_limit
    least = LEAST_RATE * motor.pole_pairs * highest / TURN
    if record.rate < least:
        raise InvalidRecordError(
            f"{name}: {record.rate:.0f} samples/s, at least {least:.0f}: record faster")
    planned = record.profile.duration
    if record.time[-1] < (1.0 - MISSING) * planned:
        raise IncompleteRecordError(
            f"{name}: ends at {record.time[-1]:.2f} s, its profile {record.profile.name} at "
            f"{planned:.2f} s: repeat the test, or give the profile that was commanded")
    _check_motion(record, name)
    _check_units(record, name, model)
    _check_profile(record, name, model)


def _check_motion(record: Record, name: str) -> None:
    turns = float(np.abs(np.diff(np.unwrap(record.channel("rotor_angle")))).sum()) / TURN
    currents = record.samples[:, PHASE_CURRENTS]
    flat = np.ptp(currents, axis=0) == 0.0
    if flat.any() and not flat.all():
        raise InvalidRecordError(
            f"{name}: phase current {'abc'[int(np.argmax(flat))]} does not change: the channel is "
            "missing or stuck; repair it and repeat the test")
    if flat.all():
        raise InvalidRecordError(f"{name}: no current flows: the inverter was off; run the "
                                 "profile 'extended' with the drive on")
    for channel in ("motor_speed", "surface_position", "rotor_angle"):
        if np.ptp(record.channel(channel)) == 0.0:
            raise InvalidRecordError(
                f"{name}: channel {channel} does not change: it is missing or stuck, or nothing "
                "moved; run the profile 'extended'")
    if turns < LEAST_TURNS:
        raise IncompleteRecordError(
            f"{name}: no excitation: the rotor turns {turns:.1f} times, at least "
            f"{LEAST_TURNS:g}: run the profile 'extended'")


def _check_units(record: Record, name: str, model: Model) -> None:
    facts = facts_of_record(record, model.actuator)
    alike = ratios(facts) if facts.angle_in_degrees else None
    if alike is not None and abs(abs(alike.angle) - 1.0) < SAME:
        raise InvalidRecordError(
            f"{name}: channel rotor_angle reads up to {record.channel('rotor_angle').max():.4g}, "
            "a turn is 6.283 rad: it is in degrees, expected rad; convert it")
    pairs = model.actuator.motor.pole_pairs
    turned = np.gradient(np.unwrap(record.channel("rotor_angle")), record.time) / pairs
    speed = record.channel("motor_speed")
    ratio = float(speed @ turned / (turned @ turned))
    for factor, text in ((RPM, "rpm"), (360.0 / TURN, "deg/s"), (1.0 / TURN, "turns/s")):
        if abs(ratio / factor - 1.0) < SAME:
            raise InvalidRecordError(
                f"{name}: motor speed is {ratio:.3g} times the derivative of the rotor angle: it "
                f"is in {text}, expected rad/s; convert it")
    if ratio < 0.0:
        raise InvalidRecordError(
            f"{name}: motor speed and rotor angle run in opposite senses: turn one sign")
    reference = record.samples[:, REFERENCE_CURRENTS]
    read = record.samples[:, PHASE_CURRENTS]
    gain = float((read * reference).sum() / max(float((reference**2).sum()), 1e-12))
    if 300.0 < gain < 3000.0 or float(np.abs(reference).max()) > 1000.0:
        raise InvalidRecordError(
            f"{name}: phase currents are {gain:.3g} times their references or beyond 1000 A: "
            "currents are in mA, expected A; convert them")
    if 0.0003 < gain < 0.003:
        raise InvalidRecordError(
            f"{name}: phase currents are {gain:.3g} times their references: one of the two is in "
            "mA, expected A; convert it")
    travel = float(np.ptp(record.channel("surface_position")))
    motor = float(np.ptp(np.unwrap(record.channel("rotor_angle")))) / pairs
    along = travel * model.actuator.gear.ratio / max(motor, 1e-9)
    if abs(along / (360.0 / TURN) - 1.0) < 0.2:
        raise InvalidRecordError(
            f"{name}: the surface moves {along:.3g} times as far as the motor drives it: its "
            "position is in degrees, expected rad; convert it")


def _check_profile(record: Record, name: str, model: Model) -> None:
    """Refuse a record whose surface went elsewhere than its profile asks."""
    goal = np.interp(record.time, *path(record.profile, model.actuator))
    position = record.channel("surface_position")
    span = float(np.ptp(goal))
    if span <= 0.0:
        raise RecordError(
            f"{name}: profile {record.profile.name} commands no motion: no excitation; run the "
            "profile 'extended'")
    correlation = float(np.corrcoef(goal, position)[0, 1])
    if correlation < 0.8:
        raise InvalidRecordError(
            f"{name}: the surface does not follow the profile {record.profile.name} (correlation "
            f"{correlation:.2f}): it is a record of another profile; give the bag with the "
            "command that was run")
