"""Coordinates of effects that act on the same number as a tolerance of the unit."""

from __future__ import annotations

ALIASES: dict[tuple[str, int], tuple[str, float]] = {
    ("motor_friction", 0): ("motor.dry_friction", 1.0),
    ("surface_friction", 0): ("surface.dry_friction", 1.0),
    ("torque_constant_drop", 0): ("motor.back_emf_constant", -1.0),
    **{(f"turn_short {p} {mode}", 0): (f"motor.back_emf_deviation_{p}", -1.0)
       for p in "abc" for mode in ("physical", "paper")},
    ("shaft_compliance", 0): ("shaft.stiffness", -1.0),
    ("inertia_change motor", 0): ("motor.inertia", 1.0),
    ("inertia_change surface", 0): ("surface.inertia", 1.0),
    **{("current_sensor_gain", k): (f"current_sensor_gain.phase_{p}", 0.0)
       for k, p in enumerate("abc")},
    **{("current_sensor_offset", k): (f"current_sensor_offset.phase_{p}", 0.0)
       for k, p in enumerate("abc")},
    ("surface_load", 0): ("surface_load.constant", 0.0),
}
"""Coordinates that act on the same number as a tolerance.

By variant and coordinate: the tolerance, and +1 where the number is in proportion to (1 + u),
-1 where to 1 - u (`TAKES_AWAY`) or 1 / (1 + u), 0 where u adds to it. Of a short it is the
constant of its phase; what resistance and inductance tell beside that is left to the fit.
"""
TAKES_AWAY = ("torque_constant_drop", "turn_short")
