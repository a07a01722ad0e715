"""Simulated records that many tests look at: each is simulated once a process."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

from ema_record.actuator import Actuator, load_actuator
from ema_record.profile import Profile, load_profile, step_profile
from ema_record.record import Record
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate

DESCRIPTION = Path(__file__).with_name("second_actuator.yaml")
SECOND_STEP = step_profile(1.4, start=-0.7, duration=1.5)
"""A test of the second actuator: nearly all of its travel."""


def second_actuator() -> Actuator:
    """Return an actuator that shares no number with the default one."""
    return load_actuator(DESCRIPTION)


@functools.lru_cache(maxsize=100)
def _simulated(profile: str | Profile, effects: tuple[str, ...], seed: int, **options) -> Record:
    loaded = load_profile(profile) if isinstance(profile, str) else profile
    return simulate(loaded, effects=parse_effects(effects), seed=seed, **options)


def record_of(profile: str | Profile, *effects: str, seed: int, **options) -> Record:
    """Return a record of the default actuator; its samples may be changed.

    Parameters
    ----------
    profile : name of a shipped profile, or one.
    effects : as on the command line, "turn_short.fraction=0.1".
    seed : of noise and start angle.
    options : further ones of `simulate` that can be compared: rate, noise, serial_number.
    """
    found = _simulated(profile, effects, seed, **options)
    return dataclasses.replace(found, samples=found.samples.copy())
