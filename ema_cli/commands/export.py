"""`ema export`: a bag in the formats of other tools, and as plots."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ema_cli.console import check_new, check_new_file, drawing, print_json, progress, say


def export(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="Bag to convert.")],
    file_format: Annotated[
        str | None,
        typer.Option(
            "--format", "-f", metavar="csv|parquet|mcap", show_default="csv",
            help="mcap: a bag of standard messages, one a sample, for plotters.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FILE", show_default="beside the bag",
            help="What to write; for mcap a directory.",
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            "--plot", metavar="DIR",
            help="Plot the test, as PNG into DIR; without --format and --out nothing else.",
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print what was written as JSON.")
    ] = False,
) -> int:
    """Convert a bag to CSV, Parquet or messages for plotters; plot it.

    Outputs that exist are never overwritten.

    Example: `ema export bags/sim_0000_step --format csv --out healthy.csv`
    """
    from ema_record.bag.export import FORMATS, default_path, export_record
    from ema_record.bag.read import read_bag
    from ema_record.errors import unknown_name

    chosen = file_format or "csv"
    if chosen not in FORMATS:
        raise unknown_name("format", chosen, FORMATS, f"the formats are {', '.join(FORMATS)}")
    plot_only = plot is not None and file_format is None and out is None
    target = None if plot_only else out or default_path(bag, chosen)
    if chosen == "mcap":
        check_new(target)
    else:
        check_new_file(target)
    if plot is not None:
        from ema_cli.views.record_plots import check_plot_folder

        check_plot_folder(plot)
    record = read_bag(bag)
    written: list[Path] = []
    if target is not None:
        with progress(f"writing {target}"):
            written.append(export_record(record, target, chosen))
        if not as_json:
            say(str(written[0]))
    plots: list[Path] = []
    try:
        if plot is not None:
            with drawing():
                from ema_cli.views.record_plots import plot_record

                plots = plot_record(record, plot)
    finally:  # a picture that fails takes nothing else with it
        if as_json:
            print_json({
                "bag": str(bag), "format": None if target is None else chosen,
                "samples": len(record), "written": [str(path) for path in [*written, *plots]],
            })
    if not as_json:
        for path in plots:
            say(str(path))
    return 0
