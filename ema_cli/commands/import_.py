"""`ema import`: a file of another tool becomes a bag."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ema_cli.console import check_new, note, print_json, progress, say


def import_(
    file: Annotated[Path, typer.Argument(
        metavar="FILE", help="CSV or other text (also gzip), MAT (v5), NPZ.")],
    map_file: Annotated[Path, typer.Option(
        "--map", "-m", metavar="MAP.yaml",
        help="Which column is what, its unit, and what the axis is.")],
    out: Annotated[Path, typer.Option(
        "--out", "-o", metavar="BAG", help="The directory to make.")],
    as_json: Annotated[bool, typer.Option(
        "--json", help="Print what was read and written as JSON.")] = False,
) -> int:
    """Convert a file of a rig (CSV, MAT, NPZ) to a bag, by a map of it.

    The map names columns, units and the axis; docs/rigs.md shows the form. Outputs that exist
    are never overwritten.

    Example: `ema import run.csv --map rig.yaml --out run`
    """
    from ema_record.bag.read import write_bag
    from ema_record.channels import CHANNELS
    from ema_record.record import Record
    from ema_rig.bag import write_rig_bag
    from ema_rig.import_file import import_file
    from ema_rig.map import load_map

    check_new(out)
    rig_map = load_map(map_file)
    with progress(f"reading {file}"):
        record = import_file(file, rig_map)
    with progress(f"writing {out}"):
        if isinstance(record, Record):
            written = write_bag(record, out)
            channels = [CHANNELS[column].label for column in record.columns]
            notes: list[str] = []
        else:
            written = write_rig_bag(record, out)
            channels = [channel.label for channel in record.channels]
            notes = list(record.axis.notes)
    if as_json:
        print_json({"bag": str(written), "samples": len(record), "rate": record.rate,
                    "duration": record.duration, "channels": channels, "notes": notes})
        return 0
    for line in notes:
        note(line)
    say(str(written))
    say(f"{len(record)} samples, {record.duration:.4g} s at {record.rate:.5g} 1/s: "
        f"{', '.join(channels)}")
    return 0
