"""What the cascade makes of a held-out fleet: confusion with counts, errors, coverage."""

from __future__ import annotations

from typing import Any

import numpy as np

from ema_prognostics.cascade import Assessment, Cascade
from ema_prognostics.cascade_features import CascadeFeatures
from ema_prognostics.diagnosis import verdict_of_assessment
from ema_prognostics.training import Fleet


def evaluate(cascade: Cascade, fleet: Fleet) -> dict[str, Any]:
    """Return the confusion of a fleet that nothing was fitted to, as plain values.

    ``confusion[injected][verdict]`` counts runs; ``severity[fault]`` has the median relative
    error, the part of the 95 % intervals that cover the truth, the part of phases named right
    and the largest severity that was called healthy.
    """
    found = [
        cascade.assess(CascadeFeatures(lines=lines, mechanics=mechanics))
        for lines, mechanics in zip(fleet.lines, fleet.mechanics)
    ]
    verdicts = [verdict_of_assessment(cascade, assessment) for assessment in found]
    names = np.array([
        v.faults[0].fault_class if v.faults else v.outcome for v in verdicts
    ])
    confusion: dict[str, dict[str, int]] = {}
    for label in dict.fromkeys(fleet.labels.tolist()):
        values, counts = np.unique(names[fleet.of(label)], return_counts=True)
        confusion[label] = {str(v): int(c) for v, c in zip(values, counts)}
    severity = {
        name: _severity(name, fleet, found, names) for name in cascade.ann_b
    }
    return {"confusion": confusion, "severity": severity}


def _severity(
    name: str, fleet: Fleet, found: list[Assessment], names: np.ndarray
) -> dict[str, Any]:
    mine = np.flatnonzero(fleet.of(name))
    hit = [i for i in mine if names[i] == name]
    truth = fleet.severity
    errors = [abs((found[i].severity or 0.0) / truth[i] - 1.0) for i in hit]
    covered = [
        interval[0] <= truth[i] <= interval[1]
        for i in hit if (interval := found[i].interval) is not None
    ]
    out: dict[str, Any] = {
        "runs": len(mine), "named": len(hit),
        "median_relative_error": float(np.median(errors)) if errors else None,
        "interval_coverage": float(np.mean(covered)) if covered else None,
        "largest_called_healthy": float(
            max((truth[i] for i in mine if names[i] == "healthy"), default=0.0)
        ),
    }
    if name == "turn_short":
        out["phase_right"] = float(np.mean([
            f"turn_short.phase={found[i].phase}" in fleet.runs[i].effects for i in hit
        ])) if hit else None
    return out
