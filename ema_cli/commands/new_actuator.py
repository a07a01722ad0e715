"""`ema new-actuator`: the kit of a type of actuator from what its data sheet says."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ema_cli.console import check_new, note, plain_table, print_json, print_table, say
from ema_record.data_sheet.quantities import DRIVE, MOTOR, QUANTITIES, RECORDER
from ema_record.errors import UsageError

if TYPE_CHECKING:
    from ema_record.data_sheet.derive import Description


def _with_quantities(command: Callable[..., int]) -> Callable[..., int]:
    """Return `command` with an option for each quantity, after its first two."""
    stated = [
        inspect.Parameter(
            option.replace("-", "_"), inspect.Parameter.KEYWORD_ONLY, default=None,
            annotation=Annotated[str | None, typer.Option(
                f"--{option}", metavar="VALUE", rich_help_panel=kind.part,
                help=f"{kind.words[0].upper()}{kind.words[1:]}; e.g. {kind.example}.")])
        for option, kind in QUANTITIES.items()]
    signature = inspect.signature(command)
    out, name, *others, _ = signature.parameters.values()
    command.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[out, name, *stated, *others])
    command.__annotations__ |= {p.name: p.annotation for p in stated}
    return command


@_with_quantities
def new_actuator(
    *,
    out: Annotated[Path, typer.Option(
        "--out", "-o", metavar="KIT", help="Folder to make.")],
    name: Annotated[str, typer.Option("--name", help="Of the type, for the head of the file.")]
    = "",
    voltage_is: Annotated[str, typer.Option(
        "--voltage-is", metavar="mean|peak|rms", rich_help_panel=MOTOR,
        help="What --kv and --back-emf are of, line to line: mean in block commutation (most "
        "small motors), peak, or rms.")] = "mean",
    current_is: Annotated[str, typer.Option(
        "--current-is", metavar="block|peak|rms", rich_help_panel=MOTOR,
        help="What --torque-constant is a current of: block commutation, or peak or rms of a "
        "sinusoidal phase current.")] = "block",
    shape: Annotated[str, typer.Option(
        "--shape", metavar="sine|trapezoid", rich_help_panel=MOTOR, show_default="sine",
        help="Of the back-EMF.")] = "",
    drive: Annotated[str, typer.Option(
        "--drive", metavar="relay|pwm|pwm_independent|foc", rich_help_panel=DRIVE,
        show_default="foc with a sine, pwm with a trapezoid",
        help="Hysteresis a phase; six-step with PI control, which share a voltage or know their "
        "phase alone; field oriented.")] = "",
    without: Annotated[list[str] | None, typer.Option(
        "--without", metavar="CHANNEL", rich_help_panel=RECORDER,
        help="Not recorded: phase_current_c, reference_currents, rotor_angle, "
        "surface_position; repeatable.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    **stated: str | None,
) -> int:
    """Write the kit of a type of actuator from what its data sheet says.

    Each value has its unit. What is needed and not given is asked for where standard input is a
    terminal; what a data sheet does not say is assumed, and the file says so line by line. The
    kit holds actuator.yaml and the tests step and extended, made for its stroke and speed;
    'ema commission' completes it from acceptance records. A guide with a real motor:
    docs/data-sheet.md.

    Example: `ema new-actuator --out kit --resistance 1.2ohm --inductance 0.194mH --kv 475rpm/V \
--pole-pairs 1 --inertia 34gcm2 --gear 100 --end-stop 40deg --current-limit 7.5A --bus 24V`
    """
    from ema_record.data_sheet.new_kit import new_kit
    from ema_record.data_sheet.sheet import read_sheet

    texts = {option: text for option in QUANTITIES
             if (text := stated.get(option.replace("-", "_"))) is not None}
    choices = {"drive": drive, "shape": shape, "voltage-is": voltage_is,
               "current-is": current_is}
    check_new(out)
    if sys.stdin is not None and sys.stdin.isatty():
        _ask(texts)
    description = new_kit(read_sheet(texts, choices, tuple(without or ()), name), out)
    if as_json:
        print_json(_described(description, out))
    else:
        _explain(description, out)
    return 0


def _ask(texts: dict[str, str]) -> None:
    """Ask for what is needed and not given, until it can be read."""
    from ema_record.data_sheet.quantities import read_quantity
    from ema_record.data_sheet.sheet import CONSTANTS, missing

    lacking = missing(texts)
    if lacking:
        note("What the data sheet says, with its unit; Ctrl-C ends, nothing is written yet.")
    while lacking:
        option = lacking[0]
        kind = QUANTITIES[option]
        if option in CONSTANTS:
            note(f"The constant: one of {', '.join(CONSTANTS)}.")
            option = _answer("which", CONSTANTS[0])
            if option not in CONSTANTS:
                continue
            kind = QUANTITIES[option]
        text = _answer(f"{option.replace('-', ' ')}, {kind.words}", kind.example, needed=True)
        try:
            read_quantity(option, text)
        except UsageError as error:
            note(str(error))
            continue
        texts[option] = text
        lacking = missing(texts)


def _answer(what: str, example: str, *, needed: bool = False) -> str:
    """Return the answer to a question; where it need not be given, the example is the default."""
    sys.stderr.write(f"{what} [{'e.g. ' if needed else ''}{example}]: ")
    sys.stderr.flush()
    line = sys.stdin.readline()
    if not line:
        raise UsageError("the answers ended: nothing was written")
    return line.strip() or ("" if needed else example)


def _counts(description: Description) -> dict[str, int]:
    origins = [e.origin for part in description.entries.values() for e in part.values()]
    return {origin: origins.count(origin) for origin in ("given", "derived", "assumed")}


def _described(description: Description, out: Path) -> dict[str, Any]:
    return {
        "kit": str(out), "origins": _counts(description),
        "actuator": {section: {name: {"value": entry.value, "origin": entry.origin,
                                      "how": entry.how} for name, entry in part.items()}
                     for section, part in description.entries.items()},
    }


def _explain(description: Description, out: Path) -> None:
    from ema_record.profiles.design import default_profiles
    from ema_record.profiles.motion import motion, torque_constant

    actuator = description.actuator
    at, counts = motion(actuator), _counts(description)
    say(f"{out}: {counts['given']} parameters given, {counts['derived']} derived, "
        f"{counts['assumed']} assumed")
    table = plain_table(show_header=False)
    table.add_column(no_wrap=True)
    table.add_column()
    test = default_profiles(actuator)["extended"]
    for name, value in (
        ("torque constant", f"{torque_constant(actuator):.4g} N m/A of reference current"),
        ("slew speed", f"{actuator.slew_speed:.4g} rad/s of the surface, "
                       f"{actuator.control.speed_limit:.4g} rad/s of the motor"),
        ("acceleration", f"{1e3 * at.acceleration:.3g} ms to that speed"),
        ("friction", f"{at.friction:.3g} N m at the motor and that speed, of "
                     f"{actuator.motor.torque_limit:.3g} N m"),
        ("test", f"extended, {test.duration:g} s, +-{max(abs(x) for _, x in test.points):g} of "
                 f"+-{actuator.surface.end_stop:.4g} rad"),
    ):
        table.add_row(name, value)
    print_table(table)
    note(f"next: look through {out}/actuator.yaml, then ema simulate --kit {out} --out BAG, or "
         f"ema commission RECORD... --actuator {out}/actuator.yaml --out NEW_KIT")
