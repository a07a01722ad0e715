"""The catalogue of physical effects: faults, disturbances, what a model may lack.

To add one: its file, one field of `registry.Effects`, one term at its port in
`ema_sim.plant.ports`.
"""

from __future__ import annotations

from ema_sim.effects.base import Choice, Effect, Field, Quantity
from ema_sim.effects.registry import EFFECTS, Effects
from ema_sim.effects.settings import parse_effects

__all__ = ["EFFECTS", "Choice", "Effect", "Effects", "Field", "Quantity", "parse_effects"]
