"""Problems of records to pysindy and back, and the calibration of its thresholds."""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind_panel.peer.ports import ports_of, problem
from ema_record.files import new_file
from ema_record.record import Record

NULL_UNITS = 30
ALLOWED = 0.01
"""Share of effect-free units on which a port may name something."""
GRID = np.geomspace(0.02, 2.0, 12)
"""Thresholds that are tried, in median rms of the response of effect-free units."""


def call(
    record: Record, python: str, task: dict[str, Any], without: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Return what `stlsq.py` answers for a record."""
    arrays: dict[str, Any] = {}
    ports = ports_of(record)
    for port in ports:
        port.laws = [law for law in port.laws if law[0].partition(".")[0] not in without]
    ports = [port for port in ports if port.laws]
    for port in ports:
        x, y, names = problem(port)
        arrays |= {f"{port.name}:x": x, f"{port.name}:y": y,
                   f"{port.name}:names": json.dumps(names)}
    arrays["ports"] = json.dumps([port.name for port in ports])
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        np.savez(folder / "problems.npz", **arrays)
        (folder / "task.json").write_text(json.dumps(task), encoding="utf-8")
        subprocess.run(
            [python, str(Path(__file__).with_name("stlsq.py")), str(folder / "problems.npz"),
             str(folder / "task.json"), str(folder / "answer.json")], check=True)
        answer: dict[str, Any] = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
    return answer


def calibrated_thresholds(path: Path, records: list[Record], python: str) -> dict[str, float]:
    """Return a threshold a port: the lowest that names next to nothing on effect-free units.

    Parameters
    ----------
    path : of the result; read if it is there.
    records : of effect-free units.
    python : interpreter with pysindy.
    """
    if path.exists():
        kept: dict[str, float] = json.loads(path.read_text(encoding="utf-8"))
        return kept
    sizes: dict[str, list[float]] = {}
    for record in records:
        for port in ports_of(record):
            sizes.setdefault(port.name, []).append(
                float(np.sqrt(np.mean(problem(port)[1] ** 2))))
    grid = {name: (GRID * np.median(rms)).tolist() for name, rms in sizes.items()}
    counts: dict[str, list[list[int]]] = {name: [] for name in grid}
    for record in records:
        for name, found in call(record, python, {"grid": grid})["counts"].items():
            counts[name].append(found)
    thresholds = {}
    for name, values in grid.items():
        naming = np.mean(np.array(counts[name]) > 0, axis=0)
        allowed = np.flatnonzero(naming <= ALLOWED)
        thresholds[name] = values[allowed[0]] if len(allowed) else 10.0 * values[-1]
    with new_file(path) as temporary:
        temporary.write_text(json.dumps(thresholds), encoding="utf-8")
    return thresholds
