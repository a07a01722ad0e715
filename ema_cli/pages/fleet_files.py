"""The files of `ema fleet`: page, Parquet, metrics; each replaced as a whole, if it is ours."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import partial
from importlib.resources import files
from math import isfinite
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ema_cli.console import check_new_file
from ema_cli.views.fleet_table import summary
from ema_prognostics.fleet.fleet import STATES, Fleet, FleetUnit, share_of_large
from ema_prognostics.fleet.tables import OURS, is_own_parquet, write_parquet
from ema_prognostics.trend.unit_trend import UnitTrend
from ema_record.errors import library
from ema_record.files import check_apart, new_file
from ema_record.record import iso_time
from ema_record.version import VERSION

PAGE = f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n\
<meta name="generator" content="{OURS} '
METRICS = f"""# TYPE ema_unit_state gauge
# HELP ema_unit_state What the unit needs, written by {OURS}."""
"""How files of this command begin, which may be replaced."""
LINE = (200.0, 28.0)
"""Width and height of a sparkline (px)."""
STRIP = 8.0
"""Height of the verdicts below it (px)."""
MOST_POINTS = 40
"""Flights in a sparkline, the last ones."""


def check_files(html: Path | None, parquet: Path | None, metrics: Path | None) -> None:
    """Raise OutputError unless these files can be made or are ours; before the work begins."""
    if parquet is not None:
        library("pyarrow", "--parquet", "use --format csv")
    for path, own in ((html, _is_own_page), (parquet, is_own_parquet), (metrics, _is_own_metrics)):
        if path is not None and not own(path):
            check_new_file(path)
    check_apart(html, parquet, metrics)


def write_files(
    fleet: Fleet, *, html: Path | None, parquet: Path | None, metrics: Path | None
) -> None:
    """Write what is asked for."""
    if html is not None:
        text = page(fleet, html)
        with new_file(html, _is_own_page) as temporary:
            temporary.write_text(text, encoding="utf-8", errors="backslashreplace")
    if parquet is not None:
        with new_file(parquet, is_own_parquet) as temporary:
            write_parquet(fleet.objects, temporary)
    if metrics is not None:
        with new_file(metrics, _is_own_metrics) as temporary:
            temporary.write_text(open_metrics(fleet), encoding="utf-8", errors="backslashreplace")


def _begins(path: Path, begin: str) -> bool:
    try:
        if not path.is_file():  # a pipe would be waited for
            return False
        with path.open("rb") as file:
            return file.read(len(begin)) == begin.encode()
    except OSError:
        return False


_is_own_page, _is_own_metrics = partial(_begins, begin=PAGE), partial(_begins, begin=METRICS)


def page(fleet: Fleet, place: Path) -> str:
    """Return the page, which needs no other file; links are relative to `place`."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True,
                              lstrip_blocks=True)
    template = files("ema_cli.pages").joinpath("templates/fleet.html").read_text(encoding="utf-8")
    return environment.from_string(template).render(
        generator=f"{OURS} {VERSION}", summary=summary(fleet),
        units=[_tile(unit, place) for unit in fleet.units],
        trace=fleet.objects[0], most=MOST_POINTS)


def _tile(unit: FleetUnit, place: Path) -> dict[str, Any]:
    last = unit.last
    bag = Path(last.verdict.bag)
    report = bag.with_name(f"{bag.name}.html")
    link = None
    if report.is_file():  # a path, whatever it is called
        link = quote(os.fsencode(f"./{os.path.relpath(report, place.parent)}"))
    return {
        "name": unit.serial_number or "unit not known", "state": unit.state,
        "css": unit.state.replace(" ", "-"), "finding": unit.finding(), "ahead": unit.ahead(),
        "tests": len(unit.objects), "time": (iso_time(last.start_time) or "")[:16],
        "profile": last.profile, "line": sparkline(unit.trend), "report": link, "bag": str(bag),
    }


def sparkline(trend: UnitTrend) -> dict[str, Any]:
    """Return what a tile draws (px): severity of the last fault, verdict of each flight."""
    width, height = LINE
    flights = trend.flights[-MOST_POINTS:]
    step = width / max(len(flights), 10)
    cells = [{"x": round(step * k, 1), "outcome": f.verdict.outcome,
              "text": f"flight {f.number}: {f.verdict.outcome}"} for k, f in enumerate(flights)]
    points: list[tuple[float, float]] = []
    if trend.faults:
        severity = max(trend.faults, key=lambda f: f.episodes[-1].last).history.severity
        values = [float(v) for v in severity[-MOST_POINTS:]]
        top = max((v for v in values if isfinite(v)), default=0.0) or 1.0
        points = [(round(step * (k + 0.45), 1), round(height - 4.0 - (height - 8.0) * v / top, 1))
                  for k, v in enumerate(values) if isfinite(v)]
    return {"points": " ".join(f"{x},{y}" for x, y in points), "last": points[-1:],
            "width": width, "height": height if points else 0.0, "strip": STRIP,
            "cell": round(0.9 * step, 1), "cells": cells}


def open_metrics(fleet: Fleet) -> str:
    """Return the state of the units as OpenMetrics 1.0 text, for a textfile collector.

    It holds gauges alone, so that readers of the older text format of Prometheus take it too.
    """
    units = [({"serial_number": u.serial_number or "unknown"}, u) for u in fleet.units]
    lines = [
        METRICS,
        *(_sample("ema_unit_state", labels | {"ema_unit_state": state}, int(u.state == state))
          for labels, u in units for state in STATES),
        "# TYPE ema_unit_tests gauge", "# HELP ema_unit_tests Bags of the unit.",
        *(_sample("ema_unit_tests", labels, len(u.objects)) for labels, u in units),
        "# TYPE ema_unit_last_test_timestamp_seconds gauge",
        "# UNIT ema_unit_last_test_timestamp_seconds seconds",
        "# HELP ema_unit_last_test_timestamp_seconds Start of the last test.",
        *(_sample("ema_unit_last_test_timestamp_seconds", labels, u.last.start_time / 1e9)
          for labels, u in units if u.last.start_time),
        "# TYPE ema_fault_severity_ratio gauge", "# UNIT ema_fault_severity_ratio ratio",
        "# HELP ema_fault_severity_ratio Severity now, of that of a large fault.",
        *(_sample("ema_fault_severity_ratio", labels | {
            "fault_class": f.history.fault_class, "phase": f.history.phase or "",
            "confirmed": str(f.present).lower()}, share_of_large(f))
          for labels, u in units for f in u.trend.faults if f.episodes[-1].cleared is None),
    ]
    return "\n".join([*lines, "# EOF"]) + "\n"


def _sample(name: str, labels: Mapping[str, str], value: float) -> str:
    inside = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
    return f"{name}{{{inside}}} {value:.10g}"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
