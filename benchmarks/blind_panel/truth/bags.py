"""The bags of a case, made by the fixed-step reference; nothing in them tells the answer."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

from benchmarks.blind_panel.truth.cases import Case
from benchmarks.blind_panel.truth.foreign import foreign_actuator, foreign_record
from benchmarks.units import actuator_of
from ema_record.actuator import Actuator, load_actuator
from ema_record.bag.read import write_bag
from ema_record.files import sync_directory
from ema_record.profile import Profile, load_profile
from ema_record.record import Provenance, Record
from ema_sim.effects import Effects
from ema_sim.effects.settings import effects_from_mapping
from support.reference import simulate_reference

REVERSAL = Profile(
    name="reversal",
    points=((0.0, 0.3), (0.022, 0.3), (0.022, -0.1), (0.36, -0.1), (0.36, 0.0), (0.86, 0.1),
            (1.01, 0.1), (1.41, 0.02)),
    description="step down, slews up and down at half and quarter speed",
)
"""The second command of held-out records: other speeds and places than the default test's."""
START_TIME = 1_795_000_000_000_000_000
"""Of the first test (ns since the epoch)."""
_TESTS = {"measured": 0, "validate": 1, "next": 2}


def held_out_profile(name: str) -> Profile:
    """Return the profile of a held-out record."""
    return REVERSAL if name == REVERSAL.name else load_profile(name)


def truth_of(case: Case) -> tuple[Actuator, Effects]:
    """Return the actuator of a case with conditions and what is hidden."""
    actuator = foreign_actuator(case.foreign, actuator_of(case.unit.spread, load_actuator()))
    settings = dict(case.settings)
    for name, value in case.unit.conditions.items():
        hidden = settings.get(name, 0.0)
        assert isinstance(hidden, float)
        settings[name] = value + hidden
    return actuator, effects_from_mapping(settings)


def record_of(case: Case, profile: Profile, test: str) -> Record:
    """Return the record of one test of a case.

    Parameters
    ----------
    case : the unit and what is hidden.
    profile : the command.
    test : ``measured``, ``validate`` or ``next``; start angle and noise differ between them.
    """
    actuator, effects = truth_of(case)
    record = simulate_reference(
        profile, actuator=actuator, effects=effects, seed=case.seed + _TESTS[test],
        noise=case.unit.noise,
    )
    place = int(case.id[1:]) * 600 + _TESTS[test] * 60
    return replace(
        foreign_record(case.foreign, record),
        provenance=Provenance(serial_number=f"UNIT-{case.id[1:]}", software_version="panel",
                              start_time=START_TIME + place * 10**9),
    )


def make_bags(case: Case, folder: Path) -> None:
    """Make ``measured`` and ``validate`` in ``folder/ID``, whole or not at all."""
    final = folder / case.id
    if final.exists():
        return
    partial = folder / f".{case.id}.{os.getpid()}.tmp"
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    profiles = {"measured": load_profile(case.first), "validate": held_out_profile(case.held_out)}
    for test, profile in profiles.items():
        write_bag(record_of(case, profile, test), partial / test, views=False)
    partial.replace(final)
    sync_directory(folder)


def make_next_bag(case: Case, profile: Profile, folder: Path) -> None:
    """Make ``next``, the record of the test that the workflow proposed, in ``folder/ID``."""
    final = folder / case.id / "next"
    if final.exists():
        return
    partial = folder / case.id / f".next.{os.getpid()}.tmp"
    shutil.rmtree(partial, ignore_errors=True)
    write_bag(record_of(case, profile, "next"), partial, views=False)
    partial.replace(final)
    sync_directory(folder / case.id)
