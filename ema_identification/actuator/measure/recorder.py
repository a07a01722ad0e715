"""Records of recorders that lack channels: those that all have, the others rebuilt.

Runs of the model are recorded by the same recorder and completed in the same way, so that what a
rebuilt channel cannot show shows in neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ema_record.actuator import Actuator
from ema_record.channels import (
    ALL,
    CHANNEL_NAMES,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
)
from ema_record.errors import InvalidRecordError
from ema_record.record import Record
from ema_sim.model_file import Model
from ema_sim.rebuild import completed

THIRD_CURRENT = ALL[PHASE_CURRENTS][-1]


def recorded_alike(records: Sequence[Record], model: Model) -> Model:
    """Return the model with a recorder of the channels that all `records` have.

    Raises
    ------
    InvalidRecordError
        Time, speed, or one of the first two phase currents is not there.
    """
    needed = set(ALL) - {THIRD_CURRENT, *ALL[REFERENCE_CURRENTS], ROTOR_ANGLE, SURFACE_POSITION}
    for record in records:
        lacking = sorted(needed - set(record.columns))
        if lacking:
            name = record.provenance.source or f"record of {record.profile.name}"
            raise InvalidRecordError(
                f"{name}: no channel {CHANNEL_NAMES[lacking[0]]}: time, motor speed and the "
                "phase currents a and b cannot be told from others; record them too")
    common = set(ALL).intersection(*(record.columns for record in records))
    a = model.actuator
    return model._replace(actuator=a._replace(acquisition=a.acquisition._replace(
        phase_current_c=int(THIRD_CURRENT in common),
        reference_currents=int(common.issuperset(ALL[REFERENCE_CURRENTS])),
        rotor_angle=int(ROTOR_ANGLE in common),
        surface_position=int(SURFACE_POSITION in common))))


def whole(record: Record, actuator: Actuator) -> Record:
    """Return a record with all channels, those that the actuator's recorder lacks rebuilt."""
    absent = [c for c in ALL if c not in actuator.acquisition.columns]
    if not absent:
        return record
    samples = record.samples.copy()
    samples[:, absent] = np.nan
    try:
        return replace(record, samples=completed(replace(record, samples=samples), actuator))
    except InvalidRecordError as error:
        name = record.provenance.source or f"record of {record.profile.name}"
        raise InvalidRecordError(f"{name}: {error}") from None
