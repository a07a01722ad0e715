"""`ema trend` of any axis: its records in their order, what moved in words, and a plot."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ema_cli.console import drawing, given_bags, note, progress_of
from ema_record.errors import EmaError, InvalidRecordError, UsageError, counted, unknown_name

if TYPE_CHECKING:
    from ema_prognostics.trend.values import ValueTrend
    from ema_rig.record import RigRecord

EPOCH = 1e9
"""Times above it (s) are dates, and order the records."""
MAX_PANELS = 10
MOST_LEFT_OUT = 12
"""Records without values that are told, the last ones."""


@dataclass(frozen=True, kw_only=True)
class RigTrend:
    """The values of one axis over its records."""

    axis: str
    sources: tuple[str, ...]
    """In their order; records are numbered from 1."""
    unread: dict[int, str]
    """Records that give nothing, with the reason."""
    values: tuple[ValueTrend, ...]
    ordered_by: str
    ends_unread: bool = False
    """Whether the last record gives nothing, or a file cannot be read, which may be the last."""

    @property
    def exit_status(self) -> int:
        """0 nothing moved, 1 a limit is passed, 2 nothing could be read.

        3 something moved, or it is not known how it is now (`ends_unread`).
        """
        if not self.values:
            return 2
        if any(v.limit is not None and v.limit.passed for v in self.values):
            return 1
        return 3 if self.ends_unread or any(v.moves for v in self.values) else 0

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``ema trend --json``."""
        return {
            "axis": self.axis, "ordered_by": self.ordered_by,
            "records": [{"record": k, "source": source, "reason": self.unread.get(k)}
                        for k, source in enumerate(self.sources, start=1)],
            "values": [v.to_dict() for v in self.values],
        }


def first_is_rig(paths: Sequence[Path]) -> bool:
    """Return whether the first bag that can be read is a rig's.

    Raises
    ------
    UsageError
        It is one of ROS 2 that was not imported.
    """
    from ema_record.bag.any_topic import list_topics
    from ema_record.bag.find import bags_of, is_sequence
    from ema_rig.bag import is_rig_bag
    from ema_rig.ros_bag import JOINTS, is_of_an_actuator

    for path in paths:
        for bag in bags_of(path)[0] if is_sequence(path) else [path]:
            try:
                if is_rig_bag(bag):
                    return True
                topics = list_topics(bag)
            except EmaError:
                continue
            if is_of_an_actuator(topics):
                return False
            if any(topic.type in JOINTS for topic in topics.values()):
                raise UsageError(
                    f"{bag}: joint states of ROS 2, which say nothing of the axis: write the map "
                    "once by 'ema import BAG --joint NAME --guess', then give it by --map")
            return False
    return False


def rig_trend(
    paths: Sequence[Path], *, map_file: Path | None, model: Path | None, limits: Sequence[str],
) -> RigTrend:
    """Return the trend of one axis.

    Parameters
    ----------
    paths : bags of a rig, or with `map_file` files that it describes; or directories of them.
    map_file : as for `ema import`.
    model : whose terms are followed; default what the first and the last record show.
    limits : ``NAME=VALUE``, or ``NAME=+P%`` over the mean of the first records.
    """
    from ema_identification.rig.fit.model import load_rig_model
    from ema_identification.rig.follow import follow
    from ema_prognostics.trend.values import value_trend

    asked = dict(_limit(text) for text in limits)
    given = None if model is None else load_rig_model(model)
    records, broken, twins = _records(paths, map_file)
    if len({record.axis.name for record in records}) > 1:
        names = ", ".join(sorted({record.axis.name for record in records})[:6])
        raise UsageError(f"records of several axes ({names}): give those of one at a time, or "
                         "import them under one name (--set name=...)")
    records, ordered_by = _in_order(records)
    with progress_of("trend") as advance:
        found = follow(records, given, advance)
    sources = [*(f.source for f in found), *twins, *broken]
    unread = {k: f.why for k, f in enumerate(found, start=1) if f.why}
    unread.update(enumerate((twins | broken).values(), start=len(found) + 1))
    table: dict[str, dict[int, tuple[float, float, float]]] = {}
    units: dict[str, str] = {}
    for number, one in enumerate(found, start=1):
        for p in one.parameters:
            table.setdefault(p.name, {})[number] = (p.value, p.low, p.high)
            units[p.name] = p.unit
    chosen = _limits_of(asked, table)
    return RigTrend(
        axis=records[0].axis.name if records else "", sources=tuple(sources), unread=unread,
        ordered_by=ordered_by, ends_unread=bool(broken or (found and found[-1].why)),
        values=tuple(
            value_trend(name, units[name], rows, chosen.get(name))
            for name, rows in table.items()))


def _limit(text: str) -> tuple[str, tuple[float, bool]]:
    """Return name, number and whether it is a share of the first value (in %)."""
    match = re.fullmatch(r"([A-Za-z_.()0-9]+)=([+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?)(%?)", text)
    try:
        value = float(match[2]) if match else None
    except ValueError:
        value = None
    if match is None or value is None or not math.isfinite(value):
        raise UsageError(f"--limit {text[:60]!r}: write NAME=VALUE or NAME=+P%, for example "
                         "coulomb_friction.level=+50%")
    return match[1], (value, bool(match[3]))


def _limits_of(
    asked: dict[str, tuple[float, bool]],
    table: dict[str, dict[int, tuple[float, float, float]]],
) -> dict[str, float]:
    """Return the limit of each value that has one; UsageError where a name fits none."""
    chosen: dict[str, float] = {}
    for name, (number, share) in asked.items():
        own = [key for key in table if key == name or key.startswith(f"{name}(")]
        if not own and table:
            raise unknown_name("value", name, table, f"followed are {', '.join(table)}")
        for key in own:
            first = [value for value, _, _ in list(table[key].values())[:3]]
            base = sum(first) / len(first)
            chosen[key] = base * (1.0 + number / 100.0) if share else number
    return chosen


def _records(paths: Sequence[Path], map_file: Path | None
             ) -> tuple[list[RigRecord], dict[str, str], dict[str, str]]:
    """Return the records of bags or files, why others could not be read, and those given again."""
    from ema_rig.bag import read_rig_bag
    from ema_rig.import_file import import_file
    from ema_rig.map import load_map
    from ema_rig.record import RigRecord

    rig_map = None if map_file is None else load_map(map_file)
    records: list[RigRecord] = []
    broken: dict[str, str] = {}
    twins: dict[str, str] = {}
    files = given_bags(paths) if rig_map is None else _files(paths)
    for path in files:
        try:
            record = read_rig_bag(path) if rig_map is None else import_file(path, rig_map)
        except EmaError as error:
            broken[str(path)] = str(error)
            continue
        if not isinstance(record, RigRecord):
            raise UsageError(f"{map_file}: 'axis: actuator' is for bags of the actuator's test: "
                             "import them, then 'ema trend' without --map")
        twin = next((r for r in records if np.array_equal(
            r.samples, record.samples, equal_nan=True)), None)
        if twin is None:
            records.append(record)
        else:
            twins[str(path)] = f"the record of {twin.source} once more, not counted again"
    return records, broken, twins


def _files(paths: Sequence[Path]) -> list[Path]:
    """Return files, and those in directories by name, that a map may describe."""
    from ema_record.bag.any_topic import is_bag
    from ema_record.bag.find import is_sequence, natural
    from ema_rig.import_file import SUFFIXES

    found: list[Path] = []
    for path in paths:
        if not path.is_dir() or (is_bag(path) and not is_sequence(path)):
            found.append(path)
            continue
        found += sorted((p for p in path.iterdir() if not p.name.startswith(".") and (
            p.suffix in SUFFIXES or is_bag(p))), key=lambda p: natural(p.name))
    if not found:
        raise InvalidRecordError("no record: give files, or a directory that holds them")
    return found


def _in_order(records: list[RigRecord]) -> tuple[list[RigRecord], str]:
    """Return records by date where all have one, else by name."""
    from ema_record.bag.find import natural

    if records and all(record.time[0] > EPOCH for record in records):
        return sorted(records, key=lambda r: float(r.time[0])), "date"
    return sorted(records, key=lambda r: natural(r.source)), "name"


def trend_lines(found: RigTrend) -> list[str]:
    """Return what the records say together, a fact a line."""
    total = len(found.sources)
    lines = [f"axis {found.axis or 'not known'}: {counted(total, 'record')} in the order "
             f"of their {found.ordered_by}s, {total - len(found.unread)} of them could be used"]
    lines += [f"  record {k} left out: {why}"
              for k, why in sorted(found.unread.items())[-MOST_LEFT_OUT:]]
    if (more := len(found.unread) - MOST_LEFT_OUT) > 0:
        lines.append(f"  and {counted(more, 'record')} before")
    for value in found.values:
        lines.append(f"  {value.name}: {_now(value)}")
        lines += [f"    another from record {s.record} on: {s.before:.4g} → {s.after:.4g} "
                  f"{value.unit} (change {s.after - s.before:+.3g}, 90 %: {s.interval[0]:+.3g} to "
                  f"{s.interval[1]:+.3g})" for s in value.steps]
        if value.limit is not None:
            lines.append(f"    {_limit_words(value)}")
    return lines


def _now(value: ValueTrend) -> str:
    """Return the value now, and which way it goes."""
    text = f"{value.now:.4g} {value.unit}".rstrip().removesuffix(" 1")
    rise = value.growth
    if rise is None:
        return f"{text}; too few records for a rate"
    sign = value.way or 1
    low, high = sorted(sign * rate for rate in rise.rate_interval)
    rate = (f"{sign * rise.rate:+.2g} a record (90 %: {low:+.2g} to {high:+.2g}, "
            f"{rise.count} records)")
    return f"{text}, {('falls', 'steady', 'rises')[value.way + 1]}: {rate}"


def _limit_words(value: ValueTrend) -> str:
    """Return when the limit is reached."""
    limit = value.limit
    assert limit is not None
    what = f"limit {limit.limit:.4g} {value.unit}"
    if limit.passed:
        return f"{what}: passed"
    if limit.interval is None:
        return f"{what}: no growth towards it"
    first, last = limit.interval
    until = f"to {last}" if last is not None else "or later, no end in sight"
    at = f"at record {limit.record} " if limit.record is not None else ""
    return f"{what}: expected {at}(90 %: {first} {until})"


def draw_values(found: RigTrend, path: Path) -> None:
    """Plot values with intervals, steps, growth and limits; those that move come first."""
    with drawing():
        import matplotlib as mpl
        from matplotlib.figure import Figure
        from matplotlib.ticker import MaxNLocator

        from ema_cli.views.pictures import save_picture
        from ema_cli.views.record_plots import BLUE, GREY, STYLE, VERMILION, literal

        shown = sorted(found.values, key=lambda v: not v.moves)[:MAX_PANELS]
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(9.0, 1.0 + 1.8 * max(1, len(shown))))
            axes = figure.subplots(max(1, len(shown)), 1, sharex=True, squeeze=False)[:, 0]
            for panel, v in zip(axes, shown):
                panel.errorbar(v.number, v.value, (v.value - v.lower, v.upper - v.value), fmt="o",
                               ms=3.5, lw=0.8, color=BLUE)
                for step in v.steps:
                    panel.axvline(step.record - 0.5, color=GREY, ls="--", lw=0.9)
                if v.growth is not None and v.way:
                    x = v.number[-v.growth.count:]
                    panel.plot(x, v.now + v.way * v.growth.rate * (x - x[-1]), color=BLUE,
                               lw=1.5, alpha=0.5)
                if v.limit is not None:
                    panel.axhline(v.limit.limit, color=VERMILION, ls="-.", lw=0.9)
                panel.set_ylabel(f"{v.name}\n({v.unit})", fontsize=8.0)
            axes[0].set_title(f"Axis {literal(found.axis or 'not known')}: "
                              f"{len(found.sources)} records")
            axes[-1].set_xlabel("record")
            axes[-1].xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
            save_picture(figure, path)
    note(f"plot: {path}")
