"""A directory of flights for `ema check`: a row a flight, and when each fault was announced."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ema_cli.console import check_new, note, print_json, progress, stdout
from ema_cli.views.verdict import NAMES, SCALES, STYLES
from ema_record.errors import InvalidRecordError, UsageError

if TYPE_CHECKING:
    from rich.console import Console

    from ema_cli.judge import Judge
    from ema_prognostics.trend.announcement import Episode
    from ema_prognostics.trend.flights import Flight
    from ema_prognostics.trend.trend import FaultTrend, UnitTrend


REASON = 72
"""Length (characters) of a reason in a row; all of them are in the JSON objects."""


def check_sequence(
    directory: Path, judge: Judge, *, json: bool = False, plot: Path | None = None
) -> list[int]:
    """Judge the bags of a directory, print them, and return the exit status of each.

    Parameters
    ----------
    directory : holds one bag a flight (`trend_flights.is_sequence`).
    judge : from a bag to its verdict.
    json : print one JSON object a bag, in the order of the flights.
    plot : PNG to write; the flights must then be of one actuator.
    """
    from ema_prognostics.trend.trend import trend_of

    units = judged_flights([directory], judge)
    if plot is not None:
        only_one(units, "a plot shows one")
    for serial_number, flights in units.items():
        if json:
            for flight in flights:
                print_json(flight.verdict.to_dict())
            continue
        trend = trend_of(serial_number, flights)
        print_flights(trend, stdout())
        print_faults(trend, stdout())
    if plot is not None:
        from ema_cli.views.flights_plot import plot_trend

        ((serial_number, flights),) = units.items()
        note(f"plot: {plot_trend(trend_of(serial_number, flights), plot)}")
    return [f.verdict.exit_status for flights in units.values() for f in flights]


def check_plot(plot: Path | None, directories: Sequence[Path]) -> None:
    """Raise UsageError unless a plot can be made: one directory, a file that is new."""
    if plot is None:
        return
    if len(directories) != 1:
        raise UsageError(
            f"--plot {plot}: {len(directories)} directories of flights given, a plot shows one: "
            "give one directory that holds bags"
        )
    check_new(plot)


def judged_flights(paths: Sequence[Path], judge: Judge) -> dict[str, list[Flight]]:
    """Return the flights of each actuator: bags given one by one, or by directory.

    Raises
    ------
    InvalidRecordError
        A directory without a bag.
    """
    from ema_prognostics.trend.flights import Flight, bags_of, is_sequence, read_flights

    bags: list[Path] = []
    for path in paths:
        if not is_sequence(path):
            bags.append(path)
            continue
        inside, others = bags_of(path)
        if others:
            note(f"{path}: not bags, left out: {', '.join(p.name for p in others[:5])}"
                 + (f" and {len(others) - 5} more" if len(others) > 5 else ""))
        bags += inside
    if not bags:
        raise InvalidRecordError("no bag: give bags, or a directory that holds them")

    def fly(bag: Path) -> Flight:
        verdict, serial_number, start_time = judge(bag)
        return Flight(verdict=verdict, serial_number=serial_number, start_time=start_time)

    with progress(f"checking {len(bags)} bags", len(bags)) as advance:
        return read_flights(bags, fly, advance)


def only_one(units: dict[str, list[Flight]], why: str) -> None:
    """Raise UsageError unless all flights are of one actuator."""
    if len(units) > 1:
        held = ", ".join(
            f"{unit or 'not known'}: {len(found)}" for unit, found in list(units.items())[:6]
        )
        raise UsageError(
            f"flights of {len(units)} actuators ({held}), {why}: keep the bags of an actuator in "
            "a directory of its own"
        )


def print_flights(trend: UnitTrend, console: Console) -> None:
    """Print one row a flight."""
    from rich.text import Text

    name = trend.serial_number or "of which no bag tells the serial number"
    console.print(f"[bold]Actuator {name}[/bold], {counted(len(trend.flights))}")
    bags = [shortened(Path(f.verdict.bag).name, 28) for f in trend.flights]
    width = max(3, *map(len, bags))
    head = f"flight  {'start (UTC)':<16}  {'bag':<{width}}  {'verdict':<10}  severity (interval)"
    console.print(Text(head, style="dim"), soft_wrap=True)
    for flight, bag in zip(trend.flights, bags):
        outcome = flight.verdict.outcome
        line = Text(f"{flight.number:>6}  {_time(flight.start_time):<16}  {bag:<{width}}  ")
        line.append(f"{outcome.upper():<10}", style=STYLES.get(outcome, "bold"))
        line.append(f"  {'; '.join(_findings(flight))}")
        line.rstrip()
        console.print(line, soft_wrap=True)


def counted(flights: int) -> str:
    """Return a number of flights in words."""
    return f"{flights} flight{'' if flights == 1 else 's'}"


def shortened(text: str, most: int) -> str:
    """Return `text`, its middle left out beyond `most` characters."""
    half = (most - 1) // 2
    return text if len(text) <= most else f"{text[:half]}…{text[-half:]}"


def _findings(flight: Flight) -> list[str]:
    """Return each fault with its severity and level, or why there is no answer."""
    verdict = flight.verdict
    if flight.repeat_of is not None:
        return [f"copy of flight {flight.repeat_of}, not counted again"]
    if verdict.outcome == "healthy":
        return []
    if verdict.outcome != "fault":
        reasons = [reason.removeprefix(f"{verdict.bag}: ") for reason in verdict.reasons[:1]]
        return [r if len(r) <= REASON else r[:REASON - 1] + "…" for r in reasons]
    return [
        ", ".join(part for part in (
            f"{fault_name(f.fault_class, f.phase)} "
            f"{severity_text(f.fault_class, f.severity, f.severity_interval)}".rstrip(),
            f.level or "",
        ) if part) for f in verdict.faults
    ]


def _time(start_time: int) -> str:
    if not start_time:
        return "not known"
    return datetime.fromtimestamp(start_time / 1e9, tz=timezone.utc).strftime("%Y-%m-%d %H:%M")


def fault_name(fault_class: str, phase: str | None) -> str:
    """Return a fault in words."""
    return NAMES.get(fault_class, fault_class) + (f", phase {phase}" if phase else "")


def severity_text(
    fault_class: str, severity: float | None, interval: Sequence[float] | None
) -> str:
    """Return a severity with its interval, in the unit that a person reads."""
    if severity is None:
        return ""
    scale, unit = SCALES.get(fault_class, (1.0, ""))
    text = f"{scale * severity:.3g} {unit.split()[0] if unit else ''}".rstrip()
    if interval:
        text += f" ({scale * interval[0]:.3g} to {scale * interval[1]:.3g})"
    return text


def print_faults(trend: UnitTrend, console: Console) -> None:
    """Print when each fault was announced, confirmed and gone, and how flights fell out."""
    for line in fault_lines(trend):
        console.print(line, markup=False)


def fault_lines(trend: UnitTrend) -> list[str]:
    """Return, in words, what the flights say together."""
    lines = []
    for fault in trend.faults:
        lines += [
            f"{fault_name(fault.history.fault_class, fault.history.phase)}: {episode_text(e)}"
            for e in fault.episodes
        ]
        lines += fall_lines(fault)
    for name, at in trend.suspected.items():
        lines.append(
            f"{NAMES.get(name, name)}: its probability rises from flight to flight, suspected "
            f"from flight {at}; no flight had announced it by then"
        )
    if not lines and len(trend.unanswered) < len(trend.flights):
        lines.append("no fault announced")
    if trend.unanswered:
        lines.append(
            f"{len(trend.unanswered)} of {counted(len(trend.flights))} gave no answer and count "
            f"neither as healthy nor as faulty: {number_list(trend.unanswered)}"
        )
    return lines


def episode_text(episode: Episode) -> str:
    """Return when a fault came and went, in words."""
    text = f"first announced at flight {episode.first}, "
    text += (
        f"confirmed at flight {episode.confirmed}" if episode.confirmed is not None
        else "not confirmed"
    )
    if episode.cleared is not None:
        text += (
            f", gone from flight {episode.cleared}: repaired" if episode.repaired
            else f", no longer found from flight {episode.cleared}"
        )
    return text


def fall_lines(fault: FaultTrend) -> list[str]:
    """Return where a fault fell without vanishing."""
    name = fault_name(fault.history.fault_class, fault.history.phase)
    return [
        f"{name}: clearly smaller from flight {at}, repaired or replaced; the trend begins there"
        for at in fault.falls
    ]


def number_list(numbers: Sequence[int], most: int = 12) -> str:
    """Return numbers with a comma between, the first few of many."""
    text = ", ".join(str(n) for n in numbers[:most])
    return text + (f" and {len(numbers) - most} more" if len(numbers) > most else "")


def verdict_object(trend: UnitTrend) -> dict[str, Any]:
    """Return the JSON object of a trend, with the verdict of each flight."""
    return {
        **trend.to_dict(),
        "verdicts": [
            {"flight": f.number, "start_time": f.start_time, "repeat_of": f.repeat_of,
             **f.verdict.to_dict()} for f in trend.flights
        ],
    }
