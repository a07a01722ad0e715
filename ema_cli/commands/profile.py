"""`ema profile`: a test in seconds and radians, in the actuator's own units, and what it tells."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ema_cli.console import note, plain_table, print_json, print_table, stdout
from ema_cli.lines import print_text
from ema_record.errors import UsageError, unknown_name

if TYPE_CHECKING:
    from ema_record.actuator import Actuator
    from ema_record.profile import Profile


WIDE = 80
"""Least width of the whole table of a test (characters)."""
LEFT_OUT = ("rad left", "of slew", "turns")
"""Columns that a narrower one lacks; --json has them."""


def profile(
    name: Annotated[str | None, typer.Argument(
        metavar="NAME|FILE.yaml", show_default="all that the kit has",
        help="Test of the kit, or a file.")] = None,
    design: Annotated[bool, typer.Option(
        "--design", help="Design step and extended anew for the actuator, in place of the "
        "kit's.")] = False,
    out: Annotated[Path | None, typer.Option(
        "--out", "-o", metavar="FILE.yaml", help="Also write it, in seconds and radians.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object a test.")] = False,
) -> int:
    """Print a test in seconds and radians, with speeds, turns and the way to the end stops.

    Below the points stand the parts that a verdict is read from. Without a name all tests of
    the kit are listed. With --design the default tests are designed for the actuator as its
    file describes it now: after a change of stroke, gear or speed.

    Example: `ema profile extended`
    """
    from ema_record.actuator import load_actuator
    from ema_record.files import new_file
    from ema_record.profiles.text import profile_yaml

    actuator = load_actuator()
    chosen = _designed(actuator, name) if design else _of_kit(name)
    if out is not None and (len(chosen) != 1 or out.suffix not in (".yaml", ".yml")):
        what = "one test" if len(chosen) != 1 else "a file that ends in .yaml"
        raise UsageError(f"--out {out}: give {what}")
    if out is not None:
        with new_file(out) as temporary:
            temporary.write_text(profile_yaml(chosen[0], actuator, chosen[0].description
                                              or chosen[0].name), encoding="utf-8")
    if as_json:
        for one in chosen:
            print_json(_described(one, actuator))
    elif name is None:
        _list(chosen, actuator)
    else:
        for one in chosen:
            _explain(one, actuator)
    if out is not None:
        note(f"wrote {out}")
    return 0


def _of_kit(name: str | None) -> list[Profile]:
    from ema_record.profile import load_profile, profile_names

    return [load_profile(n) for n in (profile_names() if name is None else [name])]


def _designed(actuator: Actuator, name: str | None) -> list[Profile]:
    from ema_record.profiles.design import default_profiles

    made = default_profiles(actuator)
    if name is not None and name not in made:
        raise unknown_name("default test", name, made, f"--design makes {' and '.join(made)}")
    return [made[n] for n in made if name in (None, n)]


def _parts(chosen: Profile, actuator: Actuator) -> dict[str, Any]:
    """Return the parts that a verdict is read from, or why there are none."""
    from ema_record.profiles.plan import test_plan

    try:
        plan = test_plan(chosen, actuator)
    except UsageError as error:
        return {"reason": str(error)}
    named = {name: {"begin": part.begin, "end": part.end, "least_turns": part.turns}
             for name, part in plan.segments.items()}
    named |= {name: {"begin": begin, "end": end} for name, (begin, end) in plan.ramps.items()}
    return {
        "segments": named,
        "reversals": [{"begin": begin, "end": begin + plan.reversal_length, "sense": sense}
                      for begin, sense in plan.reversals],
        "least_time": plan.last_time, "is_extended": plan.is_extended,
    }


def _described(chosen: Profile, actuator: Actuator) -> dict[str, Any]:
    from ema_record.profiles.text import moves

    beyond = [x for _, x in chosen.points if abs(x) > actuator.surface.end_stop]
    return {
        "name": chosen.name, "description": chosen.description, "duration": chosen.duration,
        "inverter_off": chosen.inverter_off, "first_command": chosen.command_time,
        "window": chosen.window, "points": [move._asdict() for move in moves(chosen, actuator)],
        "end_stop": actuator.surface.end_stop, "within_end_stops": not beyond,
        "parts_after_first_command": _parts(chosen, actuator),
    }


def _list(chosen: list[Profile], actuator: Actuator) -> None:
    if not chosen:
        note("the kit has no tests: 'ema profile --design' shows those that would fit")
        return
    table = plain_table(pad_edge=False)
    for column in ("test", "s", "of stroke", "does"):
        table.add_column(column, no_wrap=column != "does")
    for one in chosen:
        reach = max(abs(x) for _, x in one.points) / actuator.surface.end_stop
        table.add_row(one.name, f"{one.duration:g}", f"{100 * reach:.0f} %", one.description)
    print_table(table)


def _explain(chosen: Profile, actuator: Actuator) -> None:
    from ema_record.profiles.text import moves

    console = stdout()
    print_text(f"{chosen.name}: {chosen.description or 'no description'}", console)
    names = ("s", "rad", "of stroke", "rad left", "rad/s", "of slew", "turns", "how")
    kept = [n for n in names if console.width >= WIDE or n not in LEFT_OUT]
    table = plain_table(pad_edge=False)
    for name in kept:
        table.add_column(name, justify="left" if name == "how" else "right", no_wrap=True)
    for move in moves(chosen, actuator):
        speed, slew = (("", "") if not move.speed or move.slew is None
                       else (f"{move.speed:+.4g}", f"{abs(move.slew):.3g}"))
        row = dict(zip(names, (
            f"{move.time:.5f}", f"{move.position:+.5f}", f"{move.stroke:+.1%}",
            f"{move.left:.4f}", speed, slew, f"{move.turns:.4g}", move.kind)))
        table.add_row(*(row[n] for n in kept))
    print_table(table)
    print_text(
        f"end stops +-{actuator.surface.end_stop:g} rad, slew speed {actuator.slew_speed:.4g} "
        f"rad/s, a turn of the rotor {2.0 * math.pi / actuator.gear.ratio:.4g} rad", console)
    parts = _parts(chosen, actuator)
    if "reason" in parts:
        print_text(f"no verdict is read from it: {parts['reason']}", console)
        return
    print_text("read after the first command (s): " + ", ".join(
        f"{name.replace('_', ' ')} {part['begin']:.4g} to {part['end']:.4g}"
        for name, part in parts["segments"].items()), console)
    if any(abs(x) > actuator.surface.end_stop for _, x in chosen.points):
        note("it goes beyond the end stops: the actuator will refuse it")
