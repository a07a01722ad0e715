"""Kits of the other machines, as the product makes them: profiles, libraries of the tests."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from benchmarks.any_actuator.machines import FOLDER
from benchmarks.blind_panel.tasks import made_kit
from ema_identification.actuator.library.build import fleet_library
from ema_record.kit import ACTUATOR, LIBRARY, PROFILES, using_kit
from ema_record.profile import load_profile
from ema_record.profiles.text import write_profiles
from ema_sim.model_file import load_model_file


def make_kit(name: str, out: Path, tests: Sequence[str]) -> None:
    """Make in `out` what is missing of a machine's kit: profiles, libraries of the tests."""
    made, described = made_kit(name, out), FOLDER / name
    if not (made / ACTUATOR).exists():
        made.mkdir(parents=True, exist_ok=True)
        with using_kit(described):
            if not (made / PROFILES).exists():
                write_profiles(load_model_file().actuator, made / PROFILES)
        shutil.copyfile(described / ACTUATOR, made / ACTUATOR)
    with using_kit(made):
        for n, test in enumerate(tests):
            if not (made / LIBRARY / f"{test}.built").exists():
                with threadpool_limits(limits=1):  # as `identify` makes it
                    fleet_library(load_model_file(), load_profile(test), signatures=n == 0,
                                  folder=made / LIBRARY)
                (made / LIBRARY / f"{test}.built").touch()
