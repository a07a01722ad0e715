"""Test profiles: the position command of the surface as data.

A profile is a list of points ``(time, position)``. The position is interpolated
linearly in time; two points at one time are a step. The inverter stays off for the
first `inverter_off` seconds. A profile is bounded to what any actuator can be asked for; each
actuator's own end stops are checked where it is known: `Profile.check_within`.

A file may be written in the actuator's own units, and by moves in place of times; what is loaded
are points in seconds and radians::

    units: {position: stroke, speed: slew}  # of the way to the end stop, of the slew speed
    points:
      - [0.0, -0.5]                         # [time (s), position]
      - {hold: 0.022}                       # s
      - {to: 0.5}                           # a step
      - {hold: 1.5}
      - {to: 0.0, speed: 0.25}

Positions: rad, stroke, or turns (of the rotor); speeds: rad/s or slew.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from ema_record.actuator import load_actuator
from ema_record.errors import UsageError, unknown_name, validated
from ema_record.kit import PROFILES, kit_name, kit_path
from ema_record.limits import MAX_DURATION, MAX_POSITION
from ema_record.yaml_file import load_yaml

MAX_POINTS = 1000
SEE = "config/profiles/step.yaml shows the form"
POSITION_UNITS, SPEED_UNITS = ("rad", "stroke", "turns"), ("rad/s", "slew")
UNITS = "units"

Seconds = Annotated[float, Field(ge=0.0, le=MAX_DURATION, allow_inf_nan=False)]
Radians = Annotated[float, Field(ge=-MAX_POSITION, le=MAX_POSITION, allow_inf_nan=False)]


class Profile(BaseModel):
    """A position command of the surface, and the part of it that is analysed."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_.-]+$")
    points: tuple[tuple[Seconds, Radians], ...] = Field(min_length=1, max_length=MAX_POINTS)
    """(time from the acceptance of the command (s), surface position (rad))."""
    inverter_off: Seconds = 0.020
    """Length of the interval without current at the beginning (s)."""
    window: tuple[Seconds, Seconds] | None = None
    """Analysis window of the paper's features (s), or None for the default."""
    description: str = ""

    @field_validator("points")
    @classmethod
    def _time_does_not_run_back(
        cls, points: tuple[tuple[float, float], ...]
    ) -> tuple[tuple[float, float], ...]:
        times = [t for t, _ in points]
        if any(b < a for a, b in zip(times, times[1:])):
            raise ValueError("the times of the points must not decrease")
        if times[-1] <= 0.0:
            raise ValueError("the last point must be later than 0 s")
        return points

    @property
    def duration(self) -> float:
        """Time of the last point (s)."""
        return self.points[-1][0]

    @property
    def start(self) -> float:
        """Position of the surface before the test (rad)."""
        return self.points[0][1]

    @property
    def command_time(self) -> float:
        """Time of the first change of the command (s)."""
        for (t0, p0), (_, p1) in zip(self.points, self.points[1:]):
            if p1 != p0:
                return t0
        return self.inverter_off

    def check_within(self, end_stop: float) -> None:
        """Raise UsageError where it commands more than `end_stop` (rad) to either side."""
        beyond = max((position for _, position in self.points), key=abs)
        if abs(beyond) > end_stop:
            raise UsageError(
                f"profile {self.name!r} commands {beyond:g} rad: outside the end stops of "
                f"this actuator, +-{end_stop:g} rad; choose a smaller movement"
            )

    def command(self, time: np.ndarray) -> np.ndarray:
        """Return the commanded surface position at `time`.

        Parameters
        ----------
        time : ndarray, shape (n,). Since the acceptance of the command (s).

        Returns
        -------
        ndarray, shape (n,)
            Position (rad). At a step the later value holds; outside the points the first
            or last position holds.
        """
        t = np.asarray([p[0] for p in self.points])
        x = np.asarray([p[1] for p in self.points])
        if len(t) == 1:
            return np.full(np.shape(time), x[0])
        k = np.clip(np.searchsorted(t, time, side="right") - 1, 0, len(t) - 2)
        span = t[k + 1] - t[k]
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(span > 0.0, (time - t[k]) / span, 1.0)
        return x[k] + (x[k + 1] - x[k]) * np.clip(part, 0.0, 1.0)


def step_profile(
    amplitude: float, *, start: float | None = None, duration: float | None = None
) -> Profile:
    """Return a step of any size, `amplitude` (rad), at the time of the present kit's ``step``.

    Without them `start` (rad) and `duration` (s) are those of that test, and so is the window
    where it lies inside.
    """
    like = load_profile("step")
    begin = like.start if start is None else start
    end = like.duration if duration is None else duration
    at, window = like.command_time, like.window
    return load_profile_dict(
        {
            "name": f"step_{amplitude:g}",
            "points": [[0.0, begin], [at, begin], [at, begin + amplitude],
                       [end, begin + amplitude]],
            "inverter_off": like.inverter_off,
            "window": window if window is not None and end >= window[1] else None,
            "description": f"step of {amplitude:g} rad",
        },
        "step",
    )


def load_profile_dict(data: object, where: str) -> Profile:
    """Validate `data` (as read from YAML or JSON); `where` names its origin in errors.

    What is in the actuator's own units is meant for the present kit's.
    """
    if isinstance(data, Mapping) and _has_moves(data):
        data = _in_seconds(data, where)
    return validated(Profile.model_validate, data, where, "profile", SEE)


def _has_moves(data: Mapping[str, Any]) -> bool:
    """Whether a profile has units of its own or moves, not only points in s and rad."""
    points = data.get("points")
    return UNITS in data or (
        isinstance(points, Sequence) and any(isinstance(point, Mapping) for point in points))


def _in_seconds(data: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return a profile as points in s and rad, for the present kit's actuator."""
    position, speed = _units(data.get(UNITS, {}), where)
    given = data.get("points")
    if not isinstance(given, Sequence) or len(given) > MAX_POINTS:
        raise UsageError(f"{where}: points: expected a list of at most {MAX_POINTS}: {SEE}")
    time, place = 0.0, math.nan
    points: list[tuple[float, float]] = []
    for index, entry in enumerate(given):
        name = f"{where}: points.{index}"
        if isinstance(entry, Mapping):
            if not (set(entry) == {"hold"} or {"to"} <= set(entry) <= {"to", "speed"}):
                raise UsageError(f"{name}: a move is {{hold: s}}, {{to: position}} or {{to: "
                                 f"position, speed: speed}}, not {str(entry)[:60]}")
            if not points and set(entry) != {"to"}:
                raise UsageError(f"{name}: the first point is [time, position]")
            moved = _number(entry["to"], f"{name}.to") * position if "to" in entry else place
            if "speed" in entry:
                pace = _number(entry["speed"], f"{name}.speed") * speed
                if pace <= 0.0:
                    raise UsageError(f"{name}.speed: {entry['speed']} must be above 0: the sense "
                                     "follows from the position")
                time += abs(moved - place) / pace
            elif "hold" in entry:
                time += _number(entry["hold"], f"{name}.hold")
            place = moved
        elif isinstance(entry, Sequence) and not isinstance(entry, str) and len(entry) == 2:
            time = _number(entry[0], name)
            place = _number(entry[1], name) * position
        else:
            raise UsageError(f"{name}: expected [time, position] or a move (value "
                             f"{str(entry)[:60]}): {SEE}")
        points.append((round(time, 9), round(place, 9)))
    return {**{k: v for k, v in data.items() if k != UNITS}, "points": points}


def _units(given: object, where: str) -> tuple[float, float]:
    """Return the units of positions (rad) and speeds (rad/s)."""
    if not isinstance(given, Mapping):
        raise UsageError(f"{where}: {UNITS}: expected {{position: stroke, speed: slew}}")
    for key in given:
        if key not in ("position", "speed"):
            raise unknown_name(f"unit of {where}", str(key), ("position", "speed"), SEE)
    position, speed = given.get("position", "rad"), given.get("speed", "rad/s")
    for word, known in ((position, POSITION_UNITS), (speed, SPEED_UNITS)):
        if word not in known:
            raise unknown_name(f"unit in {where}", str(word)[:60], known,
                               f"one of {', '.join(known)}")
    actuator = load_actuator()
    scale = {"rad": 1.0, "stroke": actuator.surface.end_stop,
             "turns": 2.0 * math.pi / actuator.gear.ratio}
    return scale[position], actuator.slew_speed if speed == "slew" else 1.0


def _number(value: object, where: str) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e9:
        return float(value)
    raise UsageError(f"{where}: {str(value)[:60]!r} is not a number: {SEE}")


def profile_names() -> list[str]:
    """Return the names of the present kit's profiles."""
    return list(_names(kit_path(PROFILES)))


@cache
def _names(folder: Path) -> tuple[str, ...]:
    return tuple(sorted(p.stem for p in folder.glob("*.yaml")))


@cache
def _of_kit(path: Path) -> Profile:
    return load_profile_dict(load_yaml(path), str(path))


def load_profile(name_or_path: str | Path) -> Profile:
    """Return the profile of that name of the present kit, or the one in that YAML file."""
    text = str(name_or_path)
    if text in profile_names():
        return _of_kit(kit_path(PROFILES) / f"{text}.yaml")
    if text.endswith((".yaml", ".yml")):
        return load_profile_dict(load_yaml(Path(text)), text)
    raise unknown_name(
        "profile", text, profile_names(),
        f"{kit_name()} has {', '.join(profile_names()) or 'none'}; a file must end in .yaml",
    )
