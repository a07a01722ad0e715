"""The paper's tables, ours beside the printed numbers; accuracies against the targets."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from ema_prognostics.paper.cascade import ANN_B_INPUTS, FAULTS, FaultName, level_target
from ema_prognostics.paper.experiment import (
    NOISE_LEVELS,
    REFERENCE_RATE,
    FeatureSet,
    PaperExperiment,
    draw,
    paper_window_of,
)
from ema_prognostics.paper.features import ANN_A_INPUTS
from ema_prognostics.paper.statements import check_statements
from ema_record.kit import share_path
from ema_record.yaml_file import load_yaml

TABLES: dict[str, tuple[FaultName, int]] = {
    "table_2": ("turn_short", 0), "table_3": ("rotor_eccentricity", 0),
    "figure_13": ("turn_short", 2), "figure_14": ("turn_short", 3),
    "figure_15": ("rotor_eccentricity", 2), "figure_16": ("rotor_eccentricity", 3),
}
"""Fault of each table, and the columns of its ANN_B (0: ANN_A)."""
TARGETS = {
    ("ann_a", 0): 0.995, ("turn_short", 2): 0.98, ("turn_short", 3): 0.97,
    ("rotor_eccentricity", 2): 0.93, ("rotor_eccentricity", 3): 0.78,
}


def paper_report(experiment: PaperExperiment) -> dict[str, Any]:
    """Return everything that ``ema paper`` prints, as plain values for JSON."""
    settings = experiment.settings
    accuracies = _accuracies(experiment)
    return {
        "settings": {
            **asdict(settings), "noise_levels": list(NOISE_LEVELS),
            "noise_reference_rate": REFERENCE_RATE,
            "start_angles": [round(a, 6) for a in experiment.angles],
            "unseen_start_angles": [round(a, 6) for a in experiment.unseen],
        },
        "accuracies": accuracies,
        "tables": _tables(experiment),
        "statements": [s._asdict() for s in check_statements(experiment)],
        "met": all(a["met"] for a in accuracies if a["start_angles"] == "same"),
    }


def _share(right: np.ndarray) -> dict[str, Any]:
    return {"accuracy": round(float(right.mean()), 6), "right": int(right.sum()),
            "draws": len(right)}


def _entry(
    network: str, columns: int, angles: str, levels: np.ndarray, right: np.ndarray
) -> dict[str, Any]:
    by_level = {f"{level:g}": _share(right[levels == level]) for level in NOISE_LEVELS}
    target = TARGETS["ann_a" if network.startswith("ann_a") else network, columns]
    worst = min(v["accuracy"] for v in by_level.values())
    value = worst if network.startswith("ann_a") else float(right.mean())
    return {
        "network": network, "columns": columns, "start_angles": angles, **_share(right),
        "by_noise_level": by_level, "target": target, "met": bool(value >= target),
    }


def _accuracies(experiment: PaperExperiment) -> list[dict[str, Any]]:
    found = []
    for angles, sets in (("same", experiment.test), ("unseen", experiment.test_unseen)):
        for index, fault in enumerate(FAULTS):
            y = experiment.ann_a(sets[fault].matrix(ANN_A_INPUTS))
            found.append(_entry(f"ann_a {fault}", 0, angles, sets[fault].levels,
                                y.argmax(axis=1) == index))
        for fault in FAULTS:
            for columns in experiment.settings.columns:
                right = right_level(experiment, fault, columns, sets[fault])
                found.append(_entry(fault, columns, angles, sets[fault].levels, right))
    return found


def right_level(
    experiment: PaperExperiment, fault: FaultName, columns: int, data: FeatureSet
) -> np.ndarray:
    """Return whether ANN_B's largest output is a level of the row, shape (n,), bool.

    The row at a cut belongs to both of its levels, as in the paper's target.
    """
    y = experiment.ann_b[fault, columns](data.matrix(ANN_B_INPUTS[fault]))
    target = level_target(data.rows, columns)
    return target[np.arange(len(y)), y.argmax(axis=1)] == 1


def _tables(experiment: PaperExperiment) -> dict[str, Any]:
    printed = load_yaml(share_path("config/paper.yaml"))
    assert isinstance(printed, dict)
    rng = np.random.default_rng([experiment.settings.seed, 2])
    cache: dict[tuple[FaultName, float], FeatureSet] = {}
    tables = {}
    for name, (fault, columns) in TABLES.items():
        rows = []
        for percent, *theirs in printed[name]["rows"]:
            extent = round(0.01 * percent, 6)
            if printed[name]["extent"] == "active turns":
                extent = round(1.0 - extent, 6)
            if (fault, extent) not in cache:
                windows = [[paper_window_of(fault, extent, a)] for a in experiment.angles]
                cache[fault, extent] = draw(windows, np.array([0]), 4, rng)
            data = cache[fault, extent]
            if columns:
                y = experiment.ann_b[fault, columns](data.matrix(ANN_B_INPUTS[fault]))
            else:
                y = experiment.ann_a(data.matrix(ANN_A_INPUTS))
            rows.append({
                "extent_percent": percent, "paper": theirs,
                "ours": [round(float(v), 4) for v in y.mean(axis=0)],
                "spread": [round(float(v), 4) for v in y.std(axis=0)],
            })
        tables[name] = {"title": printed[name]["title"], "extent": printed[name]["extent"],
                        "draws": 9 * len(experiment.angles), "rows": rows}
    return tables
