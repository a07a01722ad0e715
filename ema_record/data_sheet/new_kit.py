"""A kit from a data sheet; its `actuator.yaml`: each parameter, its unit, and where it is from."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import textwrap
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

from ema_record.actuator import PARTS, Actuator, actuator_from
from ema_record.data_sheet.derive import Description, bounds_of, describe
from ema_record.data_sheet.sheet import DataSheet
from ema_record.errors import UsageError
from ema_record.files import cannot_write, exists
from ema_record.kit import ACTUATOR, PROFILES
from ema_record.profiles.design import default_profiles
from ema_record.profiles.text import write_profiles
from ema_record.spread import Conditions, UnitTolerances
from ema_record.yaml_file import yaml_of

TOLERANCES = {
    "resistance": 0.10, "inductance": 0.10, "back_emf": 0.03, "back_emf_phase": 0.005,
    "flat_top": 0.0873, "motor_friction": 0.10, "surface_friction": 0.10, "static_ratio": 0.20,
    "viscous_factor": 2.0, "inertia": 0.10, "stiffness": 0.20, "damping": 0.30,
    "control_gain": 0.10, "hysteresis": 0.10, "backlash": 0.20, "latency": 2.0,
}
"""As units of one type differ that no one has measured yet (docs/kit.md)."""
LOAD_SHARE, OFFSET_SHARE = 0.3, 1.0 / 440.0
"""Of the surface's dry friction; of the current limit."""
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
        said = str(error)
        for parameter, option in NAMES.items():
            said = said.replace(parameter, option)
        if not sheet.has("rate"):
            said = said.replace("--rate", "without --rate, one a control period,")
        raise UsageError(said) from None
    text = actuator_yaml(description, sheet)
    draft: Path | None = None
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
        draft.chmod(0o755)
        (draft / ACTUATOR).write_text(text, encoding="utf-8", errors="backslashreplace")
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


def conditions(description: Description) -> dict[str, float]:
    """Return the conditions of a test, in proportion to the actuator."""
    actuator = description.actuator
    return {
        "temperature_least": -40.0, "temperature_most": 70.0, "bus": 0.10,
        "load": float(f"{LOAD_SHARE * actuator.surface.dynamic_friction:.3g}"),
        "noise_least": 0.25, "noise_most": 2.0, "current_gain": 0.01,
        "current_offset": float(f"{OFFSET_SHARE * actuator.inverter.current_limit:.3g}"),
    }


def actuator_yaml(description: Description, sheet: DataSheet) -> str:
    """Return the text of `actuator.yaml`."""
    kinds = [entry.origin for part in description.entries.values() for entry in part.values()]
    lines = [
        *(f"# {line}" for line in _head(sheet)),
        "# SI; meaning and bounds of each parameter: ema_record/actuator.py. Beside each stands "
        "its unit and whether",
        f"# it was given ({kinds.count('given')}), derived ({kinds.count('derived')}) or assumed "
        f"({kinds.count('assumed')}). Correct what you know better; 'ema commission' corrects "
        "the rest",
        "# from acceptance records. After a change of stroke, gear or speed: 'ema profile "
        "--design'.",
    ]
    for section, part in description.entries.items():
        lines.append(f"{section}:")
        for name in getattr(description.actuator, section)._fields:
            entry = part[name]
            unit = bounds_of(section, name)[2]
            comment = f"{entry.origin}: {entry.how}"
            lines.append(_line(name, entry.value, comment if unit == "1" else
                               f"{unit}; {comment}"))
    lines.append("tolerances:  # of units of one type, + and -, relative where no unit stands")
    lines += [_line(name, value, f"assumed: {_meaning(UnitTolerances, name)}")
              for name, value in TOLERANCES.items()]
    lines.append("conditions:  # of a test")
    lines += [_line(name, value, f"assumed: {_meaning(Conditions, name)}")
              for name, value in conditions(description).items()]
    return "\n".join(lines) + "\n"


def _head(sheet: DataSheet) -> list[str]:
    given = " ".join(f"--{name} {value.text.replace(' ', '')}"
                     for name, value in sheet.given.items())
    return [f"{' '.join((sheet.name or 'An actuator').split())}, from its data sheet:",
            *textwrap.wrap(given, 96, break_on_hyphens=False, break_long_words=False)]


def _meaning(part: Any, name: str) -> str:
    """Return meaning and unit of a tolerance or condition."""
    field = get_type_hints(part, include_extras=True)[name].__metadata__[-1]
    unit = (field.json_schema_extra or {}).get("unit", "1")
    return field.description + ("" if unit == "1" else f" ({unit})")


def _line(name: str, value: Any, comment: str) -> str:
    """Return a parameter's line; a number is read back as it was."""
    if isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, float):
        text = repr(value)
        if "e" in text and "." not in text.split("e")[0]:
            text = text.replace("e", ".0e")  # YAML takes 1e-05 for a word
    else:
        text = str(value)
    return f"  {name + ': ' + text:35} # {comment}"


def with_values(text: str, actuator: Actuator, tolerances: NamedTuple | None = None) -> str:
    """Return the text of an `actuator.yaml` with the values of `actuator`, comments kept.

    A parameter stands on a line of its own, ``  name: value  # comment``; values that are equal
    are left as they are written, and `tolerances` where they are not given. One that the text
    leaves at its default gets a line where it is no longer that.
    """
    section, lines = "", list[str]()
    unsaid = {part: {name: value for name, value in getattr(actuator, part)._asdict().items()
                     if value != of._field_defaults.get(name, value)}
              for part, of in PARTS.items()}
    ends: dict[str, int] = {}
    for line in text.splitlines():
        heading = re.match(r"([a-z_]+):\s*(#.*)?$", line)
        section = heading.group(1) if heading else section
        if re.match(rf"({'|'.join(PARTS)}):\s*\{{", line):
            raise UsageError(f"{line.partition(':')[0]}: all on one line, where no value can be "
                             "put in its place: write each on a line of its own")
        entry = re.match(r"(\s+)([a-z_0-9]+):(\s*)([^#\s]+)(\s*)(#.*)?$", line)
        if entry and (section in PARTS or (section == "tolerances" and tolerances is not None)):
            indent, name, gap, old, space, comment = entry.groups()
            unsaid.get(section, {}).pop(name, None)
            ends[section] = len(lines) + 1
            if section in PARTS:
                part: NamedTuple = getattr(actuator, section)
                old_one = actuator_from({section: {name: yaml_of(old, "text")}}, "text", actuator)
                given = getattr(getattr(old_one, section), name)
            else:
                assert tolerances is not None
                part, given = tolerances, float(old)
            value = getattr(part, name)
            if given != value:
                new = f"{value:.6g}" if isinstance(value, float) else str(value)
                new = str(bool(value)).lower() if old in ("true", "false") else new
                written = old + space if comment else old
                lines.append(f"{indent}{name}:{gap}{new.ljust(len(written) - 1)} "
                             f"{comment or ''}".rstrip())
                continue
        lines.append(line)
    for section in sorted(ends, key=lambda name: -ends[name]):
        lines[ends[section]:ends[section]] = [
            _line(name, float(f"{value:.6g}"), _meaning(PARTS[section], name))
            for name, value in unsaid.get(section, {}).items()]
    return "\n".join(lines) + "\n"
