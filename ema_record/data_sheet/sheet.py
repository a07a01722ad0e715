"""A data sheet: the values that were given, and the choices beside them."""

from __future__ import annotations

from typing import NamedTuple

from ema_record.actuator import DRIVES
from ema_record.data_sheet.constants import CURRENTS, SHAPES, VOLTAGES
from ema_record.data_sheet.quantities import QUANTITIES, Given, read_quantity
from ema_record.errors import UsageError, unknown_name

CHANNELS = ("phase_current_c", "reference_currents", "rotor_angle", "surface_position")
"""What a recorder may lack."""
CONSTANTS = ("kv", "back-emf", "torque-constant", "no-load-speed")
"""Options of which one at least states the constant of the motor."""
CHOICES = {"drive": DRIVES, "shape": SHAPES, "voltage-is": VOLTAGES, "current-is": CURRENTS}


class DataSheet(NamedTuple):
    """What is known of an actuator, values by the names of `QUANTITIES`."""

    given: dict[str, Given]
    drive: str = ""
    """Empty: assumed by the shape."""
    shape: str = "sine"
    shape_given: bool = False
    voltage_is: str = "mean"
    current_is: str = "block"
    without: tuple[str, ...] = ()
    """Channels that are not recorded."""
    name: str = ""

    def has(self, name: str) -> bool:
        """Whether the data sheet states it."""
        return name in self.given

    def value(self, name: str, default: float) -> float:
        """Return a value (SI), or the default where it is not stated."""
        return self.given[name].value if name in self.given else default


def missing(texts: dict[str, str]) -> list[str]:
    """Return the options that are needed and not among `texts`."""
    found = [name for name, kind in QUANTITIES.items() if kind.needed and name not in texts]
    return found if any(name in texts for name in CONSTANTS) else [*found, CONSTANTS[0]]


def read_sheet(
    texts: dict[str, str], choices: dict[str, str], without: tuple[str, ...] = (), name: str = ""
) -> DataSheet:
    """Return the data sheet of options as they were written.

    Parameters
    ----------
    texts : value with its unit, by the names of `QUANTITIES`.
    choices : by the names of `CHOICES`; left out or empty: the default.
    without : channels that are not recorded.
    name : of the motor, for the head of the file.

    Raises
    ------
    UsageError
        A value is missing, has no unit, is not possible, or a word is not known.
    """
    for option, word in choices.items():
        if word and word not in CHOICES[option]:
            raise unknown_name(f"word of --{option}", word, CHOICES[option],
                               f"one of {', '.join(CHOICES[option])}")
    for channel in without:
        if channel not in CHANNELS:
            raise unknown_name("channel of --without", channel, CHANNELS,
                               f"one of {', '.join(CHANNELS)}; the others are always recorded")
    given = {option: read_quantity(option, text) for option, text in texts.items()}
    lacking = missing(texts)
    if lacking:
        words = [f"--{option} ({QUANTITIES[option].example})" for option in lacking
                 if option not in CONSTANTS]
        if len(words) < len(lacking):
            words.append(f"a constant (one of --{', --'.join(CONSTANTS)})")
        raise UsageError(f"the data sheet lacks {', '.join(words)}: give them, or answer the "
                         "questions at a terminal")
    shape = choices.get("shape") or ""
    return DataSheet(
        given, choices.get("drive") or "", shape or SHAPES[0], bool(shape),
        choices.get("voltage-is") or VOLTAGES[0], choices.get("current-is") or CURRENTS[0],
        tuple(without), name)
