"""Faults for training: drawn from one seed, as plain data.

The benchmark has a generator of its own and imports nothing from here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ema_prognostics.cascade.classes import FAULTS, OUTPUTS, scale_of

SEVERITY: dict[str, tuple[float, float]] = {
    "turn_short": (1e-3, 0.4), "rotor_eccentricity": (5e-4, 0.2), "friction": (0.01, 4.0),
    "backlash": (0.2, 40.0),
}
"""Least and largest severity, drawn evenly in its logarithm, in `classes.scale_of`: friction up to
more than most machines can turn, which then give no record."""
MODES = ("paper", "common", "shifted")


class Stranger(NamedTuple):
    """What an example of no class is of."""

    kind: str
    sign: float = 1.0
    """-1 where the quantity is off to the other side."""
    phase: int = 0
    """0 to 2, of a kind that is of one phase."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InjectedFault:
    """What is wrong: severities of the outputs, and the settings that inject it."""

    severity: Mapping[str, float] = field(default_factory=dict)
    settings: tuple[str, ...] = ()
    stranger: Stranger | None = None
    """None: it is of a class, or nothing is wrong."""


HEALTHY = InjectedFault()


def _severity(rng: np.random.Generator, fault: str) -> float:
    low, high = SEVERITY[fault]
    return scale_of(fault) * float(np.exp(rng.uniform(math.log(low), math.log(high))))


def draw_fault(rng: np.random.Generator, fault: str) -> InjectedFault:
    """Return a fault of the class `fault`; `static` is eccentricity fixed in the stator."""
    if fault == "healthy":
        return HEALTHY
    phase = int(rng.integers(3))
    if fault == "turn_short":
        x = _severity(rng, fault)
        mode = ("paper", "physical", "physical")[int(rng.integers(3))]
        return InjectedFault(severity={OUTPUTS[phase]: x}, settings=(
            f"turn_short.fraction={x!r}", f"turn_short.phase={'abc'[phase]}",
            f"turn_short.mode={mode}",
        ))
    if fault == "static":
        z = _severity(rng, "rotor_eccentricity")
        return InjectedFault(severity={"static_eccentricity": z}, settings=(
            f"rotor_eccentricity.zeta={z!r}", "rotor_eccentricity.mode=static",
            f"rotor_eccentricity.angle={float(rng.uniform(-math.pi, math.pi))!r}",
        ))
    if fault == "rotor_eccentricity":
        z = _severity(rng, fault)
        mode = MODES[int(rng.integers(3))]
        sign = (-1.0, 1.0)[int(rng.integers(2))]
        return InjectedFault(severity={"eccentricity": z}, settings=(
            f"rotor_eccentricity.zeta={sign * z!r}", f"rotor_eccentricity.mode={mode}",
            f"rotor_eccentricity.angle={float(rng.uniform(-math.pi, math.pi))!r}",
            f"rotor_eccentricity.phase={'abc'[phase]}",
        ))
    if fault == "friction":
        name = ("motor_friction", "surface_friction")[int(rng.integers(2))]
        x = _severity(rng, fault)
        return InjectedFault(severity={name: x}, settings=(f"{name}.increase={x!r}",))
    x = _severity(rng, "backlash")
    return InjectedFault(severity={"backlash": x}, settings=(f"backlash.increase={x!r}",))


def draw_pair(rng: np.random.Generator) -> InjectedFault:
    """Return two faults of different classes at once."""
    first, second = rng.choice(4, size=2, replace=False)
    a, b = draw_fault(rng, FAULTS[first]), draw_fault(rng, FAULTS[second])
    return InjectedFault(severity={**a.severity, **b.severity}, settings=a.settings + b.settings)
