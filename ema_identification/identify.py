"""`identify`: what a model lacks to explain measured records, for an actuator or a rig."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from ema_identification.result import Identification
from ema_record.actuator_type import OWN_KIT, another_actuator, is_of_another_actuator
from ema_record.errors import UsageError
from ema_record.record import Record

if TYPE_CHECKING:
    from ema_rig.record import RigRecord
    from ema_sim.model_file import Model

Progress = Callable[[str, float], None]


def identify(
    measured: Sequence[Record | RigRecord], model: Model | str | Path | None = None, *,
    validate: Sequence[Record | RigRecord] = (), without: Sequence[str] = (),
    baseline: Sequence[Record | RigRecord] = (), progress: Progress | None = None,
    workers: int = 1, seed: int = 0,
) -> Identification:
    """Find the disagreement between a model and records, name what is missing, add it.

    Parameters
    ----------
    measured : records of one unit; several may be of different profiles.
    model : the model or its file; None for the kit's actuator (for a rig: what it has).
    validate : records of the same unit that take no part in the fit.
    without : effects of the catalogue that are not to be considered.
    baseline : records of the same unit and test from when it was accepted (of an actuator): what
        has changed since is said too (`Identification.since`).
    progress : called with what is being done and how much of it is (0 to 1).
    workers : how many simulations run at a time; their number does not change the answer.
    seed : of all simulations; the same seed gives the same answer.

    Raises
    ------
    RecordError
        A record cannot be used; the error says which test to run.
    UsageError
        Records of two units or kinds, of another actuator than the kit's, or an effect that is
        not known.
    """
    if not measured:
        raise UsageError("0 records: give at least one measured record")
    kinds = {isinstance(r, Record) for r in (*measured, *validate, *baseline)}
    if len(kinds) > 1:
        raise UsageError("records of the actuator and of a rig together: identify one at a time")
    if kinds == {False}:
        from ema_identification.rig.workflow import identify_rig

        if baseline:
            raise UsageError("a baseline is for records of an actuator; of a rig, identify both "
                             "records and compare the models")
        if model is not None and not isinstance(model, str | Path):
            raise UsageError("a rig needs the path of its model file, not an actuator")
        _check_roles(measured, validate, ())
        return identify_rig(
            cast("Sequence[RigRecord]", measured), model,
            validate=cast("Sequence[RigRecord]", validate), without=without, progress=progress)
    records, held, accepted = (cast("Sequence[Record]", x) for x in (measured, validate, baseline))
    _check_one_unit((*records, *held, *accepted))
    _check_kit((*records, *held, *accepted))
    _check_roles(records, held, accepted)
    from ema_identification.actuator.measure.runs import silent
    from ema_identification.actuator.workflow import identify_actuator
    from ema_sim.model_file import load_model_file

    if model is None or isinstance(model, str | Path):
        model = load_model_file(model)
    return identify_actuator(records, model, validate=held, baseline=accepted, without=without,
                             progress=progress or silent, workers=workers, seed=seed)


def build_library(
    records: Sequence[Record], folder: Path, *, whole: bool = True, workers: int = 1,
    progress: Progress | None = None,
) -> None:
    """Make the library of the present kit's actuator for records such as these.

    Its parts are kept in `folder` as each is done; what is there already is not made again. What
    the records themselves tell of the type, its discrepancy, is kept beside it.

    Parameters
    ----------
    records : of healthy units, at least one; the test, rate and channels of the first count.
    folder : `library/` of the kit.
    whole : False keeps what the records tell alone; the library is made at its first use.
    workers : processes that simulate, -1 for all cores.
    progress : called with what is being done and how much of it is (0 to 1).
    """
    from joblib import cpu_count
    from threadpoolctl import threadpool_limits

    from ema_identification.actuator.library.acceptance import keep_acceptance
    from ema_identification.actuator.library.build import fleet_library
    from ema_identification.actuator.measure.features import nominal_rate
    from ema_identification.actuator.measure.recorder import recorded_alike
    from ema_identification.actuator.measure.runs import silent
    from ema_sim.model_file import load_model_file

    workers = cpu_count() if workers < 0 else workers
    with threadpool_limits(limits=1):  # as `identify_actuator` makes it
        model, first = load_model_file(), records[0]
        if whole:
            fleet_library(recorded_alike([first], model), first.profile, rate=nominal_rate(first),
                          workers=workers, progress=progress or silent, folder=folder)
        keep_acceptance(records, model, folder)


SAME = 0.9
"""Share of samples from which a record is (a part of) another one: axes at rest are alike too."""


def _check_roles(
    measured: Sequence[Record | RigRecord], validate: Sequence[Record | RigRecord],
    baseline: Sequence[Record | RigRecord],
) -> None:
    """Refuse a record, or part of it, that is given twice: it would count so, or judge itself."""
    roles = [(one, "as measured", "") for one in measured]
    roles += [(one, "for validation", "a gap shown on the data of the fit proves nothing")
              for one in validate]
    roles += [(one, "as baseline", "nothing has changed since itself") for one in baseline]
    for k, (one, role, why) in enumerate(roles):
        for other, before, _ in roles[:k]:
            if one is other or _is_alike(one.samples, other.samples):
                source = one.provenance.source if isinstance(one, Record) else one.source
                twice = f"{before} and {role}: {why}" if before != role else (
                    f"twice {role}: it would count as two")
                raise UsageError(f"{source or 'a record'} is given {twice}; record another test "
                                 "and give that")


def _is_alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether nearly all samples of the shorter record are those of the other."""
    if one.shape[1:] != other.shape[1:]:
        return False
    few, many = sorted((one, other), key=len)
    rows = {row.tobytes() for row in many}
    return sum(row.tobytes() in rows for row in few) > SAME * len(few)


def _check_kit(records: Sequence[Record]) -> None:
    """Refuse a record that names another actuator than the kit's."""
    for record in records:
        if is_of_another_actuator(record.provenance.actuator):
            raise UsageError(
                f"{record.provenance.source or record.profile.name}: "
                f"{another_actuator(record.provenance.actuator)}: {OWN_KIT}")


def _check_one_unit(records: Sequence[Record]) -> None:
    """Refuse records of two units; one without a serial number may be of any."""
    first: dict[str, str] = {}
    for record in records:
        if serial := record.provenance.known_serial:
            first.setdefault(serial, record.provenance.source or record.profile.name)
    if len(first) > 1:
        (one, here), (other, there), *_ = first.items()
        raise UsageError(
            f"{here} is of the unit {one}, {there} of {other}: their tolerances differ, so "
            "identify one unit at a time")
