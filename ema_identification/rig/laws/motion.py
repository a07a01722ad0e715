"""Laws that are linear in what a rigid axis always has: inertia, viscous friction, load."""

from __future__ import annotations

from ema_identification.rig.laws.base import Law
from ema_record.rig import Axis


def _with_back_emf(axis: Axis, _shape: tuple[float, ...]) -> tuple[str, ...]:
    return ("back_emf",) if axis.input == "voltage" else ()


INERTIA = Law(
    name="inertia", meaning="inertia of everything that moves",
    equation="u = J a", reference="Newton's second law",
    against="load", coefficients=("value",), units={"value": "u/a"},
    columns=lambda segment, _t, _s: (segment.acceleration,), positive=True,
)
VISCOUS_FRICTION = Law(
    name="viscous_friction", meaning="friction in proportion to speed",
    equation="u = B v; a voltage also drives against the back-EMF, which is in proportion too",
    reference="Armstrong-Hélouvry et al. 1994, Automatica 30(7)",
    against="speed", coefficients=("value",), units={"value": "u/v"},
    columns=lambda segment, _t, _s: (segment.speed,), equivalent=_with_back_emf,
    positive=True,
)
DISTURBANCE = Law(
    name="disturbance", meaning="the known force or torque from outside, which helps the input",
    equation="u + g d = J a + ...; g = 1 where input and disturbance have one unit",
    reference="balance of the axis",
    against="load", coefficients=("gain",), units={"gain": "1"},
    columns=lambda segment, _t, _s: (-segment.disturbance,),
    applies=lambda trajectory: trajectory.has_disturbance,
)
