"""Parameters of the nodes as data: type, default, bounds, meaning; and what values are right.

Needs no ROS: a node turns each `ParameterSpec` into a descriptor of its client library.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ema_record.errors import UsageError, unknown_name

Value = float | int | str | bool

USE_SIM_TIME = "use_sim_time"
BUILT_IN = (USE_SIM_TIME, "start_type_description_service")
"""Parameters that every node of the client library has."""
BUILT_IN_PREFIX = "qos_overrides."


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterSpec:
    """One declared parameter; its type is that of its default."""

    name: str
    default: Value
    text: str
    unit: str = ""
    lower: float | None = None
    upper: float | None = None
    options: tuple[str, ...] = ()
    read_only: bool = False

    @property
    def description(self) -> str:
        """What it means, with unit or options."""
        if self.options:
            return f"{self.text} ({', '.join(self.options)})"
        return f"{self.text} ({self.unit})" if self.unit else self.text

    def check(self, value: Any) -> Value:
        """Return `value` in the type of the default (an integer serves as a float).

        Raises
        ------
        UsageError
            Wrong type, out of bounds, or none of the options.
        """
        if isinstance(self.default, float) and type(value) is int:
            value = float(value)
        if type(value) is not type(self.default):
            remedy = f"for example {self.default!r}" if self.default or not isinstance(
                self.default, str) else f"""quote a text of digits, {self.name}:="'0042'\""""
            raise UsageError(
                f"parameter {self.name}: {str(value)[:60]!r} is a {type(value).__name__}, "
                f"expected {type(self.default).__name__}: {remedy}"
            )
        if self.options and value not in self.options:
            raise unknown_name(
                f"value of parameter {self.name}", str(value), self.options,
                f"choose one of {', '.join(self.options)}",
            )
        if (
            isinstance(value, float | int)
            and self.lower is not None
            and self.upper is not None
            and not (math.isfinite(value) and self.lower <= value <= self.upper)
        ):
            unit = f" {self.unit}" if self.unit not in ("", "1") else ""
            raise UsageError(
                f"parameter {self.name}: {value:g}{unit} is out of bounds: "
                f"give {self.lower:g} to {self.upper:g}{unit}"
            )
        checked: Value = value
        return checked


KIT = ParameterSpec(
    name="kit", default="", read_only=True,
    text="folder of the kit of this type of actuator; empty: $EMA_KIT, else the default one's",
)
"""Parameter of every node; it counts before all others."""

AUTOSTART = ParameterSpec(
    name="autostart", default=True, read_only=True,
    text="configure and activate the node by itself; false: wait for the lifecycle services",
)
"""Parameter of every node."""


def check_values(specs: Iterable[ParameterSpec], given: Mapping[str, Any]) -> dict[str, Value]:
    """Return the values of all parameters: those given, checked, else the defaults.

    Raises
    ------
    UsageError
        A name that no parameter has (the nearest one is named), a wrong value, or simulated
        time.
    """
    known = {spec.name: spec for spec in specs}
    if given.get(USE_SIM_TIME):
        raise UsageError(
            f"parameter {USE_SIM_TIME}: true is not supported: stamps are of the host's clock: "
            "leave it false"
        )
    for name in given:
        if name not in known and name not in BUILT_IN and not name.startswith(BUILT_IN_PREFIX):
            raise unknown_name(
                "parameter", name, known, "'ros2 param list' or 'ema effects' lists them"
            )
    return {
        name: spec.check(given[name]) if name in given else spec.default
        for name, spec in known.items()
    }
