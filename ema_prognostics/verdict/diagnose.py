"""`diagnose`: from a record and a model to a verdict. Needs no ROS, no training library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ema_prognostics.cascade.guard import BESIDE_OWN, LEAST_KNOWN
from ema_prognostics.cascade.lines import hidden_lines
from ema_prognostics.cascade.model_body import DiscrepancyPart
from ema_prognostics.cascade.model_file import TrainedModel, load_model
from ema_prognostics.features.extract import extract
from ema_prognostics.features.profile_kind import SAME_POSITION, ProfileKind, profile_kind
from ema_prognostics.features.turns import cut
from ema_prognostics.features.vector import differences, start_allowed
from ema_prognostics.paper.cascade import FAULTS, LEVELS
from ema_prognostics.verdict.evidence import Measured
from ema_prognostics.verdict.report import (
    unknown_verdict,
    verdict_of_detection,
    verdict_of_error,
    verdict_of_guard,
)
from ema_prognostics.verdict.verdict import Fault, Verdict
from ema_record.actuator import Actuator, load_actuator
from ema_record.checks.guard import OUTCOMES, guard_findings, reason_of
from ema_record.errors import (
    IncompleteRecordError,
    InvalidRecordError,
    ModelError,
    RecordError,
    UsageError,
)
from ema_record.profile import load_profile
from ema_record.profiles.plan import test_plan
from ema_record.record import Record

Mode = Literal["robust", "paper"]
MODES: tuple[Mode, ...] = ("robust", "paper")
NEEDED = ("test_not_complete", "gap", "not_finite", "clock_jump")
"""Rules of the guard without which nothing can be computed."""
PAPER_CAVEAT = (
    "paper mode: the two networks of the paper, which know no healthy actuator, trained on "
    "phase a and the nominal unit alone"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Baseline:
    """A healthy record of an actuator that later ones are compared with, its features taken.

    Attributes
    ----------
    record : the record itself.
    kind : of its test.
    features : by name.
    """

    record: Record
    kind: ProfileKind
    features: Mapping[str, float]


def diagnose(
    record: Record, model: TrainedModel | None = None, *, mode: Mode = "robust",
    baseline: Record | Baseline | None = None, checked: bool = False,
) -> Verdict:
    """Say what is wrong with the actuator that `record` comes from.

    Any record has a verdict: what cannot be judged is incomplete, invalid or unknown.

    Parameters
    ----------
    record : one built-in test.
    model : default the shipped one.
    mode : ``robust``, the cascade with a healthy class and a guard, or ``paper``, the paper's
        two networks literally: it knows no healthy actuator.
    baseline : a healthy record of the same actuator and test, from its acceptance; sharpens
        the verdict of mode ``robust``, but of that record itself. For many records take
        `baseline_of` once.
    checked : whether the record checks were asked before, and found nothing.

    Raises
    ------
    ModelError
        No usable model.
    UsageError
        Unknown mode, or a baseline that cannot serve.
    """
    if mode not in MODES:
        raise UsageError(f"mode {mode!r}: give one of {', '.join(MODES)}")
    if baseline is not None and mode == "paper":
        raise UsageError("mode paper takes no baseline: leave it out, or use mode robust")
    model = load_model() if model is None else model
    verdict = _diagnose(record, model, mode, baseline, checked)
    return replace(verdict, bag=record.provenance.source)


def _diagnose(
    record: Record, model: TrainedModel, mode: Mode, baseline: Record | Baseline | None,
    checked: bool,
) -> Verdict:
    actuator = load_actuator()
    try:
        kind = profile_kind(record.profile, actuator)
        _check_usable(record, kind, actuator, NEEDED if not checked else ())
    except (InvalidRecordError, IncompleteRecordError) as error:
        return verdict_of_error(error)
    if kind is None:
        return unknown_verdict(
            f"the test {record.profile.name!r} is not one that the networks know: run the "
            "profile step or extended, or a step that keeps the actuator slewing for 0.36 s",
            cause="unknown_test",
        )
    try:
        if mode == "paper":
            return _paper_verdict(record, model)
        return _robust_verdict(record, kind, model, baseline, actuator)
    except InvalidRecordError as error:
        return verdict_of_error(error)
    except IncompleteRecordError as error:
        # The record covers the test, so it is the actuator that did not do it.
        return unknown_verdict(str(error), cause="not_done")


def _robust_verdict(
    record: Record, kind: ProfileKind, model: TrainedModel, baseline: Record | Baseline | None,
    actuator: Actuator,
) -> Verdict:
    cascade = model.cascade(kind, "fleet")
    if cascade is None:
        known = sorted({name.partition("/")[0] for name in model.cascades})
        return unknown_verdict(
            f"the networks of this kit do not know the test {kind}: run the profile "
            f"{' or '.join(known)}, or commission the kit with records of {kind}",
            cause="unknown_test")
    own = model.cascade(kind, "baseline")
    if baseline is not None and own is None:
        raise UsageError(f"the model has no cascade with a baseline for {kind}: leave it out")
    if isinstance(baseline, Record):
        baseline = baseline_of(baseline, model)
    if baseline is not None and baseline.kind != kind:
        raise UsageError(
            f"the baseline is of the test {baseline.record.profile.name!r}, the record of "
            "another: give a baseline of the same test"
        )
    if baseline is not None and np.array_equal(baseline.record.samples, record.samples):
        baseline = None  # a record that is compared with itself has not changed
    return verdict_of_features(extract(record, kind, actuator), kind, model,
                               None if baseline is None else baseline.features,
                               exact=_is_trained_test(record, kind, actuator))


def _is_trained_test(record: Record, kind: ProfileKind, actuator: Actuator) -> bool:
    """Whether the test is the one trained on, sampled at the rate trained on."""
    given, trained = record.profile.points, load_profile(kind).points
    tolerance = SAME_POSITION * actuator.surface.end_stop
    same = max(abs(given[k][1] - trained[k][1]) for k in (0, -1)) < tolerance
    return same and abs(record.rate / actuator.acquisition.rate - 1.0) < 0.01


def verdict_of_features(
    features: Mapping[str, float], kind: ProfileKind, model: TrainedModel,
    baseline: Mapping[str, float] | None = None, *, exact: bool = True,
) -> Verdict:
    """Return the verdict that the features of a record amount to.

    Parameters
    ----------
    features : of the record, as `features.extract.extract` gives them.
    kind : of the test; the model must have a cascade for it.
    model : of the cascade.
    baseline : features of the actuator's own healthy record.
    exact : whether the test is exactly the one trained on, see `Cascade.find`.
    """
    cascade, own = model.cascades[f"{kind}/fleet"], model.cascade(kind, "baseline")
    names = cascade.view.names
    if set(features) != set(names):
        return unknown_verdict("the record does not hold every feature: record every channel of "
                               "the kit, from the acceptance of the command, the inverter off",
                               cause="missing_feature")
    left = model.body.discrepancy.get(kind)
    x = corrected_row(features, names, left)
    detection = cascade.find(x, exact=exact)[0]
    with_own = baseline is not None and own is not None
    unusual = verdict_of_guard(cascade, detection, BESIDE_OWN if with_own else 1.0)
    if unusual is not None:
        return unusual
    if baseline is None or own is None:
        measured = Measured(cascade.inputs, x[0], cascade.inputs)
        return verdict_of_detection(measured, detection, kind)
    x = differences(x, corrected_row(baseline, names, left))
    alone, detection = detection, own.find(x, exact=exact)[0]
    detection = replace(
        detection, known=min(max(alone.known, LEAST_KNOWN), detection.known))
    unusual = verdict_of_guard(own, detection, cause="unlike_since_baseline")
    if unusual is not None:
        return unusual
    return verdict_of_detection(Measured(own.inputs, x[0], cascade.inputs), detection, kind)


def corrected_row(
    features: Mapping[str, float], names: Sequence[str], left: DiscrepancyPart | None
) -> np.ndarray:
    """Return features as the networks take them, less the discrepancy `left`, shape (1, d)."""
    off = {} if left is None else dict(zip(left.names, left.mean))
    row = np.array([[features[n] for n in names]])
    mean = np.array([off.get(n, 0.0) for n in names])
    return start_allowed(row - np.where(hidden_lines(names, row), 0.0, mean), names)


def baseline_of(record: Record, model: TrainedModel) -> Baseline:
    """Return `record` as a baseline; UsageError if it cannot serve."""
    actuator = load_actuator()
    try:
        kind = profile_kind(record.profile, actuator)
        if kind is None:
            raise UsageError(f"the baseline is of the test {record.profile.name!r}, which the "
                             "networks do not know: give one of the profile step or extended")
        _check_usable(record, kind, actuator)
        features = extract(record, kind, actuator)
    except RecordError as error:
        raise UsageError(f"the baseline cannot serve: {error}") from None
    cascade = model.cascade(kind, "fleet")
    if cascade is not None and set(features) != set(cascade.view.names):
        raise UsageError("the baseline cannot serve: its interval with the inverter off is "
                         "missing")
    return Baseline(record=record, kind=kind, features=features)


def _check_usable(
    record: Record, kind: ProfileKind | None, actuator: Actuator, rules: Sequence[str] = NEEDED
) -> None:
    """Raise InvalidRecordError, IncompleteRecordError where the guard's rules forbid it."""
    findings = guard_findings(record, actuator, rules) if rules else ()
    for finding in findings:
        if OUTCOMES[finding.rule] == "invalid":
            raise InvalidRecordError(reason_of(finding))
    if findings:
        raise IncompleteRecordError(reason_of(findings[0]))
    end = (record.profile.command_time + test_plan(record.profile, actuator).last_time
           if kind else record.profile.duration)
    cut(record, (record.profile.command_time, end))


def _paper_verdict(record: Record, model: TrainedModel) -> Verdict:
    if model.paper is None:
        raise ModelError("the model has no paper cascade: train again with 'ema train'")
    from ema_prognostics.paper.features import paper_features, paper_turns

    features = paper_features(paper_turns(record))
    outputs = model.paper.classify(features)
    fault = FAULTS[int(np.argmax(outputs))]
    levels = model.paper.level(fault, features)
    return Verdict(
        outcome="fault",
        faults=(Fault(fault_class=fault, level=LEVELS[int(np.argmax(levels))]),),
        probabilities=dict(zip(FAULTS, map(float, outputs))),
        reasons=(PAPER_CAVEAT,),
    )
