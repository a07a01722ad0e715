"""Records in the formats of other tools: CSV, Parquet, and MCAP with a message a sample."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ema_record.bag.writer import BagWriter
from ema_record.channels import (
    CHANNELS,
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    TIME,
)
from ema_record.errors import OutputError, UsageError, unknown_name
from ema_record.files import exists, new_file
from ema_record.record import Record
from ema_record.wire.sensors import encode_currents, encode_joint_states
from ema_record.wire.topics import JOINT_STATES, TOPICS, Topic
from ema_record.wire.topics import PHASE_CURRENTS as PHASE_CURRENTS_TOPIC
from ema_record.wire.types import NANOSECONDS

REFERENCE_CURRENTS_TOPIC = "/ema/reference_currents"

_SUFFIXES = {"csv": ".csv", "parquet": ".parquet", "mcap": ""}
_ROWS = 5000


def export_record(record: Record, path: str | Path, file_format: str) -> Path:
    """Write a record in the format of other tools.

    Parameters
    ----------
    record : Record
        All its samples are written.
    path : path-like
        The file to make; for ``mcap`` the rosbag2 directory.
    file_format : str
        ``csv``: a column a channel that was recorded, its name and unit in the first line.
        ``parquet``: the same, the unit in each field's metadata. ``mcap``: a bag of standard
        messages, one a sample, for PlotJuggler and other plotters that do not split arrays; a
        channel that was not recorded is NaN.

    Returns
    -------
    Path
        What was written.

    Raises
    ------
    OutputError
        `path` exists, or cannot be written.
    UsageError
        The format is not known, or pyarrow is missing for ``parquet``.

    """
    writer = _WRITERS.get(file_format)
    if writer is None:
        raise unknown_name("export format", file_format, _WRITERS,
                           f"the formats are {', '.join(_WRITERS)}")
    path = Path(path)
    if path.exists():
        raise exists(path)
    if len(record) == 0:
        raise UsageError("the record has no sample: there is nothing to export")
    writer(record, path)
    return path


def default_path(bag: str | Path, file_format: str) -> Path:
    """Return where a bag is exported to without a name: beside it, with the format's suffix."""
    bag = Path(bag)
    stem = bag.name.removesuffix(".mcap")
    return bag.with_name(stem + (_SUFFIXES.get(file_format) or "_messages"))


def _write_csv(record: Record, path: Path) -> None:
    with new_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        columns = list(record.columns)
        writer.writerow([CHANNELS[column].label for column in columns])
        for first in range(0, len(record), _ROWS):
            writer.writerows(record.samples[first:first + _ROWS, columns].tolist())


def _write_parquet(record: Record, path: Path) -> None:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise UsageError(
            "export to parquet needs the package pyarrow, which is not installed: "
            "pip install pyarrow, or export to csv"
        ) from None
    recorded = record.columns
    schema = pa.schema(
        [pa.field(CHANNELS[k].name, pa.float64(), metadata={"unit": CHANNELS[k].unit})
         for k in recorded],
        metadata={
            "serial_number": record.provenance.serial_number,
            "software_version": record.provenance.software_version,
            "start_time": str(record.provenance.start_time),
            "status": record.provenance.status,
            "actuator": record.provenance.actuator,
            "profile": record.profile.model_dump_json(),
        },
    )
    columns = [np.ascontiguousarray(record.samples[:, column]) for column in recorded]
    with new_file(path) as temporary, temporary.open("wb") as file:
        try:
            pq.write_table(pa.Table.from_arrays(columns, schema=schema), file)
        except pa.ArrowException as error:
            raise OutputError(f"{path}: cannot be written ({str(error)[:80]})") from None


def _write_messages(record: Record, path: Path) -> None:
    """Write joint states, phase currents and reference currents, a message a sample each."""
    samples = record.samples
    if not np.isfinite(samples[:, TIME]).all() or samples[:, TIME].min() < 0.0:
        raise UsageError("the record has times that are negative or not finite")
    stamps = record.provenance.start_time + np.rint(samples[:, TIME] * NANOSECONDS).astype(
        np.int64
    )
    surface = samples[:, SURFACE_POSITION]
    surface_speed = np.gradient(surface, samples[:, TIME]) if len(samples) > 1 else surface * 0.0
    topics = {
        JOINT_STATES: encode_joint_states(
            stamps,
            samples[:, [ROTOR_ANGLE, SURFACE_POSITION]],
            np.column_stack([samples[:, MOTOR_SPEED], surface_speed]),
        ),
        PHASE_CURRENTS_TOPIC: encode_currents(stamps, samples[:, PHASE_CURRENTS]),
        REFERENCE_CURRENTS_TOPIC: encode_currents(stamps, samples[:, REFERENCE_CURRENTS]),
    }
    table = (
        TOPICS[JOINT_STATES],
        TOPICS[PHASE_CURRENTS_TOPIC],
        Topic(name=REFERENCE_CURRENTS_TOPIC, type=TOPICS[PHASE_CURRENTS_TOPIC].type),
    )
    with BagWriter(
        path, profile=record.profile, provenance=record.provenance, topics=table
    ) as writer:
        for row, stamp in enumerate(stamps.tolist()):
            for topic, messages in topics.items():
                writer.write_raw(topic, messages[row], stamp)
        writer.close(record.provenance.status)


_WRITERS: dict[str, Callable[[Record, Path], None]] = {
    "csv": _write_csv,
    "parquet": _write_parquet,
    "mcap": _write_messages,
}

FORMATS = tuple(_WRITERS)
"""Formats of `export_record`."""
