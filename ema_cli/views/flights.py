"""A directory of flights for `ema check`: a row a flight, and when each fault was announced."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ema_cli.console import drawing, given_bags, note, progress, stdout, styled
from ema_cli.lines import print_rows, print_text
from ema_cli.views.pictures import save_picture
from ema_cli.views.verdict import STYLES
from ema_prognostics.words import class_name, fault_words
from ema_record.errors import UsageError, counted
from ema_record.record import iso_time

if TYPE_CHECKING:
    from ema_cli.views.machine import Machine
    from ema_prognostics.trend.announcement import Episode
    from ema_prognostics.trend.flights import Flight
    from ema_prognostics.trend.unit_trend import FaultTrend, UnitTrend
    from ema_prognostics.verdict.judge import Judge


LEAST_WIDTHS = (0, 76, 100, 0, 0)
"""Of the terminal on which each column of the flights is shown (characters)."""


def print_sequence(trends: Sequence[UnitTrend], out: Machine | None) -> None:
    """Print the flights of each actuator: a row a flight, or each bag to `out`."""
    for trend in trends:
        if out is not None:
            for flight in trend.flights:
                out.print(out.object_of(flight) | {"flight": flight.number,
                                                   "repeat_of": flight.repeat_of})
            continue
        print_flights(trend)
        for line in fault_lines(trend):
            print_text(line, stdout())


def draw_sequence(trends: Sequence[UnitTrend], plot: Path) -> None:
    """Plot the flights of one actuator into a PNG; UsageError if there are several."""
    if len(trends) > 1:
        held = ", ".join(f"{t.serial_number or 'not known'}: {len(t.flights)}" for t in trends[:6])
        raise UsageError(
            f"flights of {len(trends)} actuators ({held}), a plot shows one: keep the bags of an "
            "actuator in a directory of its own"
        )
    with drawing():
        from ema_cli.views.flights_plot import trend_figure

        save_picture(trend_figure(trends[0]), plot)
    note(f"plot: {plot}")


def judged_flights(paths: Sequence[Path], judge: Judge) -> dict[str, list[Flight]]:
    """Return the flights of each actuator: bags given one by one, or by directory.

    Raises
    ------
    InvalidRecordError
        A directory without a bag.
    """
    from ema_prognostics.trend.flights import Flight, by_unit

    bags, flights = given_bags(paths), []
    with progress(f"checking {len(bags)} bags", len(bags)) as advance:
        for done, bag in enumerate(bags, start=1):
            flights.append(Flight(**judge.of_bag(bag)._asdict()))
            advance(done)
    return by_unit(flights)


def print_flights(trend: UnitTrend) -> None:
    """Print one row a flight."""
    console = stdout()
    console.print(styled((f"Actuator {unit_name(trend)}", "bold"),
                         f", {counted(len(trend.flights), 'flight')}"))
    shown = [k for k, least in enumerate(LEAST_WIDTHS) if console.width >= least]
    rows = []
    for flight in trend.flights:
        outcome = flight.verdict.outcome
        time = (iso_time(flight.start_time) or "not known")[:16].replace("T", " ")
        cells = (
            str(flight.number), time, Path(flight.verdict.bag).name,
            (outcome.upper(), STYLES.get(outcome, "bold")), "; ".join(_findings(flight)),
        )
        rows.append([cells[k] for k in shown])
    header = ("flight", "start (UTC)", "bag", "verdict", "severity (interval)")
    print_rows([header[k] for k in shown], rows, console)


def unit_name(trend: UnitTrend) -> str:
    """Return the serial number, or that no bag tells it."""
    return trend.serial_number or "of which no bag tells the serial number"


def _findings(flight: Flight) -> list[str]:
    """Return each fault with its severity and level, or why there is no answer."""
    verdict = flight.verdict
    if flight.repeat_of is not None:
        return [f"copy of flight {flight.repeat_of}, not counted again"]
    if verdict.outcome == "healthy":
        return []
    if verdict.outcome != "fault":
        return [reason.removeprefix(f"{verdict.bag}: ") for reason in verdict.reasons[:1]]
    return [
        ", ".join(part for part in (
            fault_words(f.fault_class, f.phase, f.severity, f.severity_interval),
            f.level or "",
        ) if part) for f in verdict.faults
    ]


def about(flights: Sequence[Flight], number: int) -> str:
    """Return the day of a flight that is ahead in words, empty where not known."""
    from ema_prognostics.trend.flights import date_of

    date = date_of(flights, number)
    return "" if date is None else f", about {date:%Y-%m-%d}"


def fault_lines(trend: UnitTrend) -> list[str]:
    """Return, in words, what the flights say together."""
    lines = []
    for fault in trend.faults:
        name = class_name(fault.history.fault_class, fault.history.phase)
        lines += [f"{name}: {text}"
                  for text in (*map(episode_text, fault.episodes), *fall_lines(fault))]
    for name, at in trend.suspected.items():
        lines.append(
            f"{class_name(name)}: its probability rises from flight to flight, suspected "
            f"from flight {at}; no flight had announced it by then"
        )
    count = len(trend.flights) - len(trend.copies)
    if not lines and len(trend.unanswered) < count:
        lines.append("no fault announced")
    if trend.unanswered:
        lines.append(
            f"{len(trend.unanswered)} of {counted(count, 'flight')} gave no answer "
            f"and count neither as healthy nor as faulty: {number_list(trend.unanswered)}"
        )
    return lines


def copies_text(trend: UnitTrend) -> str:
    """Return which bags are copies of flights that count, in words."""
    return "the same flight once more, not counted again: " + number_list([
        f"{Path(f.verdict.bag).name} (flight {f.repeat_of})"
        for f in trend.flights if f.repeat_of is not None])


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
    return [f"clearly smaller from flight {at}, repaired or replaced; the trend begins there"
            for at in fault.falls]


def number_list(numbers: Sequence[int | str]) -> str:
    """Return numbers with a comma between, the first few of many."""
    text = ", ".join(map(str, numbers[:12]))
    return text + (f" and {len(numbers) - 12} more" if len(numbers) > 12 else "")


def trend_object(trend: UnitTrend, out: Machine) -> dict[str, Any]:
    """Return the JSON object of a trend, with the verdict of each flight."""
    return {
        **trend.to_dict(),
        "verdicts": [
            {"flight": f.number, "start_time": f.start_time, "repeat_of": f.repeat_of,
             **out.object_of(f)} for f in trend.flights
        ],
    }
