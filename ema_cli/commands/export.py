"""`ema export`: a bag, or an identified axis, in the formats of other tools; plots of a bag."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ema_cli.console import (
    check_new,
    check_new_file,
    drawing,
    given_bags,
    note,
    print_json,
    progress,
    say,
)
from ema_record.errors import UsageError, unknown_name
from ema_record.files import check_apart


def export(
    bags: Annotated[list[Path], typer.Argument(
        metavar="BAG...", help="Bags to convert, or directories of them; or the model.yaml of an "
        "identified rig.")],
    file_format: Annotated[str | None, typer.Option(
        "--format", "-f", metavar="csv|parquet|mcap", show_default="by the ending, or csv",
        help="mcap: a bag of standard messages, one a sample, for plotters. Of a model: "
        "mjcf|urdf|python.")] = None,
    out: Annotated[Path | None, typer.Option(
        "--out", "-o", metavar="FILE", show_default="beside the bag",
        help="What to write, of a single bag; for mcap a directory.")] = None,
    plot: Annotated[Path | None, typer.Option(
        "--plot", metavar="DIR", help="Plot the test, as PNG into DIR (of several bags, each into "
        "a folder of its own there); without --format and --out nothing else.")] = None,
    gain: Annotated[float | None, typer.Option(
        metavar="N", help="Of a model: force (N) or torque (N m) at the axis a unit "
        "of the input (A or V).")] = None,
    body_inertia: Annotated[float, typer.Option(
        metavar="J", help="Of a model: inertia about the axis (kg m2; linear: mass, kg) "
        "that the simulator's bodies have; the armature is the rest.")] = 0.0,
    as_json: Annotated[bool, typer.Option(
        "--json", help="Print what was written as JSON.")] = False,
) -> int:
    """Convert a bag to CSV, Parquet or messages for plotters; plot it; a rig's model to MJCF.

    The model.yaml that `ema identify` wrote of a rig becomes a joint of MJCF or URDF, or a Python
    module (--format mjcf, urdf, python); what the format has no place for is said.

    Outputs that exist are never overwritten.

    Example: `ema export bags/sim_0000_step --format csv --out healthy.csv`
    """
    from ema_record.bag.export import FORMATS, default_path

    if any(path.suffix in (".yaml", ".yml") for path in bags):
        return _export_model(bags, file_format or "mjcf", out, plot, gain, body_inertia, as_json)
    if gain is not None or body_inertia:
        raise UsageError("--gain and --body-inertia are for the model.yaml of a rig: leave them "
                         "out")
    told = {".csv": "csv", ".parquet": "parquet"}.get(out.suffix) if out is not None else None
    if out is not None and out.suffix and (told, file_format) == (None, None):
        raise UsageError(f"--out {out}: {out.suffix} is the ending of no format: .csv or "
                         ".parquet, or say which with --format")
    chosen = file_format or told or "csv"
    if chosen not in FORMATS:
        raise unknown_name("format", chosen, FORMATS, f"the formats are {', '.join(FORMATS)}")
    if told not in (None, chosen):
        raise UsageError(f"--out {out}: ends as {told}, but --format is {chosen}: make them agree")
    found = given_bags(bags)
    if out is not None and len(found) > 1:
        raise UsageError(f"--out {out}: {len(found)} bags: leave it out, each is then written "
                         "beside its bag")
    plot_only = plot is not None and file_format is None and out is None
    jobs: list[tuple[Path, Path | None, Path | None]] = []
    for bag in found:
        target = None if plot_only else out or default_path(bag, chosen)
        (check_new if chosen == "mcap" else check_new_file)(target)
        folder = plot / bag.name if plot is not None and len(found) > 1 else plot
        if folder is not None:
            from ema_cli.views.record_plots import check_plot_folder

            check_plot_folder(folder)
        check_apart(target, folder)
        jobs.append((bag, target, folder))
    for job in jobs:
        _export(*job, chosen, as_json)
    return 0


def _export_model(
    files: list[Path], file_format: str, out: Path | None, plot: Path | None,
    gain: float | None, body_inertia: float, as_json: bool,
) -> int:
    """Write the model of a rig for a simulator and say what it does not hold."""
    from ema_identification.rig.export import MODEL_FORMATS, export_model
    from ema_record.files import new_file

    if len(files) > 1 or plot is not None:
        raise UsageError("a model is exported alone, without --plot: give one model.yaml")
    found = export_model(files[0], file_format, gain=gain, body_inertia=body_inertia)
    target = out or files[0].with_suffix(MODEL_FORMATS[file_format])
    check_new_file(target)
    with new_file(target) as temporary:
        temporary.write_text(found.text, encoding="utf-8")
    if as_json:
        print_json({"model": str(files[0]), "format": file_format, "written": str(target),
                    "left_out": list(found.left_out)})
        return 0
    say(str(target))
    for line in found.left_out:
        note(f"not exported, as {file_format} has no place for it: {line}")
    return 0


def _export(
    bag: Path, target: Path | None, folder: Path | None, file_format: str, as_json: bool
) -> None:
    """Write a bag to `target` and plot it into `folder`, each unless None, and say so."""
    from ema_record.bag.export import export_record
    from ema_record.bag.read import read_bag

    record = read_bag(bag)
    written: list[Path] = []
    if target is not None:
        with progress(f"writing {target}"):
            written.append(export_record(record, target, file_format))
        if not as_json:
            say(str(written[0]))
    plots: list[Path] = []
    try:
        if folder is not None:
            with drawing():
                from ema_cli.views.record_plots import plot_record

                plots = plot_record(record, folder)
    finally:  # a picture that fails takes nothing else with it
        if as_json:
            print_json({
                "bag": str(bag), "format": None if target is None else file_format,
                "samples": len(record), "written": [str(path) for path in [*written, *plots]],
            })
    if not as_json:
        for path in plots:
            say(str(path))
