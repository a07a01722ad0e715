"""From what the cascade found to a `Verdict` with reasons that a technician understands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_prognostics.cascade.classes import CLASS_OF, FAULTS, SHORTS, UNITS, level_of, levels_of
from ema_prognostics.cascade.find import Cascade, Detection
from ema_prognostics.features.profile_kind import ProfileKind
from ema_prognostics.verdict.evidence import MOST, Measured
from ema_prognostics.verdict.verdict import Fault, Measure, Symptom, Verdict
from ema_prognostics.words import ENGLISH, STRANGER, feature_words, next_step
from ema_record.errors import EmaError, IncompleteRecordError, RigRecordError

GROUP, ALL = "group.", "all"
"""Beginning of the names of groups of features, and the name of all together."""
FOUND: dict[Measure, str] = {
    "healthy": "{:+.1f} healthy deviations", "bound": "{:.1f} times the usual bound"}


def words_of(evidence: Sequence[Symptom]) -> list[str]:
    """Return pieces of evidence as reasons in words."""
    return [f"{feature_words(e.feature, ENGLISH)}: {FOUND[e.measure].format(e.times)}"
            for e in evidence]


def guard_evidence(cascade: Cascade, detection: Detection) -> list[Symptom]:
    """Return what the guard finds unusual: a stranger, features, groups of them, or all."""
    guard = cascade.guard
    like = [Symptom(feature=f"{STRANGER}.{detection.stranger_kind}", measure="bound",
                    times=detection.stranger)] if detection.stranger > 1.0 else []
    if like and not detection.unusual(stranger=False):
        return like
    names = [
        *(cascade.inputs.input_names[k] for k in guard.checked),
        *(f"{GROUP}{name}" for name in guard.groups), ALL,
    ]
    singles = len(guard.checked)
    order = [*np.argsort(-detection.guard[:singles])[:MOST],
             *(singles + np.argsort(-detection.guard[singles:-1]))[:MOST]]
    found = [Symptom(feature=names[k], measure="bound", times=float(detection.guard[k]))
             for k in order if detection.guard[k] > 1.0][:MOST]
    found = found or [Symptom(feature=ALL, measure="bound", times=float(detection.guard[-1]))]
    return [*like, *found][:MOST]


def verdict_of_guard(
    cascade: Cascade, detection: Detection, bound: float = 1.0, *, cause: str = "unlike"
) -> Verdict | None:
    """Return the verdict on a record that is unlike anything trained on, None where it is not.

    Parameters
    ----------
    cascade : that found it.
    detection : what it found.
    bound : of the guard's scores, above 1 where another guard judges too; strangers are then
        its matter.
    cause : ``unlike``, or ``unlike_since_baseline``.
    """
    if not detection.unusual(bound, stranger=bound <= 1.0):
        return None
    found = guard_evidence(cascade, detection)
    first = found[0].feature
    reasons = [UNLIKE[cause], *words_of(found), f"next: {next_step(first)}"]
    return unknown_verdict(*reasons, cause=cause, evidence=found)


UNLIKE = {
    "unlike": "the record is unlike anything the networks were trained on",
    "unlike_since_baseline": "the change since the baseline is unlike anything the networks were "
                             "trained on",
}
GAP_CAVEAT = (
    "one step in one direction shows lost motion only where the motor crosses it at the start; if "
    "the last motion left the shaft wound that way, only the extended profile rules backlash out"
)
GREASE_CAVEAT = (
    "one speed does not tell dry friction from grease that is twice as stiff: only the extended "
    "profile rules a growth of the friction out"
)
SWING_CAVEAT = (
    "a slew swings by itself (the surface sticks and slips): the limit cycle was taken off what "
    "counts of it"
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
        outcome="incomplete" if incomplete else "invalid", reasons=(str(error),), bag=bag,
        cause="rig" if isinstance(error, RigRecordError) else "record",
    )


def unknown_verdict(
    *reasons: str, cause: str = "record", evidence: Sequence[Symptom] = ()
) -> Verdict:
    """Return the verdict on a record that cannot be judged; `cause` as in `Verdict`."""
    return Verdict(outcome="unknown", probabilities={"unknown": 1.0}, reasons=reasons,
                   cause=cause, evidence=tuple(evidence))


def _doubt(measured: Measured, probabilities: dict[str, float], *, small: bool) -> Verdict:
    """Return the verdict where no fault is certain enough, nor that there is none.

    Parameters
    ----------
    measured : the record.
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
        reasons=(reason,), cause="too_small" if small else "doubt",
        evidence=tuple(measured.strongest(likely, 0.0)),
    )


def verdict_of_detection(
    measured: Measured, detection: Detection, kind: ProfileKind
) -> Verdict:
    """Return the verdict.

    Parameters
    ----------
    measured : the record, with the cascade that judged it.
    detection : what it found.
    kind : of the test.
    """
    probabilities = detection.class_probability
    if detection.doubtful:
        return _doubt(measured, probabilities, small=bool((detection.margin > 0.0).any()))
    swing = [SWING_CAVEAT] if measured.swings else []
    if not detection.outputs:
        reasons = ["no fault is probable enough to be named", *swing]
        if kind == "step":
            reasons += [GAP_CAVEAT, GREASE_CAVEAT]
        return Verdict(
            outcome="healthy", probabilities=probabilities, reasons=tuple(reasons),
            alternatives=("backlash", "friction") if kind == "step" else (),
            evidence=tuple(measured.strongest(FAULTS, 0.0)),
        )
    faults, reasons, side = [], [], None
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
        reasons += words_of(measured.strongest([name]))
    faults.sort(key=lambda f: -(f.severity or 0.0) / levels_of(f.fault_class)[1])
    named = {f.fault_class for f in faults}
    alternatives: tuple[str, ...] = ()
    static = "static_eccentricity" in detection.outputs
    if "turn_short" in named and "rotor_eccentricity" not in named:
        alternatives = ("rotor_eccentricity",)
    elif static and "turn_short" not in named:
        alternatives = ("turn_short",)
    reasons += [*(SAME_LINES[name] for name in alternatives), *swing]
    return Verdict(
        outcome="fault", faults=tuple(faults), reasons=tuple(reasons),
        probabilities=probabilities, alternatives=alternatives, side=side,
        evidence=tuple(measured.strongest(f.fault_class for f in faults)),
    )
