"""Which test would separate what a record left open."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_identification.rig.trajectory import Trajectory

_TESTS: tuple[tuple[frozenset[str], str], ...] = (
    (frozenset({"offset", "asymmetric_friction"}),
     "constant-speed runs in both directions at three speeds or more: an offset stays the same, "
     "direction-dependent friction changes with speed; and one record with the drive on and the "
     "axis held, where only the offset is left"),
    (frozenset({"coulomb_friction", "offset"}),
     "a run in both directions: Coulomb friction changes its sign, an offset does not"),
    (frozenset({"viscous_friction", "back_emf"}),
     "record the current beside the voltage: the back-EMF needs no current"),
    (frozenset({"control_delay", "winding_inductance"}),
     "a step of voltage with the axis held: the inductance shows in the current alone"),
    (frozenset({"presliding_hysteresis", "backlash"}),
     "slow triangles with an amplitude of a few times the lost motion: in a gap the input is "
     "free, in presliding it rises at once"),
    (frozenset({"cogging_torque", "gear_mesh_ripple"}),
     "a full turn at slow constant speed in both directions, with the gear's ratio known: mesh "
     "ripple has a whole number of periods a turn of a gear"),
    (frozenset({"unbalance", "cogging_torque", "speed_sensor_runout"}),
     "the same slow turn with the axis tilted: only the weight of an unbalance changes; "
     "two constant speeds: run-out of a sensor grows with the square of the speed"),
    (frozenset({"gravity", "spring", "cogging_torque"}),
     "a slow run over more than one turn or the whole travel: a wave repeats, a spring does not"),
)
_BY_SPEED = frozenset({"coulomb_friction", "stribeck_friction", "quadratic_drag",
                       "viscous_friction", "sublinear_viscous_friction", "asymmetric_friction"})


def next_test(names: Sequence[str], trajectory: Trajectory) -> str | None:
    """Return the excitation that would separate `names`, or None for a single name."""
    if len(names) < 2:
        return None
    given = frozenset(names)
    fast = float(np.quantile(np.abs(trajectory.speed), 0.98))
    unit = trajectory.axis.speed_unit
    best = max(_TESTS, key=lambda row: len(row[0] & given))
    if len(best[0] & given) >= 2:
        return best[1]
    if given <= _BY_SPEED:
        return (f"slow constant-speed runs in both directions, at two speeds or more between "
                f"{0.02 * fast:.3g} and {fast:.3g} {unit}")
    return (f"a slow constant-speed run in both directions at {0.05 * fast:.3g} {unit} over the "
            "whole travel, then a run at twice the speed")


def for_unknown(against: str, trajectory: Trajectory) -> str:
    """Return the test that would show an unknown effect more clearly."""
    fast = float(np.quantile(np.abs(trajectory.speed), 0.98))
    unit = trajectory.axis.speed_unit
    if against == "speed":
        return (f"constant-speed runs in both directions at five speeds between "
                f"{0.02 * fast:.3g} and {fast:.3g} {unit}")
    if against in ("position", "rotor angle"):
        return ("a slow constant-speed run in both directions over the whole travel or a full "
                f"turn, at {0.05 * fast:.3g} {unit} or less")
    if against == "frequency":
        return "a record with the axis at rest and the drive on: a disturbance in time stays"
    if against == "load":
        return "the same motion at twice and at half the acceleration"
    return "the same motion repeated ten times without a pause: what changes is heat or wear"


def one_direction(trajectory: Trajectory) -> str | None:
    """Return a note where the record moves one way only."""
    forward = float(np.mean(trajectory.speed > 0))
    if 0.02 < forward < 0.98:
        return None
    return ("the axis moves one way only: Coulomb friction and an offset look alike; record both "
            "directions")
