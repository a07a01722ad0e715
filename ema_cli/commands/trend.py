"""`ema trend`: how faults of an actuator, or values of any axis, grow from record to record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ema_cli.console import check_new_file, print_json, stdout
from ema_cli.lines import print_text
from ema_cli.options import Baseline, Commanded, Format, Rule, given_once
from ema_cli.views.flights import (
    about,
    copies_text,
    draw_sequence,
    episode_text,
    fall_lines,
    judged_flights,
    number_list,
    print_sequence,
    trend_object,
    unit_name,
)
from ema_cli.views.machine import Machine, check_format
from ema_cli.views.pictures import picture_format
from ema_cli.views.rig_trend import RigTrend, draw_values, first_is_rig, rig_trend
from ema_cli.views.rig_trend import trend_lines as rig_lines
from ema_prognostics.words import class_name, scaled
from ema_record.errors import UsageError, bounded, counted, unknown_name

if TYPE_CHECKING:
    from ema_prognostics.trend.flights import Flight
    from ema_prognostics.trend.unit_trend import FaultTrend, UnitTrend


def trend(
    bags: Annotated[list[Path], typer.Argument(
        metavar="DIR|BAG...", help="Bags of an actuator, one a flight, or of a rig; files with "
        "--map; or directories of them.")],
    rule: Rule = "2/3",
    profile: Commanded = None,
    model: Annotated[Path | None, typer.Option(
        "--model", help="Model file of 'ema train', in place of the kit's; of a rig that of "
        "'ema identify', whose terms are followed.")] = None,
    baseline: Baseline = None,
    map_file: Annotated[Path | None, typer.Option(
        "--map", metavar="FILE.yaml", help="Of a rig: says which column is what, as for "
        "'ema import'.")] = None,
    plot: Annotated[Path | None, typer.Option(
        metavar="FILE.png|.svg|.pdf", help="Draw severities, announcements and what is ahead."
    )] = None,
    limit: Annotated[list[str] | None, typer.Option(
        metavar="NAME=SIZE", help="Forecast a size of your own too, as turn_short=5% or "
        "backlash=2mrad; of a rig a value, or NAME=+P% of what it was at first; repeatable.")
    ] = None,
    json: Annotated[bool, typer.Option(
        "--json", help="As --format json, one object an actuator.")] = False,
    form: Format = "text",
) -> int:
    """Say how the faults of an actuator grow from flight to flight.

    Flights are ordered by the start times in the bags, equal or unknown ones by name. Bags of
    several actuators are told apart by serial number, each has its own trend.

    Of a rig, friction, backlash, stiffness, cogging and offset of each record are followed, with
    their intervals: what stepped, what grows, and when it reaches a limit. Records are ordered by
    their dates, else by name.

    Exit status: 0 no fault confirmed at the end, 1 a confirmed one, 3 one that is announced or
    suspected and not confirmed, or a last flight without an answer; 2 wrong use, or no bag that
    can be read.

    Example: `ema trend flights/SN-0007 --plot growth.png`

    Example: `ema trend rig_bags --limit coulomb_friction.level=+50%`
    """
    from ema_prognostics.trend.announcement import parse_rule
    from ema_prognostics.trend.unit_trend import trend_of
    from ema_prognostics.verdict.judge import Judge
    from ema_prognostics.verdict.verdict import worst_status
    from ema_record.bag.find import is_sequence, what_else

    chosen = parse_rule(rule)
    form = check_format(form, json=json)
    if plot is not None:
        picture_format(plot)
    check_new_file(plot)
    if map_file is not None or first_is_rig(bags):
        if baseline is not None or profile is not None:
            raise UsageError("--baseline and --profile are of the actuator's own test: a rig has "
                             "none")
        if form == "csv":
            raise UsageError("--format csv: the trend of a rig is text or json")
        return _of_rig(rig_trend(bags, map_file=map_file, model=model, limits=limit or ()),
                       plot, form)
    given_once("--limit", limit)
    limits = dict(map(parse_limit, limit or []))
    for bag in bags:
        other = None if is_sequence(bag) else what_else(bag)
        if other is not None:
            raise UsageError(f"{bag}: {other}: give a bag, or a directory of them")
    judge = Judge(model, baseline, profile=profile)
    units = judged_flights(bags, judge)
    trends = [trend_of(unit, flights, chosen, limits) for unit, flights in units.items()]
    out = Machine(form, judge) if form != "text" else None
    if out is not None and form == "csv":
        print_sequence(trends, out)
    for found in trends:
        if out is not None:
            if form == "json":
                print_json(trend_object(found, out))
            continue
        for line in trend_lines(found, limits):
            print_text(line, stdout())
    if plot is not None:
        draw_sequence(trends, plot)
    return worst_status([exit_status(found) for found in trends])


def _of_rig(found: RigTrend, plot: Path | None, form: str) -> int:
    """Print and plot the trend of a rig."""
    if form == "json":
        print_json(found.to_dict())
    else:
        for line in rig_lines(found):
            print_text(line, stdout())
    if plot is not None and found.values:
        draw_values(found, plot)
    return found.exit_status


LARGEST_LIMIT = {"turn_short": 1.0, "rotor_eccentricity": 1.0, "friction": 100.0, "backlash": 0.1}
"""Sizes beyond which a unit was forgotten: all turns, the whole air gap, a hundredfold; rad."""


def parse_limit(text: str) -> tuple[str, float]:
    """Return class and severity of ``FAULT=SIZE``: a plain number, or with %, mrad or rad.

    Raises
    ------
    UsageError
        Another class, no size above 0, or a unit that the class does not have.
    """
    from ema_prognostics.cascade.classes import UNITS

    name, _, size = (part.strip() for part in text.partition("="))
    if name not in UNITS:
        raise unknown_name("fault", name, UNITS, f"--limit {text}: give FAULT=SIZE, as "
                           "turn_short=5%")
    factors = {"": 1.0, **({"mrad": 1e-3, "rad": 1.0} if UNITS[name] == "rad" else {"%": 0.01})}
    number = size.rstrip("%mrad ")
    unit = size[len(number):].strip()
    if unit not in factors:
        raise UsageError(f"--limit {text}: {unit!r} is no unit of {name}: give "
                         f"{' or '.join(u for u in factors if u)}")
    most = LARGEST_LIMIT[name] / factors[unit]
    plain = "" if unit else "(5 mrad is 0.005)" if "mrad" in factors else "(5% is 0.05)"
    return name, factors[unit] * bounded(f"--limit {name}", number, 1e-6, most, plain)


def exit_status(found: UnitTrend) -> int:
    """Return the exit status that the trend of one actuator amounts to."""
    if all(f.verdict.outcome == "invalid" for f in found.flights):
        return 2
    if any(f.present for f in found.faults):
        return 1
    pending = any(f.episodes[-1].cleared is None for f in found.faults)
    tests = [f for f in found.flights if f.repeat_of is None]
    if of_any_unit(found) and any(f.verdict.outcome != "healthy" for f in tests):
        return 3  # one does not clear another
    return 3 if pending or found.suspected or not tests[-1].answered else 0


def of_any_unit(found: UnitTrend) -> bool:
    """Whether flights may be of several actuators, since no bag tells a serial number."""
    return not found.serial_number and len(found.flights) > 1


def trend_lines(found: UnitTrend, limits: Mapping[str, float]) -> list[str]:
    """Return the trend of an actuator in words, a fact a line."""
    count = len(found.flights) - len(found.copies)
    answered = count - len(found.unanswered)
    flights = counted(count, "flight")
    lines = [f"Actuator {unit_name(found)}: {flights}, {answered} of them gave an answer"]
    if found.unanswered:
        lines.append("  no answer, counted neither as healthy nor as faulty: "
                     + number_list(found.unanswered))
        for flight in found.flights:
            if not flight.answered and flight.repeat_of is None:
                verdict = flight.verdict
                lines.append(f"    flight {flight.number}, {verdict.outcome}: "
                             f"{next(iter(verdict.reasons), 'no reason given')}")
    if found.copies:
        lines.append(f"  {copies_text(found)}")
    if found.undated:
        lines.append("  dated before 2001 or ahead of this computer's clock, placed by their "
                     f"names: {number_list(found.undated)}")
    if of_any_unit(found):
        lines.append("  no bag tells a serial number: they may be of several actuators")
    if not found.faults and not found.suspected and answered:
        lines.append("  no fault announced, no growth seen")
    for fault in found.faults:
        lines.append(f"  {class_name(fault.history.fault_class, fault.history.phase)}")
        lines += [f"    {episode_text(e)}" for e in fault.episodes]
        lines += [f"    {line}" for line in fall_lines(fault)]
        lines += [f"    {line}" for line in growth_lines(fault, found.flights, limits)]
    for fault_class, at in found.suspected.items():
        lines += [
            f"  {class_name(fault_class)}",
            f"    suspected from flight {at}: its probability rises from flight to flight, "
            "though no flight had announced it by then",
        ]
    return lines


def growth_lines(
    fault: FaultTrend, flights: Sequence[Flight], limits: Mapping[str, float]
) -> list[str]:
    """Return rate and forecast of one fault, or why there is none."""
    if fault.episodes[-1].cleared is not None:
        return []
    rise = fault.growth
    if rise is None:
        return ["too few flights with a severity for a rate"]
    scale, unit = scaled(fault.history.fault_class)
    low, high = (scale * v for v in rise.rate_interval)
    rate = (
        f"{scale * rise.rate:+.2g} {unit} a flight ({low:+.2g} to {high:+.2g}), "
        f"from {rise.count} flights"
    )
    now = f"severity now {scale * rise.severity:.3g} {unit}"
    own = limits.get(fault.history.fault_class)
    if own is not None and rise.severity >= own:
        now += f", your limit of {scale * own:.3g} {unit} is reached"
    if not rise.growing:
        return [f"{now}; no growth: {rate}"]
    lines = [f"{now}; grows by {rate}"]
    for level in fault.forecasts:
        first, last = level.interval
        until = f"to {last}" if last is not None else "or later, no end in sight"
        middle = ""
        if level.flight is not None:
            ahead = level.flight - fault.history.number[-1]
            middle = f"at flight {level.flight}, " + (
                f"in {ahead} flights{about(flights, level.flight)} " if ahead > 0
                else "which is past: no flight has told the severity since ")
        lines.append(
            f"{level.level} ({scale * level.severity:.3g} {unit}) expected {middle}"
            f"(90 %: {first} {until})"
        )
    return lines
