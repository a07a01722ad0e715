"""What a command on `/ema/command` means to an actuator that stands somewhere."""

from __future__ import annotations

from collections.abc import Sequence

from ema_record.actuator import Actuator
from ema_record.profile import Profile, load_profile_dict
from ema_record.wire.topics import COMMAND
from ema_record.wire.trajectory import UNNAMED, profile_from_points

INVERTER_OFF = 0.020
"""Time without current at the begin of a run (s)."""
SETTLING = 0.150
"""Added to the slewing time of a single step (s)."""


def profile_of_command(
    points: Sequence[tuple[float, float]], position: float, actuator: Actuator
) -> Profile:
    """Return the profile of a command.

    Parameters
    ----------
    points : (time (s), position (rad)). One point is a step there, executed as soon as the
        inverter is on; its time, if later, is when the run ends. Several are the profile.
    position : where the surface stands (rad).
    actuator : its slew speed sets the length of a single step.

    Raises
    ------
    UsageError
        A time or a position out of bounds, or times that run back.
    """
    if len(points) > 1:
        return profile_from_points(points)
    (time, target), = points
    slew = actuator.control.speed_limit / actuator.gear.ratio
    end = max(time, INVERTER_OFF + abs(target - position) / slew + SETTLING)
    step = [(0.0, position), (INVERTER_OFF, position), (INVERTER_OFF, target), (end, target)]
    return load_profile_dict(
        {"name": UNNAMED, "points": step, "description": f"step read off {COMMAND}"}, COMMAND
    )
