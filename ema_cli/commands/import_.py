"""`ema import`: a file of another tool, or a bag of ROS 2, becomes a bag of a rig."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ema_cli.console import check_new, check_new_file, note, print_json, progress, say
from ema_cli.lines import say_lines
from ema_cli.options import given_once
from ema_record.errors import UsageError

if TYPE_CHECKING:
    import numpy as np

    from ema_rig.guess import Guess
    from ema_rig.map import RigMap
    from ema_rig.record import RigRecord

ROWS = 5
"""Rows of a preview."""
POINTS = 4000
"""Most points of a line; of each interval its smallest and its largest value."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#7F7F7F", "#E69F00")


def import_(
    file: Annotated[Path, typer.Argument(
        metavar="FILE", help="A bag of ROS 2 (MCAP, sqlite3), CSV or other text (also gzip), "
        "XLSX, MAT, HDF5, NPZ, Parquet.")],
    map_file: Annotated[Path | None, typer.Option(
        "--map", "-m", metavar="MAP.yaml", show_default="guessed from the file",
        help="Which column is what, its unit, and what the axis is.")] = None,
    out: Annotated[Path | None, typer.Option(
        "--out", "-o", metavar="BAG", show_default="the name in the map",
        help="The directory to make; with --guess the map, with --preview the picture.")] = None,
    topic: Annotated[str | None, typer.Option(
        metavar="TOPIC", help="Of a bag: the topic, for example /joint_states.")] = None,
    joint: Annotated[str | None, typer.Option(
        metavar="NAME", help="Of a bag: the joint that the topic lists.")] = None,
    changes: Annotated[list[str] | None, typer.Option(
        "--set", metavar="KEY=VALUE", help="Change the map: axis=linear, input.unit=A, "
        "speed.scale=-1; repeatable.")] = None,
    guess: Annotated[bool, typer.Option(
        "--guess", help="Only write the map that is guessed from the file.")] = False,
    preview: Annotated[bool, typer.Option(
        "--preview", help="Only show the map, the first rows in SI, and a picture.")] = False,
    as_json: Annotated[bool, typer.Option(
        "--json", help="Print what was read and written as JSON.")] = False,
) -> int:
    """Convert a file of a rig (ROS 2 bag, CSV, XLSX, MAT, HDF5, ...) to a bag.

    The map names columns, units and the axis; docs/rigs.md shows the form. Without one it is
    guessed: a joint of a JointState needs none, and a text file none that names columns and units.
    Outputs that exist are never overwritten.

    Example: `ema import bag --topic /joint_states --joint elbow --out elbow`
    """
    from ema_rig.map import map_from

    if guess and map_file is not None:
        raise UsageError("--guess writes a map, --map gives one: leave one of them out")
    changes = changes or []
    given_once("--set", changes)
    told = dict(change.partition("=")[::2] for change in changes)
    guessed = _map(file, map_file, topic, joint, told)
    guessed.data = _changed(guessed.data, changes)
    if guess:
        return _write_guess(guessed, file, out, as_json)
    rig_map = map_from(guessed.data, str(map_file or "guessed map"))
    if preview:
        return _preview(file, rig_map, guessed, out, as_json)
    open_ = [line for line in guessed.supposed if line.partition(":")[0] not in told]
    if open_:
        keys = " ".join(f"--set {line.partition(':')[0]}=..." for line in open_)
        raise UsageError(f"{file}: not known from the file: {'; '.join(open_)}: say {keys}, "
                         "or write the map with --guess")
    return _import(file, rig_map, out or Path(rig_map.name), as_json, guessed.remarks)


def _map(
    file: Path, map_file: Path | None, topic: str | None, joint: str | None,
    told: dict[str, str],
) -> Guess:
    """Return the map that a file gives, as a guess that supposes nothing, or a guess."""
    from ema_record.bag.any_topic import is_bag
    from ema_record.yaml_file import load_yaml
    from ema_rig.guess import Guess, guess_map

    if map_file is None:
        with progress(f"looking at {file}"):
            if told.get("axis") == "actuator":
                raise UsageError("a map of an actuator is not guessed: give --map with 'channels'")
            return guess_map(file, topic, joint, told)
    data = load_yaml(map_file)
    if (topic or joint) and file.exists() and not is_bag(file):
        raise UsageError(f"{file}: --topic and --joint are for bags of ROS 2: leave them out")
    if isinstance(data, dict) and (topic or joint):
        bag = data["bag"] if isinstance(data.get("bag"), dict) else {}
        given = {"topic": topic, "joint": joint}
        data = {**data, "bag": {**bag, **{k: v for k, v in given.items() if v}}}
    return Guess(data=data)


def _changed(data: Any, changes: list[str]) -> Any:
    """Return the map with ``a.b=value`` set, the value as YAML reads it."""
    from ema_record.yaml_file import yaml_of

    if not isinstance(data, dict):
        return data
    for change in changes:
        key, mark, text = change.partition("=")
        names = key.strip().split(".")
        if not mark or not all(names):
            raise UsageError(f"--set {change[:60]!r}: write KEY=VALUE, as input.unit=A")
        try:
            value = yaml_of(text, "--set")
        except UsageError:
            raise UsageError(f"--set {change[:60]!r}: the value is no YAML: put it in quotes"
                             ) from None
        if names[-1] in ("column", "unit") and not isinstance(value, int | str):
            value = text
        place = data = dict(data)
        for name in names[:-1]:
            inner = place.get(name)
            place[name] = dict(inner) if isinstance(inner, dict) else {}
            place = place[name]
        place[names[-1]] = value
    return data


def _write_guess(guessed: Guess, file: Path, out: Path | None, as_json: bool) -> int:
    """Write the map that was guessed."""
    from ema_record.files import new_file

    target = out if out is not None and out.suffix in (".yaml", ".yml") else Path(
        f"{out or guessed.data.get('name', 'rig')}.map.yaml")
    check_new_file(target)
    text = guessed.text(str(file))
    with new_file(target) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")
    if as_json:
        print_json({"map": guessed.data, "written": str(target), "supposed": guessed.supposed,
                    "remarks": guessed.remarks})
        return 0
    say_lines(text)
    say(f"written: {target}")
    return 0


def _preview(file: Path, rig_map: RigMap, guessed: Guess, out: Path | None, as_json: bool) -> int:
    """Show what the map makes of the file."""
    import yaml

    from ema_record.record import Record
    from ema_rig.import_file import import_file

    picture = out if out is not None and out.suffix == ".png" else Path(
        f"{out or rig_map.name}-preview.png")
    check_new_file(picture)
    with progress(f"reading {file}"):
        record = import_file(file, rig_map)
    if isinstance(record, Record):
        raise UsageError("--preview is for a rig: import the bag, then plot it with 'ema export "
                         "BAG --plot DIR'")
    _draw(record, picture)
    rows = [[channel.label for channel in record.channels],
            *([f"{value:.6g}" for value in row] for row in record.samples[:ROWS])]
    remarks = [*guessed.remarks, *record.axis.notes]
    if as_json:
        print_json({"map": rig_map.model_dump(exclude_defaults=True), "rows": rows,
                    "supposed": guessed.supposed, "remarks": remarks, "picture": str(picture)})
        return 0
    say_lines(yaml.safe_dump(rig_map.model_dump(mode="json", exclude_defaults=True),
                             sort_keys=False, allow_unicode=True))
    for line in (*(f"supposed: {line}" for line in guessed.supposed), *remarks):
        say(f"# {line}")
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows:
        say("  ".join(cell.rjust(width) for cell, width in zip(row, widths)))
    say(f"{len(record)} samples, {record.duration:.4g} s at {record.rate:.5g} 1/s; picture: "
        f"{picture}")
    return 0


def _draw(record: RigRecord, path: Path) -> None:
    """Draw each channel over time into a PNG that is new."""
    from matplotlib.figure import Figure

    from ema_cli.views.pictures import save_picture

    channels = record.channels[1:]
    figure = Figure(figsize=(8.0, 1.7 * len(channels) + 0.5), layout="constrained")
    axes = figure.subplots(len(channels), 1, sharex=True, squeeze=False)[:, 0]
    for k, (axis, channel) in enumerate(zip(axes, channels)):
        axis.plot(*_thinned(record.time, record.samples[:, k + 1]), linewidth=0.8,
                  color=COLOURS[k % len(COLOURS)])
        axis.set_ylabel(f"{channel.name.replace('_', ' ')}\n({channel.unit})")
        axis.grid(visible=True, color="#DDDDDD")
    axes[-1].set_xlabel("time (s)")
    figure.suptitle(f"{record.axis.name}: {len(record)} samples at {record.rate:.4g} 1/s")
    save_picture(figure, path)


def _thinned(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a line of at most `POINTS` points that looks the same."""
    import numpy as np

    step = len(values) // (POINTS // 2)
    if step < 2:
        return time, values
    count = len(values) // step
    blocks = values[:count * step].reshape(count, step)
    both = np.sort(np.column_stack([blocks.argmin(axis=1), blocks.argmax(axis=1)]), axis=1)
    rows = (both + step * np.arange(count)[:, None]).ravel()
    return time[rows], values[rows]


def _import(file: Path, rig_map: RigMap, out: Path, as_json: bool, remarks: list[str]) -> int:
    """Write the bag and say what was done."""
    from ema_record.bag.read import write_bag
    from ema_record.channels import CHANNELS
    from ema_record.record import Record
    from ema_rig.bag import write_rig_bag
    from ema_rig.import_file import import_file

    check_new(out, bag=True)
    done: list[str] = []
    with progress(f"reading {file}"):
        record = import_file(file, rig_map, done)
    with progress(f"writing {out}"):
        if isinstance(record, Record):
            written = write_bag(record, out)
            channels = [CHANNELS[column].label for column in record.columns]
        else:
            written = write_rig_bag(record, out)
            channels = [channel.label for channel in record.channels]
    notes = [*remarks, *done]
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
