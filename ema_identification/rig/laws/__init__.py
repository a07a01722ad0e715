"""The catalogue of a rig's laws: what its model may have, and what it may lack."""

from __future__ import annotations

from ema_identification.rig.laws.base import Law, Shape, Term, unit_of
from ema_identification.rig.laws.dynamics import (
    BACKLASH,
    COMPLIANCE,
    DEAD_ZONE,
    DELAY,
    HYSTERESIS,
    LAG,
    LOAD_SIDE_COMPLIANCE,
    PERIODIC_DISTURBANCE,
)
from ema_identification.rig.laws.static import (
    ASYMMETRIC_FRICTION,
    COGGING_TORQUE,
    COULOMB_FRICTION,
    DISTURBANCE,
    END_STOP,
    END_STOPS,
    GRAVITY,
    HARDENING_SPRING,
    INERTIA,
    LOAD_DEPENDENT_FRICTION,
    OFFSET,
    OUTER_LOAD_FRICTION,
    POSITION_DEPENDENT_FRICTION,
    POSITION_DEPENDENT_INERTIA,
    QUADRATIC_DRAG,
    SPRING,
    STRIBECK_FRICTION,
    SUBLINEAR_VISCOUS_FRICTION,
    VISCOUS_FRICTION,
)

LAWS: dict[str, Law] = {
    law.name: law
    for law in (
        INERTIA, VISCOUS_FRICTION, DISTURBANCE, COULOMB_FRICTION, OFFSET, STRIBECK_FRICTION,
        QUADRATIC_DRAG, SUBLINEAR_VISCOUS_FRICTION, ASYMMETRIC_FRICTION, LOAD_DEPENDENT_FRICTION,
        OUTER_LOAD_FRICTION, POSITION_DEPENDENT_FRICTION, SPRING, GRAVITY,
        COGGING_TORQUE, HARDENING_SPRING, END_STOP, END_STOPS,
        HYSTERESIS, BACKLASH, COMPLIANCE, DEAD_ZONE, DELAY, LAG,
        LOAD_SIDE_COMPLIANCE, PERIODIC_DISTURBANCE, POSITION_DEPENDENT_INERTIA,
    )
}
"""All laws by name."""

__all__ = ["LAWS", "Law", "Shape", "Term", "unit_of"]
