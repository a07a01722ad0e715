"""The test profile as trajectory_msgs/JointTrajectory on `/ema/command`, and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ema_record.errors import InvalidRecordError, UsageError
from ema_record.profile import MAX_POINTS, Profile, load_profile, load_profile_dict, profile_names
from ema_record.wire.topics import COMMAND, JOINT_SURFACE
from ema_record.wire.types import NANOSECONDS, deserialize, header, message_class, serialize

JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
UNNAMED = "command"
"""Name of a profile that was read off `/ema/command` and is none of the shipped ones."""

_SAME_START = 5e-3
"""How near the surface must be to the start of a shipped step (rad)."""


def trajectory_points(profile: Profile) -> list[tuple[int, float]]:
    """Return ``(time_from_start (ns), position (rad))`` of each point of the profile."""
    return [(round(time * NANOSECONDS), position) for time, position in profile.points]


def encode_command(profile: Profile, stamp: int = 0) -> bytes:
    """Return the profile as CDR of a JointTrajectory of `surface`; `stamp` in ns."""
    duration = message_class("builtin_interfaces/msg/Duration")
    point = message_class("trajectory_msgs/msg/JointTrajectoryPoint")
    none = np.empty(0)
    points = [
        point(
            positions=np.array([position]), velocities=none, accelerations=none, effort=none,
            time_from_start=duration(sec=time // NANOSECONDS, nanosec=time % NANOSECONDS),
        )
        for time, position in trajectory_points(profile)
    ]
    message = message_class(JOINT_TRAJECTORY)(
        header=header(stamp), joint_names=[JOINT_SURFACE], points=points
    )
    return serialize(message, JOINT_TRAJECTORY)


def command_points(message: Any) -> list[tuple[float, float]]:
    """Return ``(time (s), position (rad))`` of a JointTrajectory of any client library.

    Raises
    ------
    UsageError
        It does not move `surface`, has no or too many points, or a point without position.

    """
    names = [str(name) for name in message.joint_names[:64]]
    if JOINT_SURFACE not in names:
        raise UsageError(
            f"{COMMAND}: joints {', '.join(names)[:80] or '(none)'}, expected {JOINT_SURFACE!r}: "
            "command the joint of the actuator's surface"
        )
    joint = names.index(JOINT_SURFACE)
    if not 1 <= len(message.points) <= MAX_POINTS:
        raise UsageError(
            f"{COMMAND}: {len(message.points)} points, expected 1 to {MAX_POINTS}: "
            "give the profile by fewer points; the position is linear in between"
        )
    points = []
    for index, point in enumerate(message.points):
        if len(point.positions) != len(message.joint_names):
            raise UsageError(
                f"{COMMAND}: point {index} has {len(point.positions)} positions for "
                f"{len(message.joint_names)} joints: give each point a position"
            )
        time = point.time_from_start
        nanoseconds = int(time.sec) * NANOSECONDS + int(time.nanosec)
        points.append((nanoseconds / NANOSECONDS, float(point.positions[joint])))
    return points


def profile_from_points(
    points: Sequence[tuple[float, float]], *, start: float = 0.0, duration: float | None = None
) -> Profile:
    """Return the shipped profile with these points, or a profile named ``command``.

    Parameters
    ----------
    points : sequence of (float, float)
        Time from the acceptance of the command (s), surface position (rad). One point alone
        is a step to its position at its time.
    start : float
        Position of the surface before a single point's step (rad).
    duration : float, optional
        Length of a single point's test (s); without it that of the shipped ``step``.

    Raises
    ------
    UsageError
        A time or position out of bounds, or times that run back.

    """
    shipped = [load_profile(name) for name in profile_names()]
    if len(points) == 1:
        (time, position), = points
        for profile in shipped:
            if _is_step(profile, time, position) and abs(profile.start - start) <= _SAME_START:
                return profile
        end = max(load_profile("step").duration if duration is None else duration, time + 1e-3)
        points = [(0.0, start), (time, start), (time, position), (end, position)]
    for profile in shipped:
        if len(points) == len(profile.points) and all(
            abs(a[0] - b[0]) <= 1e-9 and a[1] == b[1] for a, b in zip(points, profile.points)
        ):
            return profile
    return load_profile_dict(
        {"name": UNNAMED, "points": list(points), "description": f"read off {COMMAND}"}, COMMAND
    )


def _is_step(profile: Profile, time: float, position: float) -> bool:
    """Return whether a profile is one step, to `position` at `time`."""
    return [p for _, p in profile.points[2:]] == [position] * 2 and (
        abs(profile.points[1][0] - time) <= 1e-9 and profile.points[0][1] == profile.points[1][1]
    )


def decode_command(
    data: bytes | memoryview, *, start: float = 0.0, duration: float | None = None
) -> Profile:
    """Return the profile of a serialised JointTrajectory (see `profile_from_points`).

    Raises
    ------
    InvalidRecordError
        The message is damaged, or holds no valid profile.

    """
    message = deserialize(data, JOINT_TRAJECTORY, COMMAND)
    try:
        return profile_from_points(command_points(message), start=start, duration=duration)
    except UsageError as error:
        raise InvalidRecordError(str(error)) from None
