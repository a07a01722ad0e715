"""The test profile as trajectory_msgs/JointTrajectory on `/ema/command`, and back.

A joint trajectory controller refuses times that do not increase, so a step, in a profile two
points at one time, is published as two points 1 ns apart, the later one at the step's time: all
that is sampled at a control period is the same. Read are both forms.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ema_record.actuator import load_actuator
from ema_record.errors import InvalidRecordError, UsageError
from ema_record.profile import MAX_POINTS, Profile, load_profile, load_profile_dict, profile_names
from ema_record.wire.topics import COMMAND, JOINT_SURFACE
from ema_record.wire.types import NANOSECONDS, deserialize, header, message_class, serialize

JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
UNNAMED = "command"
"""Name of a profile that was read off `/ema/command` and is none of the kit's."""

STEP = 1
"""Between the two points of a step (ns), the least that a message can tell."""
_SAME_START = 1.0 / 120.0
"""How near the surface must be to the start of a kit's step (of the way to the end stop)."""


def trajectory_points(profile: Profile) -> list[tuple[int, float]]:
    """Return ``(time_from_start (ns), position (rad))`` of each point of the profile."""
    return [(round(time * NANOSECONDS), position) for time, position in profile.points]


def increasing(times: Sequence[int]) -> list[int]:
    """Return times (ns) that do not decrease as times that increase, each 0 or more.

    Of points at one time the last keeps it, the others come `STEP` before one another; where
    there is no room before them, after time 0, the later ones give way.
    """
    found = list(times)
    for k in range(len(found) - 2, -1, -1):
        found[k] = max(min(found[k], found[k + 1] - STEP), 0)
    for k in range(1, len(found)):
        found[k] = max(found[k], found[k - 1] + STEP)
    return found


def steps_joined(times: Sequence[int]) -> list[int]:
    """Return times (ns) with points that are `STEP` apart at one time: undoes `increasing`.

    That time is the last one's, but 0 where they begin there.
    """
    found = list(times)
    last = len(found) - 1
    while last >= 0:
        first = last
        while first > 0 and 0 <= found[first] - found[first - 1] <= STEP:
            first -= 1
        found[first:last + 1] = [times[last] if times[first] else 0] * (last + 1 - first)
        last = first - 1
    return found


def encode_command(profile: Profile, stamp: int = 0) -> bytes:
    """Return the profile as CDR of a JointTrajectory of `surface`; `stamp` in ns.

    Its times increase strictly.
    """
    given = trajectory_points(profile)
    duration = message_class("builtin_interfaces/msg/Duration")
    point = message_class("trajectory_msgs/msg/JointTrajectoryPoint")
    none = np.empty(0)
    points = [
        point(
            positions=np.array([position]), velocities=none, accelerations=none, effort=none,
            time_from_start=duration(sec=time // NANOSECONDS, nanosec=time % NANOSECONDS),
        )
        for time, (_, position) in zip(increasing([time for time, _ in given]), given)
    ]
    message = message_class(JOINT_TRAJECTORY)(
        header=header(stamp), joint_names=[JOINT_SURFACE], points=points
    )
    return serialize(message, JOINT_TRAJECTORY)


def command_points(message: Any) -> list[tuple[float, float]]:
    """Return ``(time (s), position (rad))`` of a JointTrajectory of any client library.

    Points that are 1 ns apart are a step: they come back at one time.

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
    times, positions = [], []
    for index, point in enumerate(message.points):
        if len(point.positions) != len(message.joint_names):
            raise UsageError(
                f"{COMMAND}: point {index} has {len(point.positions)} positions for "
                f"{len(message.joint_names)} joints: give each point a position"
            )
        time = point.time_from_start
        times.append(int(time.sec) * NANOSECONDS + int(time.nanosec))
        positions.append(float(point.positions[joint]))
    return [(time / NANOSECONDS, p) for time, p in zip(steps_joined(times), positions)]


def profile_from_points(
    points: Sequence[tuple[float, float]], *, start: float | None = 0.0,
    duration: float | None = None,
) -> Profile:
    """Return the kit's profile with these points, or a profile named ``command``.

    Parameters
    ----------
    points : time from the acceptance of the command (s), surface position (rad). One point alone
        is a step to its position at its time.
    start : position of the surface before a single point's step (rad); None: not known, then it is
        that of the kit's step to there, or the middle.
    duration : length of a single point's test (s); without it that of the kit's ``step``.

    Raises
    ------
    UsageError
        A time or position out of bounds, or times that run back.
    """
    known = [load_profile(name) for name in profile_names()]
    if len(points) == 1:
        (time, position), = points
        near = _SAME_START * load_actuator().surface.end_stop
        for profile in known:
            if _is_step(profile, time, position) and (
                start is None or abs(profile.start - start) <= near
            ):
                return profile
        end = max(_step_duration(known) if duration is None else duration, time + 1e-3)
        start = 0.0 if start is None else start
        points = [(0.0, start), (time, start), (time, position), (end, position)]
    for profile in known:
        if len(points) == len(profile.points) and all(
            abs(a[0] - b[0]) <= 1e-9 and a[1] == b[1] for a, b in zip(points, profile.points)
        ):
            return profile
    return load_profile_dict(
        {"name": UNNAMED, "points": list(points), "description": f"read off {COMMAND}"}, COMMAND
    )


def _step_duration(known: Sequence[Profile]) -> float:
    """Return the length of the kit's profile ``step``, else of its longest one (s); 1 without."""
    named = [profile.duration for profile in known if profile.name == "step"]
    return max(named or [profile.duration for profile in known], default=1.0)


def _is_step(profile: Profile, time: float, position: float) -> bool:
    """Return whether a profile is one step, to `position` at `time`."""
    return [p for _, p in profile.points[2:]] == [position] * 2 and (
        abs(profile.points[1][0] - time) <= 1e-9 and profile.points[0][1] == profile.points[1][1]
    )


def decode_command(
    data: bytes | memoryview, *, start: float | None = 0.0, duration: float | None = None,
    likely: Profile | None = None,
) -> Profile:
    """Return the profile of a serialised JointTrajectory (see `profile_from_points`).

    That is `likely` where it has the same points: then the kit's need not be read.

    Raises
    ------
    InvalidRecordError
        The message is damaged, or holds no valid profile.
    """
    message = deserialize(data, JOINT_TRAJECTORY, COMMAND)
    try:
        points = command_points(message)
        if likely is not None and trajectory_points(likely) == [
                (round(time * NANOSECONDS), position) for time, position in points]:
            return likely
        return profile_from_points(points, start=start, duration=duration)
    except UsageError as error:
        raise InvalidRecordError(str(error)) from None
