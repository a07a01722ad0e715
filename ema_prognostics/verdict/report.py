"""From what the cascade found to a `Verdict` with reasons that a technician understands."""

from __future__ import annotations

import numpy as np

from ema_prognostics.cascade.classes import CLASS_OF, FAULTS, SHORTS, UNITS, level_of, levels_of
from ema_prognostics.cascade.find import Cascade, Detection
from ema_prognostics.cascade.guard_groups import GROUPS
from ema_prognostics.features.profile_kind import ProfileKind
from ema_prognostics.verdict.verdict import Fault, Verdict
from ema_prognostics.words import REPEAT, feature_words, next_step
from ema_record.errors import EmaError, IncompleteRecordError

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


def reasons_of_guard(cascade: Cascade, detection: Detection, bound: float = 1.0) -> list[str]:
    """Return what is unlike anything trained on, worst first, and what to do; empty: nothing is.

    Parameters
    ----------
    cascade : that found it.
    detection : what it found.
    bound : of the guard's scores, above 1 where another guard judges too.
    """
    guard = cascade.guard
    if guard is None or detection.guard.max() <= bound:
        return []
    names = cascade.inputs.input_names
    m = len(guard.checked)
    each, groups, together = detection.guard[:m], detection.guard[m:-1], float(detection.guard[-1])
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
    odd = np.argmax(each) if each.size and each.max() > 1.0 else None
    step = REPEAT if odd is None else next_step(names[guard.checked[odd]])
    return [*found, f"next: {step}"]


GAP_CAVEAT = (
    "one step in one direction shows lost motion only where the motor crosses it at the start; if "
    "the last motion left the shaft wound that way, only the extended profile rules backlash out"
)
GREASE_CAVEAT = (
    "one speed does not tell dry friction from grease that is twice as stiff: only the extended "
    "profile rules a growth of the friction out"
)
SAME_LINES = {
    "rotor_eccentricity": (
        "a rotor off centre in a fixed direction (static eccentricity), along the axis of that "
        "phase, gives nearly the same torque lines: the probability of turn short is that of "
        "either"
    ),
    "turn_short": (
        "shorts of two phases give nearly the same torque lines as a rotor off centre in a fixed "
        "direction (static eccentricity): the probability of rotor eccentricity is that of either"
    ),
}
"""Why a class is an alternative to the fault that is named."""


def verdict_of_error(error: EmaError, bag: str = "") -> Verdict:
    """Return the verdict on a record that cannot be read or used: incomplete or invalid."""
    incomplete = isinstance(error, IncompleteRecordError)
    return Verdict(
        outcome="incomplete" if incomplete else "invalid", reasons=(str(error),), bag=bag
    )


def unknown_verdict(*reasons: str) -> Verdict:
    """Return the verdict on a record that cannot be judged."""
    return Verdict(outcome="unknown", probabilities={"unknown": 1.0}, reasons=reasons)


def _doubt(probabilities: dict[str, float], *, small: bool) -> Verdict:
    """Return the verdict where no fault is certain enough, nor that there is none.

    Parameters
    ----------
    probabilities : of the classes.
    small : whether a fault is certain, but too small to be told from a side of something else.
    """
    classes = sorted(FAULTS, key=lambda name: -probabilities[name])
    likely = [n for n in classes if probabilities[n] >= 0.5 * probabilities[classes[0]]]
    healthy = f"{100 * probabilities['healthy']:.0f} %"
    reason = (
        f"signs of {likely[0].replace('_', ' ')}, too small to be told from something else: "
        "look again after some flights" if small else
        f"no fault is certain, and healthy is too improbable to be said ({healthy}): repeat the "
        "test, or give a baseline")
    return Verdict(
        outcome="unknown", probabilities=probabilities, alternatives=tuple(likely),
        reasons=(reason,),
    )


def verdict_of_detection(
    cascade: Cascade, x: np.ndarray, detection: Detection, kind: ProfileKind
) -> Verdict:
    """Return the verdict.

    Parameters
    ----------
    cascade : that found it.
    x : ndarray, shape (d,). Its inputs.
    detection : what it found.
    kind : of the test.
    """
    probabilities = detection.class_probability
    if detection.doubtful:
        return _doubt(probabilities, small=bool((detection.margin > 0.0).any()))
    if not detection.outputs:
        reasons = ["no feature lies outside what the healthy fleet shows"]
        if kind == "step":
            reasons += [GAP_CAVEAT, GREASE_CAVEAT]
        return Verdict(
            outcome="healthy", probabilities=probabilities, reasons=tuple(reasons),
            alternatives=("backlash", "friction") if kind == "step" else (),
        )
    faults, reasons = [], []
    for output, severity in zip(detection.outputs, detection.severity):
        name = CLASS_OF[output]
        faults.append(Fault(
            fault_class=name, phase=output[-1] if output in SHORTS else None,
            severity=severity.value, severity_unit=UNITS[name],
            severity_interval=(severity.lower, severity.upper),
            level=level_of(name, severity.value),
        ))
        if name == "friction":
            side = "motor" if output == "motor_friction" else "surface"
            reasons.append(f"the friction is most likely that of the {side}")
        reasons += reasons_of_fault(cascade, x, output)
    faults.sort(key=lambda f: -(f.severity or 0.0) / levels_of(f.fault_class)[1])
    named = {f.fault_class for f in faults}
    alternatives: tuple[str, ...] = ()
    static = "static_eccentricity" in detection.outputs
    if "turn_short" in named and "rotor_eccentricity" not in named:
        alternatives = ("rotor_eccentricity",)
    elif static and "turn_short" not in named:
        alternatives = ("turn_short",)
    reasons += [SAME_LINES[name] for name in alternatives]
    return Verdict(
        outcome="fault", faults=tuple(faults), reasons=tuple(reasons),
        probabilities=probabilities, alternatives=alternatives,
    )
