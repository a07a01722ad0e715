"""The words of a verdict, in the language of its reader: faults, sizes, features, what to do.

All words stand in the tables `ema_prognostics/language/*.yaml`. `$EMA_LANG` names the table, or is
the path of one of your own; what a table lacks is said in English. What programs read (JSON, ROS
messages, files of a kit) is English in any language.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from string import Formatter

from ema_record.errors import UsageError, unknown_name

ENVIRONMENT = "EMA_LANG"
ENGLISH = "en"
FOLDER = Path(__file__).parent / "language"
CLASSES = ("turn_short", "rotor_eccentricity", "friction", "backlash")
SCALES = {"turn_short": 100.0, "rotor_eccentricity": 100.0, "friction": 100.0, "backlash": 1e3}
"""Factor from the SI value of a severity to the unit that a person reads."""
STEP_KINDS: tuple[tuple[tuple[str, ...], str], ...] = (
    (("noise_", "sum_", "reference_", "offset_", "gain_", "position_step", "speed_step",
      "speed_over_angle", "position_over_angle", "position_rms", "start_position"), "sensor"),
    (("control_", "bus_sag", "switch_drop", "sensor_angle", "overshoot"), "drive"),
)
"""What a record is about that is unlike anything known, by the beginnings of the features."""
SPEEDS = ("full", "quarter")
STRANGER = "stranger"
"""Beginning of the names of what else befalls actuators, which is no class of fault."""


def languages() -> list[str]:
    """Return the languages that are shipped."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


class Words:
    """One table of words; a key is a path through it, e.g. ``fault.backlash.name``."""

    def __init__(
        self, table: Mapping[str, str], rest: Words | None = None, file: Path | None = None
    ) -> None:
        """Take a flat table, the one that has what it lacks, and the file that it is of."""
        self.table, self._rest, self._file = table, rest, file

    def has(self, key: str) -> bool:
        """Return whether there is such a text."""
        return key in self.table or (self._rest is not None and self._rest.has(key))

    def __call__(self, key: str, **values: object) -> str:
        """Return the text of a key with `values` put in; empty where there is none."""
        text = self.table.get(key)
        if text is None:
            return self._rest(key, **values) if self._rest is not None else ""
        try:
            return text.format(**values)
        except (KeyError, IndexError, ValueError, AttributeError):
            raise UsageError(f"{self._file or 'words'}: {key}: {text[:60]!r}: expected the places "
                             f"{', '.join(sorted(values)) or 'none'}") from None

    def below(self, key: str) -> list[str]:
        """Return the names right below a key, in order."""
        known = [] if self._rest is None else self._rest.below(key)
        own = [k.removeprefix(f"{key}.").partition(".")[0] for k in self.table
               if k.startswith(f"{key}.")]
        return list(dict.fromkeys([*known, *own]))


def words(language: str | None = None) -> Words:
    """Return the words of a language, or of the file that it names; None: `$EMA_LANG`."""
    name = os.environ.get(ENVIRONMENT, "") if language is None else language
    return _words(name or ENGLISH)


@cache
def _words(name: str) -> Words:
    if name.endswith((".yaml", ".yml")):
        return Words(_flat(Path(name)), _words(ENGLISH), Path(name))
    short = name.partition(".")[0].partition("_")[0].lower()
    short = ENGLISH if short in ("c", "posix") else short
    if short not in languages():
        raise unknown_name("language", name, languages(),
                           f"give one of {', '.join(languages())}, or a file of words")
    table = _flat(FOLDER / f"{short}.yaml")
    return Words(table, None if short == ENGLISH else _words(ENGLISH))


def _is_plain(text: str) -> bool:
    """Return whether the places of a text are bare names: no width, no part of a value."""
    try:
        return all(name is None or (name.isidentifier() and not form and not conversion)
                   for _, name, form, conversion in Formatter().parse(text))
    except ValueError:
        return False


def _flat(path: Path) -> dict[str, str]:
    """Return the texts of a YAML file by their paths in it."""
    from ema_record.yaml_file import load_yaml

    found: dict[str, str] = {}

    def walk(value: object, key: str) -> None:
        if isinstance(value, dict):
            for name, inner in value.items():
                walk(inner, f"{key}.{name}" if key else str(name))
        elif isinstance(value, str):
            if not _is_plain(value):
                raise UsageError(f"{path}: {key}: {value[:60]!r}: a place is a name in braces and "
                                 "nothing else ('{name}'); a brace itself is written twice")
            found[key] = value
        else:
            raise UsageError(f"{path}: {key or 'words'}: expected texts (value "
                             f"{str(value)[:40]}): put it in quotes")

    walk(load_yaml(path), "")
    return found


def name_of(fault_class: str, language: str | None = None) -> str:
    """Return the name of a class of fault."""
    return words(language)(f"fault.{fault_class}.name") or fault_class


def class_name(fault_class: str, phase: str | None = None) -> str:
    """Return a fault in words: ``turn short, phase b``."""
    return name_of(fault_class) + (words()("phase", phase=phase) if phase else "")


def scaled(
    fault_class: str, unit: str | None = None, language: str | None = None
) -> tuple[float, str]:
    """Return factor and unit of a severity; `unit` is that of a class not known here."""
    if fault_class not in SCALES:
        return 1.0, unit or ""
    return SCALES[fault_class], words(language)(f"fault.{fault_class}.unit")


def size(fault_class: str, value: float | None, language: str | None = None) -> str:
    """Return a severity in the unit that people read, or a dash."""
    factor, unit = scaled(fault_class, None, language)
    return "-" if value is None else f"{factor * value:.3g} {unit}"


def severity_words(
    fault_class: str, severity: float | None, interval: Sequence[float] | None = None
) -> str:
    """Return a severity with its interval, short: ``9.92 % (9.28 to 10.6)``."""
    if severity is None:
        return ""
    scale, unit = scaled(fault_class)
    text = f"{scale * severity:.3g} {unit.partition(' ')[0]}".rstrip()
    if interval:
        text += f" ({scale * interval[0]:.3g} to {scale * interval[1]:.3g})"
    return text


def fault_words(
    fault_class: str, phase: str | None, severity: float | None,
    interval: Sequence[float] | None,
) -> str:
    """Return a fault in words: its class, phase and severity."""
    named = class_name(fault_class, phase)
    return f"{named} {severity_words(fault_class, severity, interval)}".rstrip()


def look_alike(named: Iterable[str], other: str) -> str:
    """Return an alternative in words, beside the classes that are named."""
    say = words()
    keys = (f"alternative.{name}.{other}.name" for name in named)
    return next((say(key) for key in keys if say.has(key)), name_of(other))


def step_kind(feature: str) -> str:
    """Return what a feature that is unlike anything known is about, e.g. ``sensor``; or empty."""
    return next((kind for names, kind in STEP_KINDS if feature.startswith(names)), "")


def next_step(feature: str) -> str:
    """Return what to do where a feature is unlike anything known, in English."""
    return words(ENGLISH)(f"next_steps.{step_kind(feature) or 'repeat'}")


def feature_words(name: str, language: str | None = None) -> str:
    """Return what the feature `name` is, in words."""
    say = words(language)
    if name.startswith("group."):
        return say("together", features=say(name))
    if say.has(f"feature.{name}"):
        return say(f"feature.{name}")
    if name.startswith("lag_start_"):
        return say("feature.lag_start")
    stem = name.removesuffix("_re").removesuffix("_im")
    body, _, line = stem.rpartition("_m")
    for speed in SPEEDS:
        if body in (f"{speed}_even", f"{speed}_odd") and line.isdecimal():
            kind = "torque_ripple" if body.endswith("even") else "sensor_ripple"
            times = say(f"times.{line}") or say("times.n", n=line)
            return say(f"feature.{kind}", times=times, speed=say(f"speed.{speed}"))
        if name.endswith((f"_{speed}", f"_{speed}_back")):
            stem = name.removesuffix("_back").removesuffix(f"_{speed}")
            if say.has(f"feature.{stem}"):
                return f"{say(f'feature.{stem}')}, {say(f'speed.{speed}')}"
    winding = body if body in ("resistance", "inductance") else ""
    return say(f"feature.{winding}_spread") if winding else name.replace("_", " ")
