"""The baseline: an actuator's own healthy record, from its acceptance."""

from __future__ import annotations

from pathlib import Path

from ema_prognostics.cascade.model_file import Model
from ema_prognostics.verdict.diagnose import Baseline, baseline_of, diagnose
from ema_prognostics.verdict.guarded import guarded
from ema_record.bag.read import read_bag
from ema_record.errors import RecordError, UsageError
from ema_record.record import Record

UNKNOWN_SERIAL = "unknown"


def load_baseline(path: Path, model: Model) -> Baseline:
    """Return the record of a bag as baseline, its features taken once.

    Raises
    ------
    UsageError
        The bag cannot be read, or its record is not healthy by the fleet model.
    """
    try:
        record = read_bag(path)
    except RecordError as error:
        raise UsageError(f"{path}: cannot serve as baseline: {error}") from None
    verdict = guarded(record, lambda r: diagnose(r, model))
    if verdict.outcome != "healthy":
        named = ", ".join(f.fault_class for f in verdict.faults) or verdict.outcome
        raise UsageError(
            f"{path}: cannot serve as baseline, it is not healthy itself ({named}): give a "
            "record of the actuator's acceptance"
        )
    try:
        return baseline_of(record, model)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None


def check_same_actuator(baseline: Baseline, record: Record) -> None:
    """Raise UsageError if the two records are known to be of different actuators."""
    ours, theirs = baseline.record.provenance.serial_number, record.provenance.serial_number
    if UNKNOWN_SERIAL not in (ours, theirs) and ours != theirs:
        raise UsageError(
            f"the baseline is of actuator {ours}, the record of {theirs}: give a baseline of the "
            "same actuator"
        )
