"""Units that a map may name, with what they are in SI."""

from __future__ import annotations

import math

from ema_record.errors import UsageError, unknown_name

_TURN = 2.0 * math.pi
_DEGREE = math.pi / 180.0

UNITS: dict[str, tuple[str, float]] = {
    # unit: (what it measures, SI value of one)
    "s": ("time", 1.0), "ms": ("time", 1e-3), "us": ("time", 1e-6), "ns": ("time", 1e-9),
    "min": ("time", 60.0), "h": ("time", 3600.0),
    "m": ("length", 1.0), "cm": ("length", 1e-2), "mm": ("length", 1e-3), "um": ("length", 1e-6),
    "in": ("length", 0.0254), "ft": ("length", 0.3048), "km": ("length", 1e3),
    "rad": ("angle", 1.0), "mrad": ("angle", 1e-3), "deg": ("angle", _DEGREE),
    "rev": ("angle", _TURN), "turn": ("angle", _TURN),
    "m/s": ("linear speed", 1.0), "cm/s": ("linear speed", 1e-2), "mm/s": ("linear speed", 1e-3),
    "m/min": ("linear speed", 1.0 / 60.0), "mm/min": ("linear speed", 1e-3 / 60.0),
    "in/s": ("linear speed", 0.0254), "ft/s": ("linear speed", 0.3048),
    "km/h": ("linear speed", 1.0 / 3.6), "mph": ("linear speed", 0.44704),
    "rad/s": ("angular speed", 1.0), "mrad/s": ("angular speed", 1e-3),
    "deg/s": ("angular speed", _DEGREE), "rev/s": ("angular speed", _TURN),
    "turn/s": ("angular speed", _TURN), "rev/min": ("angular speed", _TURN / 60.0),
    "rpm": ("angular speed", _TURN / 60.0), "1/min": ("angular speed", _TURN / 60.0),
    "U/min": ("angular speed", _TURN / 60.0), "krpm": ("angular speed", 1e3 * _TURN / 60.0),
    "V": ("voltage", 1.0), "mV": ("voltage", 1e-3), "kV": ("voltage", 1e3),
    "A": ("current", 1.0), "mA": ("current", 1e-3), "kA": ("current", 1e3),
    "N": ("force", 1.0), "mN": ("force", 1e-3), "kN": ("force", 1e3),
    "lbf": ("force", 4.4482216152605), "kgf": ("force", 9.80665),
    "N m": ("torque", 1.0), "Nm": ("torque", 1.0), "N*m": ("torque", 1.0),
    "mN m": ("torque", 1e-3), "mNm": ("torque", 1e-3), "kN m": ("torque", 1e3),
    "N cm": ("torque", 1e-2), "Ncm": ("torque", 1e-2), "kNm": ("torque", 1e3),
    "lbf in": ("torque", 0.1129848290276), "lbf ft": ("torque", 1.3558179483314),
    "ozf in": ("torque", 0.00706155182),
}

SI_OF = {"time": "s", "length": "m", "angle": "rad", "linear speed": "m/s",
         "angular speed": "rad/s", "voltage": "V", "current": "A", "force": "N",
         "torque": "N m"}
_SIGNS = str.maketrans({"\u00b7": " ", "\u00b0": "deg", "\u00b5": "u", "\u03bc": "u"})
"""Unicode has two signs of micro."""


def _plain(unit: str) -> str:
    """Return a unit as `UNITS` writes it."""
    return " ".join(unit.translate(_SIGNS).split())


def is_unit(text: str) -> bool:
    """Return whether a text is a unit that a map may name."""
    return _plain(text) in UNITS


def find_unit(text: str) -> str | None:
    """Return the unit that a word of a header means, also in letters of another size, or None."""
    name = _plain(text.strip(" []()"))
    if name in UNITS:
        return name
    alike = [unit for unit in UNITS if unit.lower() == name.lower()]
    return alike[0] if len(alike) == 1 else None


def unit_factor(unit: str, quantity: str, where: str) -> float:
    """Return the SI value of one `unit`.

    Parameters
    ----------
    unit : as in the map.
    quantity : what it must measure, a value of `SI_OF`'s keys.
    where : origin, for errors.

    Raises
    ------
    UsageError
        Unknown, or of another quantity.
    """
    name = _plain(unit)
    if name not in UNITS:
        raise unknown_name("unit", unit[:40], UNITS, f"{where}: docs/rigs.md lists the units")
    found, factor = UNITS[name]
    if found != quantity:
        good = ", ".join(n for n, (q, _) in UNITS.items() if q == quantity)
        raise UsageError(f"{where}: unit {unit!r} measures {found}, expected {quantity}: {good}")
    return factor
