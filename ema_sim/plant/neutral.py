"""Which groups of effects are absent, so that the kernel may leave their terms out.

A neutral effect adds 0 or multiplies by 1; leaving it out gives the same bits in less time.
"""

from __future__ import annotations

from ema_sim.effects.base import AllEffects
from ema_sim.effects.compile import law


@law
def friction_is_steady(e: AllEffects) -> bool:
    """Whether the dry friction of the motor depends on neither speed nor load."""
    return e.stribeck_friction.increase == 0.0 and e.load_dependent_friction.coefficient == 0.0


@law
def rotation_is_smooth(e: AllEffects) -> bool:
    """Whether rotor and gear turn without cogging, ripple and the drag of a short."""
    return (
        e.gear_mesh_ripple.amplitude == 0.0
        and e.cogging_torque.amplitude == 0.0
        and e.turn_short.fraction == 0.0
    )


@law
def inverter_is_ideal(e: AllEffects) -> bool:
    """Whether rails and switches drop no voltage."""
    return e.bus_voltage_sag.resistance == 0.0 and e.inverter_voltage_drop.drop == 0.0
