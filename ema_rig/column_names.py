"""What the name of a column says: its role, its unit, whether it is a reference."""

from __future__ import annotations

import re

from ema_rig.units import UNITS, find_unit

ROLES: dict[str, tuple[str, ...]] = {
    "time": ("time", "t", "timestamp", "stamp", "zeit", "seconds", "sec", "clock", "date",
             "datetime", "elapsed"),
    "input": ("torque", "effort", "current", "force", "voltage", "tau", "iq", "i", "u", "drive",
              "amps", "volt", "strom", "spannung", "moment", "kraft", "vir", "input"),
    "position": ("position", "pos", "angle", "q", "theta", "encoder", "enc", "qm", "x", "phi",
                 "winkel", "weg", "travel"),
    "speed": ("speed", "velocity", "vel", "omega", "w", "dq", "qd", "v", "rpm", "tacho",
              "drehzahl", "geschwindigkeit"),
}
"""Words that a column's name may be, the likelier first."""
_ANGLES = frozenset({"angle", "q", "theta", "qm", "phi", "winkel"})
"""Words of a position that is no length."""
REFERENCE = frozenset({"ref", "reference", "cmd", "command", "target", "set", "setpoint", "soll",
                       "desired", "des", "goal"})
"""Words of what was asked for."""
OTHER = frozenset({"error", "err", "temperature", "temp", "status", "mode", "limit", "max",
                   "min", "bus", "supply"})
"""Words of columns that are none of these."""
_BRACKET = re.compile(r"^(.*?)\s*[\[(/]\s*([^\])]+?)\s*[\])]?$")
_SAYS = {**dict.fromkeys(("torque", "tau", "moment"), "torque"),
         **dict.fromkeys(("current", "i", "iq", "amps", "strom"), "current"),
         **dict.fromkeys(("voltage", "u", "volt", "spannung"), "voltage"),
         **dict.fromkeys(("force", "kraft"), "force")}
"""Words that say themselves what is measured: the a of tau_a is no ampere."""
QUANTITIES = {"position": ("angle", "length"), "speed": ("angular speed", "linear speed"),
              "input": ("torque", "force", "current", "voltage"), "time": ("time",)}
"""What each may be measured in, of `units.UNITS`."""


def words_of(name: str) -> list[str]:
    """Return the words of a name, in small letters."""
    plain = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    return [word for word in re.split(r"[^a-z0-9]+", plain.lower()) if word]


def split_unit(name: str, given: str | None) -> tuple[str, str | None]:
    """Return the name without its unit, and the unit: of the header, in brackets, at its end."""
    if given is not None and find_unit(given) is not None:
        return name, find_unit(given)
    base, _, last = name.rpartition("_")
    if base and find_unit(last) is not None and _may_have(base, str(find_unit(last))):
        return base, find_unit(last)
    matched = _BRACKET.match(name)
    if matched and find_unit(matched[2]) is not None:
        return matched[1], find_unit(matched[2])
    return name, find_unit(name) if len(name) > 1 else None


def _may_have(base: str, unit: str) -> bool:
    """Return whether what a word says may have a unit: the m of theta_m is the motor, no metre."""
    words, quantity = set(words_of(base)), UNITS[unit][0]
    roles = [role for role, known in ROLES.items() if words & set(known)]
    fits = any(quantity in QUANTITIES[role] for role in roles)
    says = {_SAYS[word] for word in words & _SAYS.keys()}
    return (fits or not roles) and says <= {quantity} and not (
        quantity == "length" and (words & _ANGLES or unit == "in"))  # in: of the input side
