"""From a bag or a record to the verdict as plain data, whatever state the record is in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from ema_prognostics.cascade.model_file import load_model
from ema_prognostics.verdict.baseline import check_same_actuator, load_baseline
from ema_prognostics.verdict.diagnose import diagnose, verdict_of_error
from ema_prognostics.verdict.guarded import guarded
from ema_record.bag.read import read_bag
from ema_record.errors import RecordError, UsageError
from ema_record.record import Record


class Prognosis:
    """The cascade, loaded once.

    Parameters
    ----------
    model_file : model of the cascade, None for the shipped one.
    baseline : bag of a healthy test of the same actuator, None for none.
    """

    def __init__(
        self, model_file: str | Path | None = None, baseline: str | Path | None = None
    ) -> None:
        """Load model and baseline (ModelError, UsageError: they cannot serve)."""
        self._model = load_model(model_file)
        self._own = None if baseline is None else load_baseline(Path(baseline), self._model)

    def of_bag(self, path: str | Path) -> tuple[dict[str, Any], str]:
        """Return the verdict on a bag, as `ema check --json` prints it, and the serial number.

        A bag that cannot be read has a verdict too: ``incomplete`` or ``invalid``.
        """
        try:
            record = read_bag(path)
        except (RecordError, UsageError) as error:
            return verdict_of_error(error, str(path)).to_dict(), ""
        return self.of_record(record, str(path))

    def of_record(self, record: Record, source: str) -> tuple[dict[str, Any], str]:
        """Return the verdict on a record, and the serial number; `source` names its bag."""
        serial_number = record.provenance.serial_number
        record = replace(record, provenance=replace(record.provenance, source=source))
        try:
            if self._own is not None:
                check_same_actuator(self._own, record)
            verdict = guarded(record, lambda r: diagnose(r, self._model, baseline=self._own))
        except UsageError as error:
            verdict = verdict_of_error(error, source)
        return verdict.to_dict(), serial_number
