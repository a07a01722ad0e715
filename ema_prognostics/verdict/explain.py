"""The reasons of a verdict in words that a technician understands."""

from __future__ import annotations

import numpy as np

from ema_prognostics.cascade.classes import CLASS_OF
from ema_prognostics.cascade.find import Cascade, Finding
from ema_prognostics.cascade.guard_groups import GROUPS
from ema_prognostics.words import feature_words

RELEVANT = {
    "turn_short": ("_even_m2", "_even_m4", "resistance_spread", "inductance_spread"),
    "rotor_eccentricity": ("_even_m1", "_even_m3"),
    "friction": ("torque_", "gap_torque", "surface_torque"),
    "backlash": ("gap_width", "lag_", "start_stiffness"),
}
"""Features that speak for each class."""
MOST = 3


def reasons_of_fault(cascade: Cascade, x: np.ndarray, output: str) -> list[str]:
    """Return what moved, largest first, for an announced output; `x` has shape (d,)."""
    keys = RELEVANT[CLASS_OF[output]]
    names = cascade.inputs.input_names
    z = cascade.inputs.deviations(x[None])[0]
    chosen = [k for k, n in enumerate(names)
              if any(key in n for key in keys) and not n.startswith("absolute_")]
    chosen.sort(key=lambda k: -abs(z[k]))
    found: list[str] = []
    for k in chosen:
        text = feature_words(names[k])
        if abs(z[k]) >= 2.0 and not any(f.startswith(text) for f in found):
            found.append(f"{text}: {z[k]:+.1f} healthy deviations")
        if len(found) == MOST:
            break
    return found


def reasons_of_guard(cascade: Cascade, finding: Finding, bound: float = 1.0) -> list[str]:
    """Return what is unlike anything trained on, worst first; empty where nothing is.

    Parameters
    ----------
    cascade : that found it.
    finding : what it found.
    bound : of the guard's scores, above 1 where another guard judges too.
    """
    guard = cascade.guard
    if guard is None or finding.guard.max() <= bound:
        return []
    names = cascade.inputs.input_names
    m = len(guard.checked)
    each, groups, together = finding.guard[:m], finding.guard[m:-1], float(finding.guard[-1])
    found = [
        f"{feature_words(names[guard.checked[k]])}: {each[k]:.1f} times the usual bound"
        for k in np.argsort(-each)[:MOST] if each[k] > 1.0
    ]
    found += [
        f"{GROUPS[guard.groups[k]].words}, together: {groups[k]:.1f} times the usual distance"
        for k in np.argsort(-groups)[:MOST - len(found)] if groups[k] > 1.0
    ]
    if not found:
        worst = feature_words(names[guard.checked[int(np.argmax(each))]])
        found.append(f"all features together: {together:.1f} times the usual distance, most of "
                     f"all the {worst}")
    return found
