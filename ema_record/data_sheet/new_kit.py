"""A new kit from a data sheet: `actuator.yaml` and the default tests, whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from ema_record.data_sheet.derive import Description, describe
from ema_record.data_sheet.sheet import DataSheet
from ema_record.data_sheet.text import actuator_yaml
from ema_record.errors import UsageError
from ema_record.files import cannot_write, exists
from ema_record.kit import ACTUATOR, PROFILES
from ema_record.profiles.design import default_profiles
from ema_record.profiles.text import write_profiles

NAMES = {
    "control.speed_limit": "--speed", "inverter.current_limit": "--current-limit",
    "motor.torque_limit": "--peak-torque", "acquisition.rate": "--rate",
    "shaft.stiffness": "--stiffness", "shaft.backlash": "--backlash",
}
"""What parameters are called on the command line."""


def new_kit(sheet: DataSheet, out: Path) -> Description:
    """Write the kit of a data sheet into the new folder `out` and return its description.

    Raises
    ------
    UsageError
        The actuator is not possible, or cannot make its own tests; nothing is written.
    OutputError
        `out` exists, or cannot be written.
    """
    if os.path.lexists(out):
        raise exists(out)
    try:
        description = describe(sheet)
        default_profiles(description.actuator)
    except UsageError as error:
        said = _in_options(str(error))
        if not sheet.has("rate"):
            said = said.replace("--rate", "without --rate, one a control period,")
        raise UsageError(said) from None
    text = actuator_yaml(description, sheet)
    draft: Path | None = None
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
        draft.chmod(0o755)
        (draft / ACTUATOR).write_text(text, encoding="utf-8")
        write_profiles(description.actuator, draft / PROFILES)
        if os.path.lexists(out):  # an empty folder would be replaced
            raise exists(out)
        draft.rename(out)
    except OSError as error:
        raise cannot_write(out, error) from None
    finally:
        if draft is not None:
            shutil.rmtree(draft, ignore_errors=True)
    return description


def _in_options(text: str) -> str:
    """Return an error about parameters in the words of the command line."""
    for parameter, option in NAMES.items():
        text = text.replace(parameter, option)
    return text
