"""`read_any`: the record of a bag, of the actuator or of a rig."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ema_record.bag.read import read_bag
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_rig.bag import is_rig_bag, read_rig_bag
from ema_rig.record import RigRecord


def read_any(path: str | Path, profile: str | Path | None = None) -> Record | RigRecord:
    """Return the record of a bag, with the test `profile` in place of its own.

    Raises
    ------
    RecordError
        It cannot be read; of a file of another kind the error says how to import it.
    """
    from ema_rig.ros_bag import how_to_import

    path = Path(path)
    foreign = how_to_import(path)
    if foreign is not None:
        raise foreign
    if is_rig_bag(path):
        return read_rig_bag(path)
    record = read_bag(path)
    return record if profile is None else replace(record, profile=load_profile(profile))
