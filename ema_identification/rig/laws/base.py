"""`Law`: one physical effect as regressors of the balance at the input port."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ema_identification.rig.signals.trajectory import Segment, Trajectory
from ema_rig.record import LOAD_QUANTITY, Axis

Shape = tuple[float, ...]
"""Values of the parameters in which a law is not linear, in the order of `Law.shape`."""
Columns = Callable[[Segment, Trajectory, Shape], Sequence[np.ndarray]]
LEAST_PART, MOST_PART = 0.2, 0.9
LOCATED = 0.05
Grid = Callable[[Trajectory], Sequence[Shape]]


@dataclass(frozen=True, kw_only=True)
class Law:
    """One effect: ``input = ... + sum of coefficient times column``.

    No column contains the measured input.
    """

    name: str
    meaning: str
    """Half a sentence for people."""
    equation: str
    reference: str
    against: str
    """What it lives against: ``speed``, ``position``, ``load``, ``frequency``, ``test phase``."""
    coefficients: tuple[str, ...]
    """Names of the linear parameters; ``("cosine", "sine")`` are shown as amplitude and phase."""
    units: Mapping[str, str]
    """Of all parameters; ``u``, ``x``, ``v`` and ``a`` stand for input, position, speed and
    acceleration, with ``/`` and ``*`` between them."""
    columns: Columns
    shape: tuple[str, ...] = ()
    grid: Grid = field(default=lambda _t: ((),))
    requires: tuple[str, ...] = ()
    """Laws without which it has no meaning."""
    applies: Callable[[Trajectory], bool] = field(default=lambda _t: True)
    of_prediction: bool = False
    """Whether its columns are made of what the other terms predict (`Trajectory` carries it)."""
    linear: bool = True
    """Whether columns made of a prediction are linear in it."""
    periodic: bool = False
    looked_for: bool = False
    """Whether its shapes come from peaks of the residual, not from its grid alone."""
    equivalent: Callable[[Axis, Shape], tuple[str, ...]] = field(default=lambda _a, _s: ())
    """Names whose law is the same expression on such an axis."""
    positive: bool = False
    """Whether its coefficients cannot be negative: friction takes energy, inertia is positive."""
    sharpens: bool = False
    """Whether the law that it requires may only be seen together with it."""
    joins: tuple[str, ...] = ()
    """Laws together with which it is tried too: neither may be seen alone, of two that bend a
    friction the other way."""
    dynamic: bool = False
    """Whether it filters the motion or the whole prediction, and so takes a share of anything."""
    part_of: str = ""
    """A law with the same unit of which this one's coefficient is a part, `LEAST_PART` at least
    and `MOST_PART` at most."""
    located: str = ""
    """A parameter that must be known within `LOCATED` of itself, or it is not this law."""
    excludes: tuple[str, ...] = ()
    """Laws beside which it cannot be told from them."""
    beside: Mapping[str, str] = field(default_factory=dict)
    """Laws beside which one of its coefficients, named, must differ from zero: without it, what
    it takes is what their shape lacks."""
    repeats: bool = False
    """Whether several terms of it, with other shapes, make sense."""

    @property
    def in_position(self) -> bool:
        """Whether it is a force or torque that is periodic in position."""
        return self.periodic and self.against == "position"

    @property
    def takes_of_all(self) -> bool:
        """Whether it can take a little of any residual: a filter, or picked from the residual."""
        return self.dynamic or self.of_prediction or self.looked_for

    @property
    def complexity(self) -> int:
        """Number of free parameters; one more where it leans on all of the model's terms."""
        return len(self.coefficients) + len(self.shape) + self.of_prediction


@dataclass(frozen=True, kw_only=True)
class Term:
    """A law with its shape chosen."""

    law: Law
    shape: Shape = ()

    @property
    def key(self) -> tuple[str, Shape]:
        """What it is told from others by."""
        return self.law.name, tuple(float(f"{value:.9g}") for value in self.shape)


def unit_of(pattern: str, axis: Axis) -> str:
    """Return the unit of a parameter on an axis, for people.

    >>> unit_of("u/v", Axis(name="r", motion="linear", input="force"))
    'N s/m'
    """
    length = axis.position_unit
    base = axis.input_channel.unit
    known = {
        "u": base, "x": length, "v": f"{length}/s", "a": f"{length}/s²", "1": "1", "s": "s",
        "Hz": "Hz",
        "1/turn": "a turn" if axis.motion == "rotary" else f"1/{length}", "rad": "rad",
        "u/v": f"{base} s/{length}", "u/a": f"{base} s²/{length}", "u/x": f"{base}/{length}",
        "u/x³": f"{base}/{length}³",
        "u/v²": f"{base} s²/{length}²", "u/v^0.5": f"{base} (s/{length})^0.5",
        "u*s²/a": f"{base} s⁴/{length}",
    }
    if pattern == "u/a" and axis.input == LOAD_QUANTITY[axis.motion]:
        return "kg" if axis.motion == "linear" else "kg m²"
    return known[pattern]


def sign(segment: Segment, trajectory: Trajectory) -> np.ndarray:
    """Return the direction of motion, 0 at standstill, shape (n,)."""
    speed = segment.smooth_speed
    return np.where(np.abs(speed) < 0.5 * trajectory.standstill, 0.0, np.sign(speed))


def physical(law: Law, shape: Sequence[float], coefficients: np.ndarray) -> dict[str, float]:
    """Return all parameters of a term by name.

    Of periodic ones amplitude and phase: ``cosine cos(y) + sine sin(y) = A cos(y - phase)``.
    """
    named = dict(zip(law.shape, (float(value) for value in shape)))
    if law.periodic:
        cosine, sine = map(float, coefficients)
        return {**named, "amplitude": math.hypot(cosine, sine), "phase": math.atan2(sine, cosine)}
    return {**named, **dict(zip(law.coefficients, (float(c) for c in coefficients)))}
