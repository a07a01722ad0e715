"""The folder of a kit that is being made: ours alone, and taken up again after an interruption."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ema_record.actuator import load_actuator
from ema_record.errors import OutputError, UsageError
from ema_record.files import cannot_write, locked
from ema_record.kit import ACTUATOR, PROFILES, using_kit
from ema_record.spread import load_spread

MARK = ".unfinished"
"""File by which a draft is known for ours."""


@contextmanager
def own_draft(draft: Path) -> Iterator[None]:
    """Make the folder of an unfinished kit, or take up one of ours; no other process may.

    Raises
    ------
    OutputError
        It is somebody else's, in use, or cannot be made.
    """
    if os.path.lexists(draft) and not (draft / MARK).is_file():
        raise OutputError(f"{draft}: exists and is no kit that was begun here: move it away")
    try:
        draft.mkdir(parents=True, exist_ok=True)
        (draft / MARK).touch()
    except OSError as error:
        raise cannot_write(draft, error) from None
    with locked(draft / MARK, f"{draft}: another process is making this kit: wait for it"):
        yield


def make_draft(description: Path, draft: Path) -> None:
    """Write the description, and its tests, into the folder of an unfinished kit.

    The tests are those beside the description, or made for the actuator.
    """
    from ema_record.profile import UNITS, load_profile_dict
    from ema_record.profiles.text import profile_yaml, write_profiles
    from ema_record.yaml_file import load_yaml

    if description.is_dir():
        raise UsageError(f"{description}: a folder: give the file {description / ACTUATOR}")
    if not description.is_file():
        raise UsageError(f"{description}: no such file: 'ema new-actuator' writes one from a "
                         "data sheet")
    try:
        shutil.copyfile(description, draft / ACTUATOR)
    except OSError as error:
        raise cannot_write(draft, error) from None
    with using_kit(draft):
        try:
            actuator = load_actuator()
            load_spread()
        except UsageError as error:
            copy = str(draft.resolve() / ACTUATOR)
            raise UsageError(str(error).replace(copy, str(description))) from None
        beside = description.parent / PROFILES
        shutil.rmtree(draft / PROFILES, ignore_errors=True)  # of a description before
        if beside.is_dir():
            shutil.copytree(beside, draft / PROFILES)
            for file in (draft / PROFILES).glob("*.yaml"):
                data = load_yaml(file)
                if isinstance(data, dict) and UNITS in data:  # stay while the model changes
                    file.write_text(profile_yaml(load_profile_dict(data, str(file)), actuator,
                                                 "As of the description"), encoding="utf-8")
        else:
            write_profiles(actuator, draft / PROFILES)
