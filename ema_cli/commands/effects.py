"""`ema effects`: the catalogue of physical effects as a table, or one explained."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from ema_cli.console import plain_table, print_json, print_table, stdout, styled
from ema_cli.lines import NO_BREAK, TextLine, print_lines
from ema_record.errors import unknown_name
from ema_record.kit import kit_folder

if TYPE_CHECKING:
    from ema_sim.effects import Effect, Field

WIDE = 80
"""Least width of a table of parameters (characters)."""


def effects(
    name: Annotated[str | None, typer.Argument(
        metavar="[NAME]", help="Effect to explain.")] = None,
    as_json: Annotated[bool, typer.Option(
        "--json", help="Print one JSON object an effect.")] = False,
) -> int:
    """List the catalogue of physical effects, or explain one.

    An effect is set with NAME.PARAMETER=VALUE, on the command line, in a model file and as a
    ROS parameter. With its defaults it is exactly absent.

    Example: `ema effects turn_short`
    """
    from ema_sim.effects import EFFECTS

    kit_folder()  # effects are those of any kit, but one that is named and missing is told
    if name is not None and name not in EFFECTS:
        raise unknown_name("effect", name, EFFECTS, "'ema effects' lists them")
    chosen = list(EFFECTS.values()) if name is None else [EFFECTS[name]]
    if as_json:
        for effect in chosen:
            print_json(describe(effect))
    elif name is None:
        _print_table(chosen)
    else:
        _explain(chosen[0])
    return 0


def describe(effect: Effect) -> dict[str, Any]:
    """Return the description of an effect in plain types."""
    return {
        "name": effect.name, "port": effect.port, "summary": effect.summary,
        "equation": effect.equation, "reference": effect.reference,
        "fault_class": effect.fault_class, "severity": list(effect.severity),
        "parameters": [_describe_field(effect, field) for field in effect.fields],
    }


def _describe_field(effect: Effect, field: Field) -> dict[str, Any]:
    from ema_sim.effects import Choice

    common = {"name": f"{effect.name}.{field.name}", "text": field.kind.text}
    if isinstance(field.kind, Choice):
        return {**common, "options": list(field.kind.options), "default": field.default_text}
    return {
        **common, "unit": field.kind.unit, "lower": field.kind.lower, "upper": field.kind.upper,
        "default": field.default,
    }


def bounds_text(field: Field) -> str:
    """Return the bounds of a parameter in words, e.g. ``0 to 0.9`` or ``a|b|c``."""
    from ema_sim.effects import Choice

    if isinstance(field.kind, Choice):
        return "|".join(field.kind.options)
    return f"{field.kind.lower:g} to {field.kind.upper:g}"


def unit_text(field: Field) -> str:
    """Return the unit of a parameter, empty for pure numbers and choices."""
    unit = getattr(field.kind, "unit", "")
    return "" if unit == "1" else unit


def _print_table(chosen: list[Effect]) -> None:
    """Print a paragraph an effect: what it is, its parameters with bounds, unit and default."""
    lines = []
    for effect in chosen:
        lines += [TextLine(None, ""), TextLine(None, f"{effect.name} ({effect.port})", "bold"),
                  TextLine("", effect.summary)]
        lines += [_setting(effect, field) for field in effect.fields]
    print_lines(lines[1:], stdout())


def _setting(effect: Effect, field: Field) -> TextLine:
    """Return a parameter with its default, bounds and unit."""
    text = f"{bounds_text(field)} {unit_text(field)}".rstrip().replace(" ", NO_BREAK)
    return TextLine("", f"{effect.name}.{field.name}={field.default_text}  ({text})")


def _explain(effect: Effect) -> None:
    console = stdout()
    console.print(styled((effect.name, "bold"), f"  ({effect.port} port)"))
    console.print(f"{effect.summary}\n\n  {effect.equation}\n")
    if console.width >= WIDE:
        table = plain_table(pad_edge=False)
        for column in ("parameter", "bounds", "unit", "default", "meaning"):
            table.add_column(column, no_wrap=column == "parameter")
        for field in effect.fields:
            table.add_row(f"{effect.name}.{field.name}", bounds_text(field), unit_text(field),
                          field.default_text, field.kind.text)
        print_table(table)
    else:
        print_lines([line for field in effect.fields for line in (
            _setting(effect, field), TextLine("  ", field.kind.text))], console)
    switches = ", ".join(f"{effect.name}.{name}" for name in effect.severity)
    console.print(f"\nAbsent while {switches} is at its default.")
    if effect.fault_class is not None:
        console.print(f"A fault of class {effect.fault_class}.")
    console.print(f"Reference: {effect.reference}")
