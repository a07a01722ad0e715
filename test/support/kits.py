"""Kits for tests: copies of the shipped one with another actuator in them."""

from __future__ import annotations

import shutil
from pathlib import Path

import yaml

from ema_record.kit import ACTUATOR, CASCADE, PROFILES, shipped_kit
from ema_record.profile import Profile
from support.simulations import DESCRIPTION, SECOND_STEP


def make_kit(folder: Path, changes: dict[str, dict[str, object]], *tests: Profile,
             cascade: bool = True) -> Path:
    """Return a new kit: the shipped one with some parameters changed, section by section.

    `tests` take the place of its tests of those names; without `cascade` it is not trained.
    """
    shutil.copytree(shipped_kit(), folder)
    file = folder / ACTUATOR
    description = yaml.safe_load(file.read_text(encoding="utf-8"))
    for section, values in changes.items():
        description[section] = {**description.get(section, {}), **values}
    file.write_text(yaml.safe_dump(description), encoding="utf-8")
    for profile in tests:
        text = yaml.safe_dump(profile.model_dump(mode="json"))
        (folder / PROFILES / f"{profile.name}.yaml").write_text(text, encoding="utf-8")
    if not cascade:
        (folder / CASCADE).unlink()
    return folder


def second_kit(folder: Path, **options: bool) -> Path:
    """Return a kit of the second actuator, whose test ``step`` goes through all of its travel."""
    changes = yaml.safe_load(DESCRIPTION.read_text(encoding="utf-8"))
    return make_kit(folder, changes, SECOND_STEP.model_copy(update={"name": "step"}), **options)
