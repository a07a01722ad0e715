"""`Judge`: from a bag or a record to its verdict, whatever state it is in.

What judges is the present kit's: its networks, its actuator, its tests. A record is read, checked
by the rules of `ema_record.checks`, and then diagnosed, if asked beside the actuator's own healthy
record. What the checks find makes the verdict incomplete, invalid or unknown, with the findings
as its reasons; the actuator is then not judged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from threadpoolctl import ThreadpoolController

from ema_prognostics.cascade.find import Cascade
from ema_prognostics.cascade.kept_model import kept_model
from ema_prognostics.features.profile_kind import ProfileKind
from ema_prognostics.verdict.diagnose import Baseline, Mode, baseline_of, diagnose
from ema_prognostics.verdict.report import verdict_of_error
from ema_prognostics.verdict.verdict import Judged, Verdict
from ema_record.bag.read import read_bag
from ema_record.checks.facts import Finding
from ema_record.checks.guard import guard_findings, outcome_of, reason_of
from ema_record.errors import RecordError, UsageError
from ema_record.kit import is_default_kit, kit_name
from ema_record.profile import load_profile
from ema_record.record import Record

MOST_REASONS = 5
"""Findings of the record checks that are told."""


class Judge:
    """Model, baseline and commanded test, loaded once; answers for any bag.

    Parameters
    ----------
    model : model file, default the kit's.
    baseline : bag of a healthy test of the same actuator.
    profile : the test that was commanded (name or YAML file), in place of the bags' own.
    mode : of the diagnosis.

    Raises
    ------
    UsageError, ModelError, RecordError
        The profile, the model or the baseline cannot serve.
    """

    def __init__(
        self, model: str | Path | None = None, baseline: str | Path | Record | None = None, *,
        profile: str | None = None, mode: Mode = "robust",
    ) -> None:
        if mode == "paper" and not is_default_kit():
            raise UsageError(f"mode paper is of the default actuator alone: leave {kit_name()} "
                             "out, or use mode robust")
        self._profile = None if profile is None else load_profile(profile)
        self._model = kept_model(model)
        self._mode = mode
        # The matrices of a record are small: threads would cost ten times the work.
        self._libraries = ThreadpoolController()
        self._own = None if baseline is None else self._load_baseline(baseline)

    @property
    def model_sha256(self) -> str:
        """Hash of the networks that judge."""
        return self._model.sha256

    def of_bag(self, bag: str | Path) -> Judged:
        """Return the verdict on a bag; one that cannot be read is incomplete or invalid."""
        try:
            record = read_bag(bag)
        except (RecordError, UsageError) as error:
            return Judged(verdict_of_error(error, str(bag)))
        return self.of_record(record, str(bag))

    def fleet_cascade(self, kind: ProfileKind) -> Cascade | None:
        """Return the networks for a kind of test without a baseline, None where there are none."""
        return self._model.cascade(kind, "fleet")

    def commanded(self, record: Record) -> Record:
        """Return a record with the test that was commanded."""
        return record if self._profile is None else replace(record, profile=self._profile)

    def of_record(
        self, record: Record, source: str, findings: Sequence[Finding] | None = None
    ) -> Judged:
        """Return the verdict on a record.

        Parameters
        ----------
        record : of one test.
        source : names its bag.
        findings : of the guard, where they are known.
        """
        record = self.commanded(record)
        try:
            doubt = () if self._own is None else _checked_owner(self._own, record)
            verdict = self._diagnose(record, self._mode, self._own, findings)
            verdict = replace(verdict, bag=source, reasons=(*verdict.reasons, *doubt))
        except (RecordError, UsageError) as error:
            verdict = verdict_of_error(error, source)
        verdict = replace(verdict, actuator=record.provenance.name)
        return Judged(verdict, record.provenance.serial_number, record.provenance.start_time,
                      record.profile.name)

    def _diagnose(
        self, record: Record, mode: Mode, own: Baseline | None,
        findings: Sequence[Finding] | None = None,
    ) -> Verdict:
        with self._libraries.limit(limits=1):
            return forbidden(record, findings) or diagnose(
                record, self._model, mode=mode, baseline=own, checked=True)

    def _load_baseline(self, given: str | Path | Record) -> Baseline:
        """Return a record, or that of a bag, as baseline, its features taken once."""
        path = given.provenance.source or "record" if isinstance(given, Record) else given
        try:
            record = given if isinstance(given, Record) else read_bag(given)
        except RecordError as error:
            raise UsageError(f"{path}: cannot serve as baseline: {error}") from None
        verdict = self._diagnose(record, "robust", None)
        if verdict.outcome != "healthy":
            named = ", ".join(f.fault_class for f in verdict.faults) or verdict.outcome
            raise UsageError(
                f"{path}: cannot serve as baseline, it is not healthy itself ({named}): give a "
                "record of the actuator's acceptance"
            )
        try:
            return baseline_of(record, self._model)
        except UsageError as error:
            raise UsageError(f"{path}: {error}") from None


def forbidden(record: Record, findings: Sequence[Finding] | None = None) -> Verdict | None:
    """Return the verdict that the record checks amount to, None where they forbid nothing."""
    findings = guard_findings(record) if findings is None else findings
    if not findings:
        return None
    outcome = outcome_of(findings)
    return Verdict(
        outcome=outcome, probabilities={"unknown": 1.0} if outcome == "unknown" else {},
        reasons=tuple(map(reason_of, findings[:MOST_REASONS])), bag=record.provenance.source,
        cause=findings[0].rule,
    )


def _checked_owner(baseline: Baseline, record: Record) -> tuple[str, ...]:
    """Return whether it is not known that both are of one actuator; UsageError: of two."""
    ours, theirs = baseline.record.provenance.known_serial, record.provenance.known_serial
    if ours and theirs and ours != theirs:
        raise UsageError(
            f"the baseline is of actuator {ours}, the record of {theirs}: give a baseline of the "
            "same actuator"
        )
    return () if ours and theirs else (
        f"the {'record' if ours else 'baseline'} tells no serial number: whether the baseline is "
        "of this unit is not checked",)
