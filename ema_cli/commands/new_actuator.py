"""`ema new-actuator`: the kit of a type of actuator from what its data sheet says."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ema_cli.console import check_new, note, print_json, print_table, say
from ema_record.errors import UsageError

if TYPE_CHECKING:
    from ema_record.data_sheet.derive import Description

TEXT = str | None
MOTOR, GEAR, DRIVE, RECORDER = "Motor", "Gear and surface", "Drive", "Recorder"


def _option(name: str, help_text: str, panel: str) -> Any:
    return typer.Option(f"--{name}", metavar="VALUE", help=help_text, rich_help_panel=panel)


def new_actuator(
    out: Annotated[Path, typer.Option(
        "--out", "-o", metavar="KIT", help="Folder to make.")],
    name: Annotated[str, typer.Option("--name", help="Of the type, for the head of the file.")]
    = "",
    resistance: Annotated[TEXT, _option(
        "resistance", "Between two terminals, e.g. 1.2ohm.", MOTOR)] = None,
    inductance: Annotated[TEXT, _option(
        "inductance", "Between two terminals, e.g. 0.194mH.", MOTOR)] = None,
    kv: Annotated[TEXT, _option("kv", "Speed constant, e.g. 475rpm/V.", MOTOR)] = None,
    back_emf: Annotated[TEXT, _option(
        "back-emf", "Voltage constant, line to line, e.g. 2.107mV/rpm.", MOTOR)] = None,
    torque_constant: Annotated[TEXT, _option(
        "torque-constant", "E.g. 20.1mNm/A.", MOTOR)] = None,
    no_load_speed: Annotated[TEXT, _option(
        "no-load-speed", "At the nominal voltage, e.g. 11300rpm; serves as constant, and as "
        "check of another.", MOTOR)] = None,
    no_load_current: Annotated[TEXT, _option("no-load-current", "E.g. 0.189A.", MOTOR)] = None,
    nominal_voltage: Annotated[TEXT, _option(
        "nominal-voltage", "Of the no-load values; default --bus.", MOTOR)] = None,
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
    pole_pairs: Annotated[TEXT, _option("pole-pairs", "Pairs, not poles.", MOTOR)] = None,
    inertia: Annotated[TEXT, _option("inertia", "Of the rotor, e.g. 34gcm2.", MOTOR)] = None,
    friction: Annotated[TEXT, _option(
        "friction", "Dry, of motor and gear at the motor, e.g. 1.1mNm.", MOTOR)] = None,
    viscous_friction: Annotated[TEXT, _option(
        "viscous-friction", "Of motor and gear, e.g. 2.4e-4mNm/rpm.", MOTOR)] = None,
    peak_torque: Annotated[TEXT, _option(
        "peak-torque", "Where the motor saturates, e.g. 0.3Nm.", MOTOR)] = None,
    gear: Annotated[TEXT, _option(
        "gear", "Turns of the motor a turn of the surface, e.g. 100.", GEAR)] = None,
    gear_efficiency: Annotated[TEXT, _option("gear-efficiency", "E.g. 0.7.", GEAR)] = None,
    gear_inertia: Annotated[TEXT, _option(
        "gear-inertia", "At the motor, e.g. 4gcm2.", GEAR)] = None,
    stiffness: Annotated[TEXT, _option(
        "stiffness", "Of gear and shaft at the output, e.g. 1.5Nm/arcmin.", GEAR)] = None,
    backlash: Annotated[TEXT, _option(
        "backlash", "Total, at the output, e.g. 1arcmin.", GEAR)] = None,
    end_stop: Annotated[TEXT, _option(
        "end-stop", "From the middle to either end stop, half the stroke, e.g. 40deg.",
        GEAR)] = None,
    surface_inertia: Annotated[TEXT, _option(
        "surface-inertia", "Of what the gear turns, e.g. 2e-3kgm2.", GEAR)] = None,
    surface_friction: Annotated[TEXT, _option(
        "surface-friction", "Dry, of what the gear turns, e.g. 0.4Nm.", GEAR)] = None,
    drive: Annotated[str, typer.Option(
        "--drive", metavar="relay|pwm|foc", rich_help_panel=DRIVE,
        show_default="foc with a sine, pwm with a trapezoid",
        help="Hysteresis a phase; six-step with PI control; field oriented.")] = "",
    bus: Annotated[TEXT, _option("bus", "Between the rails, e.g. 24V.", DRIVE)] = None,
    current_limit: Annotated[TEXT, _option(
        "current-limit", "Peak of a phase, e.g. 7.5A.", DRIVE)] = None,
    speed: Annotated[TEXT, _option(
        "speed", "Limit of the motor's speed, e.g. 6000rpm; default 0.6 of what the bus "
        "allows.", DRIVE)] = None,
    control_period: Annotated[TEXT, _option("control-period", "E.g. 50us.", DRIVE)] = None,
    pwm: Annotated[TEXT, _option("pwm", "Frequency of the carrier, e.g. 40kHz.", DRIVE)] = None,
    hysteresis: Annotated[TEXT, _option(
        "hysteresis", "Half width of a relay's band, e.g. 0.2A.", DRIVE)] = None,
    rate: Annotated[TEXT, _option("rate", "Samples, e.g. 10kHz.", RECORDER)] = None,
    without: Annotated[list[str] | None, typer.Option(
        "--without", metavar="CHANNEL", rich_help_panel=RECORDER,
        help="Not recorded: phase_current_c, reference_currents, rotor_angle, "
        "surface_position; repeatable.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
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
    from ema_record.data_sheet.quantities import QUANTITIES
    from ema_record.data_sheet.sheet import read_sheet

    here = locals()
    texts = {option: here[option.replace("-", "_")] for option in QUANTITIES
             if here[option.replace("-", "_")] is not None}
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
    from ema_record.data_sheet.quantities import QUANTITIES, read_quantity
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
    from rich.table import Table

    from ema_record.profiles.design import default_profiles
    from ema_record.profiles.motion import motion, torque_constant

    actuator = description.actuator
    at, counts = motion(actuator), _counts(description)
    say(f"{out}: {counts['given']} parameters given, {counts['derived']} derived, "
        f"{counts['assumed']} assumed")
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
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
