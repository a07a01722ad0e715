"""`diagnose`: from a record and a model to a verdict. Needs no ROS, no training library."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from ema_prognostics.cascade import CLASSES, Assessment, Cascade, level_of
from ema_prognostics.cascade_features import LAST_TIME, WORDS, cascade_features
from ema_prognostics.model_file import Model, load_model
from ema_prognostics.paper_cascade import FAULTS, LEVELS
from ema_prognostics.paper_features import paper_features, paper_turns
from ema_prognostics.segments import ProfileKind, profile_kind
from ema_prognostics.turns import check_finite
from ema_prognostics.verdict import Fault, Verdict
from ema_record.errors import (
    EmaError,
    IncompleteRecordError,
    InvalidRecordError,
    ModelError,
    UsageError,
)
from ema_record.record import Record

Mode = Literal["robust", "paper"]
MODES: tuple[Mode, ...] = ("robust", "paper")
SEVERITY_UNIT = "1"
"""Shorted part of the turns, and eccentricity by mean air gap: both are ratios."""
LARGEST_GAP = 1.5
"""Longest interval between samples, in sample intervals, before one counts as lost."""
SHARPNESS = 6.0
"""How fast the probability of "unknown" grows with the guard's ratio."""
GAP_CAVEAT = (
    "one step in one direction shows lost motion only where the motor crosses it at the start; if "
    "the last motion left the shaft wound that way, only the extended profile rules backlash out"
)
FEW_DEVIATIONS = 3.0
"""Deviations from which a mechanical feature is named."""


PAPER_CAVEAT = (
    "paper mode: the two networks of the paper, which know no healthy actuator, trained on "
    "phase a and the nominal unit alone"
)


def diagnose(record: Record, model: Model | None = None, *, mode: Mode = "robust") -> Verdict:
    """Say what is wrong with the actuator that `record` comes from.

    Parameters
    ----------
    record : one built-in test.
    model : default the shipped one.
    mode : ``robust``, the cascade with a healthy class and a guard, or ``paper``, the paper's
        two networks literally: it knows no healthy actuator.

    Returns
    -------
    Verdict
        Always, for any record: what cannot be judged is incomplete, invalid or unknown.

    Raises
    ------
    ModelError
        No usable model.
    UsageError
        Unknown mode.
    """
    if mode not in MODES:
        raise UsageError(f"mode {mode!r}: give one of {', '.join(MODES)}")
    model = load_model() if model is None else model
    verdict = _diagnose(record, model, mode)
    return replace(verdict, bag=record.provenance.source)


def _diagnose(record: Record, model: Model, mode: Mode) -> Verdict:
    try:
        check_finite(record)
        kind = profile_kind(record.profile)
        _check_complete(record, kind)
    except InvalidRecordError as error:
        return Verdict(outcome="invalid", reasons=(str(error),))
    except IncompleteRecordError as error:
        return Verdict(outcome="incomplete", reasons=(str(error),))
    if kind is None:
        return _unknown(
            f"the test {record.profile.name!r} is not one that the networks know: run the "
            "profile step or extended, or a step that keeps the actuator slewing for 0.36 s"
        )
    try:
        if mode == "paper":
            return _paper_verdict(record, model)
        cascade = model.cascades.get(kind)
        if cascade is None:
            raise ModelError(f"the model has no cascade for the profile {kind}: train again")
        features = cascade_features(record, kind, model.plant)
    except InvalidRecordError as error:
        return Verdict(outcome="invalid", reasons=(str(error),))
    except IncompleteRecordError as error:
        # The record covers the test, so it is the actuator that did not do it.
        return _unknown(str(error))
    if not (np.isfinite(features.lines).all() and np.isfinite(features.mechanics).all()):
        return _unknown("the features of the record are not finite: a sensor does not answer")
    return verdict_of_assessment(cascade, cascade.assess(features))


def _unknown(reason: str) -> Verdict:
    return Verdict(outcome="unknown", probabilities={"unknown": 1.0}, reasons=(reason,))


def _check_complete(record: Record, kind: ProfileKind | None) -> None:
    """Raise IncompleteRecordError unless the record covers its test without a gap."""
    status = record.provenance.status
    if status != "complete":
        raise IncompleteRecordError(f"the test was {status}: repeat it")
    if len(record) < 2:
        raise IncompleteRecordError(f"{len(record)} samples: repeat the test")
    time = record.time
    end = record.profile.command_time + LAST_TIME[kind] if kind else record.profile.duration
    if time[0] > record.profile.command_time or time[-1] < end - 2.0 / record.rate:
        raise IncompleteRecordError(
            f"the record covers {time[0]:.3f} to {time[-1]:.3f} s, the analysis needs "
            f"{record.profile.command_time:.3f} to {end:.3f} s: repeat the test"
        )
    gaps = np.diff(time) * record.rate
    if gaps.max() > LARGEST_GAP:
        at = int(np.argmax(gaps))
        raise IncompleteRecordError(
            f"{round(float(np.sum(gaps[gaps > LARGEST_GAP] - 1.0)))} samples are missing, the "
            f"longest gap at {time[at]:.4f} s: repeat the test"
        )


def _paper_verdict(record: Record, model: Model) -> Verdict:
    if model.paper is None:
        raise ModelError("the model has no paper cascade: train again with 'ema train'")
    features = paper_features(paper_turns(record))
    outputs = model.paper.classify(features)
    fault = FAULTS[int(np.argmax(outputs))]
    levels = model.paper.level(fault, features)
    return Verdict(
        outcome="fault",
        faults=(Fault(fault_class=fault, level=LEVELS[3][int(np.argmax(levels))]),),
        probabilities=dict(zip(FAULTS, map(float, outputs))),
        reasons=(PAPER_CAVEAT,),
    )


def verdict_of_assessment(cascade: Cascade, found: Assessment) -> Verdict:
    """Return the verdict that the outputs of a cascade amount to."""
    mechanics = max(found.band_ratio, found.wear_ratio)
    healthy = found.named == "healthy"
    # Heavy friction makes odd lines as an eccentricity does; a short's lines it does not make.
    short = found.named == "turn_short"
    ratio = found.line_ratio if short else max(found.line_ratio, mechanics)
    answer = float(found.outputs.max())
    unknown = 1.0 / (1.0 + float(np.exp(np.clip(-SHARPNESS * (ratio - 1.0), -60.0, 60.0))))
    known = (1.0 - unknown) * found.outputs / max(float(found.outputs.sum()), 1e-12)
    probabilities = {**dict(zip(CLASSES, map(float, known))), "unknown": unknown}
    worn = _mechanical_reasons(cascade, found) if mechanics > 1.0 else ()
    if ratio > 1.0 or answer < 0.5:
        return Verdict(
            outcome="unknown", probabilities=probabilities,
            alternatives=_possible(found, mechanics),
            reasons=(*_line_reasons(found, answer), *worn),
        )
    if healthy:
        reason = (
            "lines and mechanics of the record are those of healthy units "
            f"(guard at {ratio:.0%} of its limit)"
        )
        if "lag_at_rest" in cascade.mechanics_guard.names:  # a step alone
            return Verdict(
                outcome="healthy", probabilities=probabilities, alternatives=("backlash",),
                reasons=(reason, GAP_CAVEAT),
            )
        return Verdict(outcome="healthy", probabilities=probabilities, reasons=(reason,))
    assert found.severity is not None
    fault = Fault(
        fault_class=found.named, phase=found.phase, severity=found.severity,
        severity_unit=SEVERITY_UNIT, severity_interval=found.interval,
        level=level_of(found.named, found.severity),
    )
    reasons = [_fault_reason(found), *worn]
    alternatives: tuple[str, ...] = ()
    if found.named == "turn_short":
        alternatives = ("rotor_eccentricity",)
        reasons.append(
            "a static eccentricity in the axis of that phase gives the same torque lines"
        )
    if mechanics > 1.0:
        alternatives += (found.wear,)
    return Verdict(
        outcome="fault", faults=(fault,), alternatives=alternatives,
        probabilities=probabilities, reasons=tuple(reasons),
    )


def _possible(found: Assessment, mechanics: float) -> tuple[str, ...]:
    """Return the classes that an unknown record may be."""
    wear = (found.wear,) if mechanics > 1.0 else ()
    return wear if found.named == "healthy" or found.line_ratio > 1.0 else (*wear, found.named)


def _fault_reason(found: Assessment) -> str:
    if found.named == "turn_short":
        return (
            "torque lines at 2 and 4 f_e in the direction of a short in phase "
            f"{found.phase}, {100 * (found.severity or 0):.2g} % of its turns"
        )
    return (
        "torque lines of a rotor eccentricity (1 and 3 f_e, or 2 and 4 f_e across the axes of "
        f"the phases), {100 * (found.severity or 0):.2g} % of the air gap"
    )


def _line_reasons(found: Assessment, answer: float) -> tuple[str, ...]:
    reasons = []
    if found.line_ratio > 1.0:
        reasons.append(
            f"the torque lines are unlike any record trained on ({found.line_ratio:.2g} times "
            f"the limit; nearest class {found.named})"
        )
    if answer < 0.5:
        reasons.append(f"no class answers: the largest output is {answer:.2f}")
    return tuple(reasons)


def _mechanical_reasons(cascade: Cascade, found: Assessment) -> tuple[str, ...]:
    names = cascade.mechanics_guard.names
    order = np.argsort(-np.abs(found.excess), kind="stable")
    out = [
        f"{WORDS[names[i]]} {found.excess[i]:+.1f} deviations from healthy units"
        for i in order if abs(found.excess[i]) > FEW_DEVIATIONS
    ]
    first = (
        f"mechanics outside the healthy band ({max(found.band_ratio, found.wear_ratio):.2g} "
        f"times the limit), most like {found.wear}"
    )
    return first, *out[:3]


def verdict_of_error(error: EmaError, bag: str) -> Verdict:
    """Return the verdict of a bag that could not be read: incomplete or invalid."""
    incomplete = isinstance(error, IncompleteRecordError)
    return Verdict(
        outcome="incomplete" if incomplete else "invalid", reasons=(str(error),), bag=bag
    )
