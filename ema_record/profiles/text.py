"""A profile in words and numbers: its moves in every unit, and its file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

from ema_record.actuator import Actuator
from ema_record.files import new_file
from ema_record.profile import Profile
from ema_record.profiles.design import default_profiles

DEFAULTS = {
    "step": "The paper's test: one step, analysed immediately after the transient.",
    "extended": "The default test: full slews, quarter-speed slews, slow ramps and reversals.",
}
"""First lines of the files of the default tests."""


class Move(NamedTuple):
    """One point of a profile, and how it is reached."""

    time: float
    """s from the acceptance of the command."""
    position: float
    """rad."""
    stroke: float
    """Of the way to the end stop, -1 to 1."""
    left: float
    """To the nearer end stop (rad); negative beyond it."""
    speed: float | None
    """From the point before (rad/s); None for a step."""
    slew: float | None
    """The same, of the slew speed."""
    turns: float
    """Mechanical turns of the rotor from the point before."""
    kind: str
    """start, hold, step or slew."""


def moves(profile: Profile, actuator: Actuator) -> list[Move]:
    """Return every point of `profile` as a move of an actuator."""
    stop, slew, ratio = actuator.surface.end_stop, actuator.slew_speed, actuator.gear.ratio
    found = []
    before = profile.points[0]
    for index, (time, position) in enumerate(profile.points):
        lasts, goes = time - before[0], position - before[1]
        speed = None if lasts == 0.0 and goes != 0.0 else goes / lasts if lasts else 0.0
        kind = ("start" if index == 0 else "hold" if goes == 0.0
                else "step" if speed is None else "slew")
        found.append(Move(
            time, position, position / stop, stop - abs(position), speed,
            None if speed is None else speed / slew, abs(goes) * ratio / (2.0 * math.pi), kind))
        before = time, position
    return found


def profile_yaml(profile: Profile, actuator: Actuator, comment: str) -> str:
    """Return the file of `profile`: `comment` at its head, speeds and turns beside its points."""
    lines = [f"# {comment}", f"name: {profile.name}"]
    if profile.description:
        lines.append(f"description: {profile.description}")
    lines.append("points:            # [time (s), surface position (rad)], linear in between")
    for move in moves(profile, actuator):
        text = f"  - [{_number(move.time)}, {_number(move.position)}]"
        if move.kind == "slew" and move.speed is not None and move.slew is not None:
            text = (f"{text:24} # {move.speed:+.4g} rad/s, {abs(move.slew):.3g} of the slew "
                    f"speed, {move.turns:.3g} turns of the rotor")
        elif move.kind == "step":
            text = f"{text:24} # step, {move.turns:.3g} turns of the rotor"
        lines.append(text)
    lines.append(f"inverter_off: {_number(profile.inverter_off)}  # s; no current: the current "
                 "sensors' offsets are read here")
    if profile.window is not None:
        begin, end = profile.window
        lines.append(f"window: [{_number(begin)}, {_number(end)}]  # s; of the paper's features")
    return "\n".join(lines) + "\n"


def write_profiles(actuator: Actuator, folder: Path) -> list[Path]:
    """Write the default tests of an actuator into a folder, which is made; return the files.

    Raises
    ------
    UsageError, OutputError
        It cannot make them (see `default_profiles`), or a file exists.
    """
    made = default_profiles(actuator)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, profile in made.items():
        written.append(folder / f"{name}.yaml")
        with new_file(written[-1]) as temporary:
            temporary.write_text(profile_yaml(profile, actuator, DEFAULTS[name]), encoding="utf-8")
    return written


def _number(value: float) -> str:
    """Return a number as YAML reads it back."""
    text = f"{value:.9f}".rstrip("0")
    return text + "0" if text.endswith(".") else text
