"""The peer: scikit-learn's perceptron with its defaults on the same features.

Eight records of healthy units hold no fault to learn from, so it gets what the kit's cascade
gets: features of the fleet that is simulated around the kit's corrected model, and the
acceptance records' discrepancy not at all. It says no "unknown", phase or interval of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.any_actuator.machines import TEST_NAME
from benchmarks.detection.peers import UNNAMED, Perceptron
from ema_prognostics.training.fleet import simulate_fleets
from ema_record.kit import using_kit

SEED = 991


def perceptron_rows(kit: Path, rows: Sequence[dict[str, Any]], *, units: int, jobs: int,
                    folder: Path) -> list[dict[str, Any]]:
    """Return what perceptrons trained around `kit` say of records, as rows of `judging`.

    Parameters
    ----------
    kit : of the machine.
    rows : with features; one without is called invalid.
    units : of the simulated fleet that it learns from.
    jobs : processes.
    folder : keeps the fleet.
    """
    with using_kit(kit):
        fleet = simulate_fleets((TEST_NAME,), units, SEED, jobs=jobs, folder=folder)[TEST_NAME]
    perceptron = Perceptron(fleet)
    found = [{**row, "outcome": "invalid", "named": [], "alternatives": [], "interval": None,
              "named_phase": None} for row in rows]
    known = [k for k, row in enumerate(rows)
             if row.get("features") and set(row["features"]) >= set(perceptron.names)]
    if not known:
        return found
    x = np.array([[rows[k]["features"][n] for n in perceptron.names] for k in known])
    for k, called in zip(known, perceptron.call(x, x)):
        fault = called.outcome not in UNNAMED
        found[k] |= {"outcome": "fault" if fault else called.outcome,
                     "named": called.outcome.split("+") if fault else [],
                     "named_phase": called.phase}
    return found
