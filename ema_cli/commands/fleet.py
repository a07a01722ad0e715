"""`ema fleet`: the units of all bags below folders, worst first."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ema_cli.console import note, print_json, progress, say
from ema_cli.lines import say_lines
from ema_cli.options import Cascade, Commanded, Format, Rule
from ema_cli.views.machine import check_format
from ema_record.errors import EmaError, UsageError

if TYPE_CHECKING:
    from ema_prognostics.fleet.fleet import Fleet

LEAST_PAUSE, MOST_PAUSE = 0.5, 604_800
"""Between two looks at the folders (s)."""


def fleet(
    folders: Annotated[list[Path], typer.Argument(
        metavar="DIR...", help="Folders that hold bags, however deep; or bags.")],
    rule: Rule = "2/3",
    profile: Commanded = None,
    model: Cascade = None,
    html: Annotated[Path | None, typer.Option(
        metavar="FILE.html", help="One page: a tile a unit, worst first.")] = None,
    parquet: Annotated[Path | None, typer.Option(
        metavar="FILE.parquet", help="All verdicts, a row a fault, for DuckDB, pandas, Grafana."
    )] = None,
    metrics: Annotated[Path | None, typer.Option(
        metavar="FILE.prom", help="State of the units as OpenMetrics text, for a textfile "
        "collector.")] = None,
    watch: Annotated[float | None, typer.Option(
        metavar="SECONDS", min=LEAST_PAUSE, max=MOST_PAUSE,
        help="Look again after so long, until Ctrl-C.")] = None,
    jobs: Annotated[int | None, typer.Option(
        min=1, max=1024, show_default="one a core", help="Processes that judge.")] = None,
    dask: Annotated[str | None, typer.Option(
        metavar="ADDRESS", help="Scheduler of a cluster that judges. Whoever answers there runs "
        "code in this process: only one that you trust, on a private network.")] = None,
    json: Annotated[bool, typer.Option("--json", help="As --format json, one object.")] = False,
    form: Format = "text",
) -> int:
    """Show a fleet at a glance: every unit whose bags lie below folders, worst first.

    A bag is judged once: its verdict is kept in the user's cache under the hash of its content,
    of the kit and of the software, and is used again while all three are the same.

    Files of an earlier 'ema fleet' are replaced as a whole, others are never overwritten. The
    page links a unit to the report of its last bag, BAG.html beside it, where there is one.

    Exit status: 0 no unit has a confirmed fault, 1 one has, 3 one has an announced fault or no
    answer; 2 wrong use, or no bag.

    Example: `ema fleet bags --html fleet.html`
    """
    from ema_cli.pages.fleet_files import check_files, write_files
    from ema_cli.views.fleet_table import print_fleet
    from ema_prognostics.fleet.fleet import read_fleet
    from ema_prognostics.fleet.tables import csv_text
    from ema_prognostics.trend.announcement import parse_rule

    form, chosen = check_format(form, json=json), parse_rule(rule)
    if watch is not None and form != "text":
        raise UsageError(f"--watch with --format {form}: give --parquet, --metrics or --html, "
                         "which are kept up to date, or leave --watch out")
    check_files(html, parquet, metrics)

    def look() -> Fleet:
        with progress("judging bags", 1.0) as advance:
            return read_fleet(
                folders, model=model, profile=profile, rule=chosen, jobs=jobs, dask=dask,
                progress=lambda done, of: advance(done / of))

    def show(found: Fleet) -> None:
        if form == "json":
            print_json(found.to_dict())
        elif form == "csv":
            for place, one in enumerate(found.objects):
                say_lines(csv_text(one, header=place == 0))
        else:
            print_fleet(found)

    write = partial(write_files, html=html, parquet=parquet, metrics=metrics)
    found = look()
    show(found)
    write(found)
    for path in (html, parquet, metrics):
        if path is not None:
            note(f"wrote {path}")
    if watch is not None:
        _watch(found, look, show, write, watch)
    states = {unit.state for unit in found.units}
    return 1 if "fault" in states else 3 if states - {"healthy"} else 0


def _watch(
    seen: Fleet, look: Callable[[], Fleet], show: Callable[[Fleet], None],
    write: Callable[[Fleet], None], pause: float,
) -> None:
    """Look again and again; show what is there where it has changed. Ends with Ctrl-C.

    A disk that is full or away for a while is told, and looked at again.
    """
    told = ""
    while True:
        time.sleep(pause)
        try:
            found = look()
            changed = found.objects != seen.objects
            if changed:
                say("")
                show(found)
                seen = found
            if changed or told:
                write(found)
            told = ""
        except EmaError as error:
            if str(error) != told:
                note(f"{error}; looking again")
            told = str(error)
