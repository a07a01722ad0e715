"""EMPS on its official split: named terms, identified on one file, run free on the other.

A free run has the measured force as its only input and starts at the measured position: at rest,
which gives the published numbers (6.65 and 9.18 mm), and with the measured speed, since both files
begin at 7 mm/s. The error is the root mean square of the position after the first 20 samples.
``pulses_N`` of the second file is no force to be added.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ema_identification.result import Identification
from ema_identification.rig.export import export_model
from ema_identification.rig.fit.model import KnownTerm, RigModel, dump_rig_model
from ema_identification.rig.follow import follow
from ema_identification.rig.workflow import identify_rig
from ema_rig.record import POSITION, RigRecord

SKIPPED, OF_SPEED = 20, 6
"""Samples at the start that do not count; and those whose slope is the speed at the start."""
PUBLISHED = """rig: emps
terms:
- effect: inertia
  parameters: {value: 95.1089}
- effect: viscous_friction
  parameters: {value: 203.5034}
- effect: coulomb_friction
  parameters: {level: 20.3935}
- effect: offset
  parameters: {value: -3.1648}
axis: {motion: linear, input: force, travel: [-1.0, 1.0]}
"""
"""A. Janot, M. Gautier, M. Brunot, 2019."""
Step = Callable[[float, float, float, float], tuple[float, float]]


def free_run(
    model_text: str, record: RigRecord, *, moving: bool = False
) -> tuple[float, tuple[str, ...]]:
    """Return the error of the position (m, rms), and the laws that the run does not have.

    It starts at rest, or with the measured speed if `moving`.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.yaml"
        path.write_text(model_text, encoding="utf-8")
        exported = export_model(path, "python")
    names: dict[str, Any] = {}
    exec(compile(exported.text, "model", "exec"), names)
    step: Step = names["step"]
    dt = 1.0 / record.rate
    measured = record.channel(POSITION)
    x, v = float(measured[0]), 0.0
    if moving:
        v = float(np.polyfit(dt * np.arange(OF_SPEED), measured[:OF_SPEED], 1)[0])
    found = np.empty(len(record))
    for k, u in enumerate(record.input.tolist()):
        found[k] = x
        x, v = step(x, v, u, dt)
    error = (found - measured)[SKIPPED:]
    return float(np.sqrt(np.mean(error**2))), exported.left_out


def refitted(record: RigRecord) -> str:
    """Return the model of the published terms, fitted to a record by our regression."""
    found = {p.name: p.value for p in follow([record], load_published())[0].parameters}
    terms = tuple(KnownTerm(effect=term.effect, parameters={
        name: found[f"{term.effect}.{name}"] for name in term.parameters})
        for term in load_published().terms)
    return dump_rig_model(load_published().model_copy(update={"terms": terms}))


def load_published() -> RigModel:
    """Return the published model."""
    return RigModel.model_validate(yaml.safe_load(PUBLISHED))


def both_ways(train: RigRecord, test: RigRecord) -> list[tuple[str, ...]]:
    """Print and return the table: model, fitted on, error on either file in mm."""
    rows: list[tuple[str, ...]] = [
        ("model", "fitted on", "DATA_EMPS", "DATA_EMPS_PULSES", "the same, moving", "")]
    rows.append(("published physics", "DATA_EMPS", *_errors(PUBLISHED, train, test)))
    for name, record in (("DATA_EMPS", train), ("DATA_EMPS_PULSES", test)):
        rows.append(("its terms, fitted here", name, *_errors(refitted(record), train, test)))
        found = identify_rig([record])
        rows.append((_names(found), name, *_errors(found.model_text, train, test)))
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)
    return rows


def _errors(model_text: str, *records: RigRecord) -> list[str]:
    return [f"{1e3 * free_run(model_text, record, moving=moving)[0]:.2f}"
            for moving in (False, True) for record in records]


def _names(found: Identification) -> str:
    return ", ".join(["inertia, viscous friction", *(f.effect for f in found.findings)])
