"""The catalogue of a rig's laws: what its model may have, and what it may lack."""

from __future__ import annotations

from ema_identification.rig.laws import dynamics, static
from ema_identification.rig.laws.base import Law

LAWS: dict[str, Law] = {
    law.name: law
    for law in (
        static.INERTIA, static.VISCOUS_FRICTION, static.DISTURBANCE, static.COULOMB_FRICTION,
        static.OFFSET, static.STRIBECK_FRICTION, static.QUADRATIC_DRAG,
        static.SUBLINEAR_VISCOUS_FRICTION, static.ASYMMETRIC_FRICTION,
        static.LOAD_DEPENDENT_FRICTION, static.OUTER_LOAD_FRICTION,
        static.POSITION_DEPENDENT_FRICTION, static.SPRING, static.GRAVITY, static.COGGING_TORQUE,
        static.HARDENING_SPRING, static.END_STOP, static.END_STOPS,
        dynamics.HYSTERESIS, dynamics.BACKLASH, dynamics.COMPLIANCE, dynamics.DEAD_ZONE,
        dynamics.DELAY, dynamics.LAG, dynamics.LOAD_SIDE_COMPLIANCE,
        dynamics.QUASI_STATIC_COMPLIANCE,
        dynamics.PERIODIC_DISTURBANCE, static.POSITION_DEPENDENT_INERTIA,
    )
}
"""All laws by name."""
