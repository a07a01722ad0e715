"""What an effect declares: parameters with units, bounds and neutral defaults; port; source.

An effect is one file with a NamedTuple of parameters, one `EFFECT` description and the laws
(numba functions) that `ema_sim.plant.ports` sums at the effect's port. An effect is neutral while
its severity parameters hold their defaults.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

Port = Literal[
    "winding", "commutation", "motor torque", "friction", "transmission", "load", "supply",
    "sensor", "controller",
]

AllEffects = Any
"""`registry.Effects` as the laws see it: they know the effects that they use, not the registry,
which knows all of them."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with unit and bounds."""

    unit: str
    lower: float
    upper: float
    text: str


@dataclass(frozen=True, slots=True)
class Choice:
    """A named option; it enters the kernel as its index."""

    options: tuple[str, ...]
    text: str


class Field(NamedTuple):
    """One parameter of an effect, as users see it."""

    name: str
    kind: Quantity | Choice
    default: float | int

    @property
    def default_text(self) -> str:
        """The neutral value in words."""
        if isinstance(self.kind, Choice):
            return self.kind.options[int(self.default)]
        return f"{self.default:g}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """One physical effect of the catalogue."""

    name: str
    parameters: type
    """NamedTuple class; its defaults are neutral."""
    port: Port
    severity: tuple[str, ...]
    """Parameters that switch the effect on when they leave their defaults."""
    equation: str
    reference: str
    fault_class: str | None = None
    """Class of the verdict that this effect belongs to, if it is a fault of its own."""

    @property
    def summary(self) -> str:
        """First line of the documentation."""
        return (self.parameters.__doc__ or "").strip().split("\n")[0]

    @property
    def fields(self) -> tuple[Field, ...]:
        """The parameters with units and bounds, in order."""
        return _fields(self.parameters)

    def is_neutral(self, values: Any) -> bool:
        """Whether `values` (an instance of `parameters`) leaves the actuator untouched."""
        defaults = self.parameters()
        return all(getattr(values, s) == getattr(defaults, s) for s in self.severity)


@cache
def _fields(parameters: type) -> tuple[Field, ...]:
    hints: dict[str, Any] = get_type_hints(parameters, include_extras=True)
    defaults = parameters()
    found = []
    for name in parameters._fields:  # type: ignore[attr-defined]
        args = get_args(hints[name]) if get_origin(hints[name]) is not None else ()
        kind = next(a for a in args if isinstance(a, Quantity | Choice))
        found.append(Field(name, kind, getattr(defaults, name)))
    return tuple(found)
