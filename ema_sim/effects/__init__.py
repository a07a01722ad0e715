"""The catalogue of physical effects: faults, disturbances, what a model may lack.

To add one: its file, one field of `Effects` here, one term at its port in `ema_sim.ports`.
"""

from __future__ import annotations

import sys
from typing import NamedTuple, get_type_hints

from ema_sim.effects.backlash import Backlash
from ema_sim.effects.base import Choice, Effect, Field, Quantity
from ema_sim.effects.motor_friction import MotorFriction
from ema_sim.effects.rotor_eccentricity import RotorEccentricity
from ema_sim.effects.surface_friction import SurfaceFriction
from ema_sim.effects.turn_short import TurnShort
from ema_sim.effects.viscous_friction import ViscousFriction

__all__ = ["EFFECTS", "Choice", "Effect", "Effects", "Field", "Quantity"]


class Effects(NamedTuple):
    """Parameters of all effects; the defaults are neutral."""

    turn_short: TurnShort = TurnShort()
    rotor_eccentricity: RotorEccentricity = RotorEccentricity()
    motor_friction: MotorFriction = MotorFriction()
    surface_friction: SurfaceFriction = SurfaceFriction()
    viscous_friction: ViscousFriction = ViscousFriction()
    backlash: Backlash = Backlash()


EFFECTS: dict[str, Effect] = {
    name: sys.modules[parameters.__module__].EFFECT
    for name, parameters in get_type_hints(Effects).items()
}
"""The registry: descriptions by name, in the order of `Effects`."""

from ema_sim.effects.settings import parse_effects  # noqa: E402  (needs the registry above)

__all__ += ["parse_effects"]
