"""Everything by one import: ``import ema_phm as ema``.

``ema.read``, ``simulate``, ``diagnose``, ``identify``, ``trend``, ``fleet``, ``plot``; paths and
names are accepted everywhere. Nothing is loaded before it is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ema_identification.result import Identification
    from ema_phm.api import (
        diagnose,
        effects,
        fleet,
        identify,
        plot,
        profiles,
        read,
        rig,
        simulate,
        to_json,
        trend,
        write,
    )
    from ema_prognostics.fleet.fleet import Fleet
    from ema_prognostics.trend.unit_trend import UnitTrend
    from ema_prognostics.verdict.verdict import Verdict
    from ema_record.errors import EmaError, RecordError, UsageError
    from ema_record.kit import use_kit, using_kit
    from ema_record.record import Record
    from ema_record.version import VERSION as __version__
    from ema_rig.record import RigRecord

_PLACES = {
    **dict.fromkeys(("diagnose", "effects", "fleet", "identify", "plot", "profiles", "read", "rig",
                     "simulate", "to_json", "trend", "write"), "ema_phm.api"),
    "Fleet": "ema_prognostics.fleet.fleet", "Identification": "ema_identification.result",
    "Record": "ema_record.record", "RigRecord": "ema_rig.record",
    "UnitTrend": "ema_prognostics.trend.unit_trend",
    "Verdict": "ema_prognostics.verdict.verdict",
    "EmaError": "ema_record.errors", "RecordError": "ema_record.errors",
    "UsageError": "ema_record.errors", "use_kit": "ema_record.kit",
    "using_kit": "ema_record.kit", "__version__": "ema_record.version",
}
"""Module of each name."""

__all__ = [  # noqa: RUF022  (what is used first stands first)
    "read", "write", "rig", "simulate", "diagnose", "identify", "trend", "fleet", "plot",
    "effects", "profiles", "to_json", "Record", "RigRecord", "Verdict", "Identification",
    "UnitTrend", "Fleet", "EmaError", "UsageError", "RecordError", "use_kit", "using_kit",
    "__version__",
]


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        near = [known for known in __all__ if known.startswith(name[:3])]
        raise AttributeError(f"module 'ema_phm' has no {name!r}: it has "
                             f"{', '.join(near or __all__)}")
    module = import_module(_PLACES[name])
    found: object = getattr(module, "VERSION" if name == "__version__" else name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
