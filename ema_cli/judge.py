"""From a bag to its verdict, as `ema check` and `ema trend` give it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ema_prognostics.verdict.diagnose import Mode
    from ema_prognostics.verdict.verdict import Verdict

    Judge = Callable[[Path], tuple[Verdict, str, int]]
    """From a bag to its verdict, serial number and start time (ns); answers for any bag."""


def bag_judge(
    *, profile: str | None = None, model: Path | None = None, mode: Mode = "robust",
    baseline: Path | None = None,
) -> Judge:
    """Return what judges a bag: record checks, then the cascade.

    Parameters
    ----------
    profile : the test that was commanded (name or YAML file), in place of the bags' own.
    model : model file, default the shipped one.
    mode : of the diagnosis.
    baseline : bag of a healthy test of the same actuator.

    Raises
    ------
    UsageError, ModelError, RecordError
        The profile, the model or the baseline cannot serve. A bag never raises.
    """
    from dataclasses import replace

    from ema_prognostics.cascade.model_file import load_model
    from ema_prognostics.verdict.baseline import check_same_actuator, load_baseline
    from ema_prognostics.verdict.diagnose import diagnose, verdict_of_error
    from ema_prognostics.verdict.guarded import guarded
    from ema_record.bag.read import read_bag
    from ema_record.errors import RecordError, UsageError
    from ema_record.profile import load_profile

    commanded = None if profile is None else load_profile(profile)
    loaded = load_model(model)
    own = None if baseline is None else load_baseline(baseline, loaded)

    def judge(bag: Path) -> tuple[Verdict, str, int]:
        try:
            record = read_bag(bag)
        except (RecordError, UsageError) as error:
            return verdict_of_error(error, str(bag)), "", 0
        if commanded is not None:
            record = replace(record, profile=commanded)
        try:
            if own is not None:
                check_same_actuator(own, record)
            verdict = guarded(record, lambda r: diagnose(r, loaded, mode=mode, baseline=own))
        except (RecordError, UsageError) as error:
            verdict = verdict_of_error(error, str(bag))
        provenance = record.provenance
        return replace(verdict, bag=str(bag)), provenance.serial_number, provenance.start_time

    return judge
