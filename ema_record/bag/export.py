"""Records in the formats of other tools: CSV, Parquet, and MCAP with a message a sample."""

from __future__ import annotations

import csv
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ema_record.bag.find import named
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
from ema_record.errors import OutputError, UsageError, library, unknown_name
from ema_record.files import exists, new_file
from ema_record.profile import Profile
from ema_record.record import Record
from ema_record.wire.sensors import (
    encode_currents,
    encode_dc_bus,
    encode_joint_states,
    encode_temperature,
)
from ema_record.wire.topics import DC_BUS, JOINT_STATES, TOPICS, WINDING_TEMPERATURE, Topic
from ema_record.wire.topics import PHASE_CURRENTS as PHASE_CURRENTS_TOPIC
from ema_record.wire.types import NANOSECONDS, message_class, serialize

REFERENCE_CURRENTS_TOPIC = "/ema/reference_currents"
COMMANDED = "/ema/commanded_position"
"""Of the surface (rad), a std_msgs/Float64 a sample."""
PHASE = "/ema/phase"
"""What the test does from then on, a std_msgs/String at each change."""
STRING = "std_msgs/msg/String"

_SUFFIXES = {"csv": ".csv", "parquet": ".parquet", "mcap": ""}
_ROWS = 5000


def export_record(record: Record, path: str | Path, file_format: str) -> Path:
    """Write a record in the format of other tools and return what was written.

    Parameters
    ----------
    record : all its samples are written.
    path : the file to make; for ``mcap`` the rosbag2 directory.
    file_format : ``csv``: a column a channel that was recorded, its name and unit in the first
        line. ``parquet``: the same, the unit in each field's metadata. ``mcap``: a bag of standard
        messages, one a sample, for PlotJuggler and other plotters that do not split arrays, with
        the commanded position, bus, temperature, and the phases of the test as they begin; a
        channel that was not recorded is NaN.

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
    bag = named(Path(bag))
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
    pa = library("pyarrow", "export to parquet", "export to csv")
    import pyarrow.parquet as pq

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
    """Write what was measured and commanded, a message a sample each; bus, winding, phases."""
    samples = record.samples
    if not np.isfinite(samples[:, TIME]).all() or samples[:, TIME].min() < 0.0:
        raise UsageError("the record has times that are negative or not finite")

    def at(times: np.ndarray) -> np.ndarray:
        """Return times of the record (s) in ns since the epoch."""
        after = np.rint(np.asarray(times, dtype=float) * NANOSECONDS).astype(np.int64)
        return np.asarray(np.maximum(record.provenance.start_time + after, 0))

    stamps, bus, winding = at(samples[:, TIME]), record.dc_bus, record.winding_temperature
    marks = phases(record.profile)
    surface = samples[:, SURFACE_POSITION]
    surface_speed = np.gradient(surface, samples[:, TIME]) if len(samples) > 1 else surface * 0.0
    topics = {
        JOINT_STATES: (stamps, encode_joint_states(
            stamps,
            samples[:, [ROTOR_ANGLE, SURFACE_POSITION]],
            np.column_stack([samples[:, MOTOR_SPEED], surface_speed]),
        )),
        PHASE_CURRENTS_TOPIC: (stamps, encode_currents(stamps, samples[:, PHASE_CURRENTS])),
        REFERENCE_CURRENTS_TOPIC: (
            stamps, encode_currents(stamps, samples[:, REFERENCE_CURRENTS])),
        COMMANDED: (stamps, [
            b"\x00\x01\x00\x00" + struct.pack("<d", position)
            for position in record.profile.command(samples[:, TIME]).tolist()]),
        DC_BUS: (at(bus[:, 0]), encode_dc_bus(at(bus[:, 0]), bus[:, 1], bus[:, 2])),
        WINDING_TEMPERATURE: (
            at(winding[:, 0]), encode_temperature(at(winding[:, 0]), winding[:, 1])),
        PHASE: (at(np.array([time for time, _ in marks])), [
            serialize(message_class(STRING)(data=text), STRING) for _, text in marks]),
    }
    table = (
        *(TOPICS[name] for name in topics if name in TOPICS),
        Topic(name=REFERENCE_CURRENTS_TOPIC, type=TOPICS[PHASE_CURRENTS_TOPIC].type),
        Topic(name=COMMANDED, type="std_msgs/msg/Float64"), Topic(name=PHASE, type=STRING),
    )
    order = [(stamp, number, topic) for topic, (times, _) in topics.items()
             for number, stamp in enumerate(times.tolist())]
    with BagWriter(
        path, profile=record.profile, provenance=record.provenance, topics=table,
        flush_interval=None,
    ) as writer, writer.whole():
        for stamp, number, topic in sorted(order):
            writer.write_raw(topic, topics[topic][1][number], stamp)
        writer.close(record.provenance.status)


def phases(profile: Profile) -> list[tuple[float, str]]:
    """Return when each phase of a test begins (s), and what the surface is commanded in it."""
    marks: list[tuple[float, str]] = []
    for (begin, here), (end, there) in zip(profile.points, profile.points[1:]):
        if end == begin and there != here:
            marks.append((begin, f"slew to {there:+.4g} rad"))
        elif there != here:
            speed = abs(there - here) / (end - begin)
            marks.append((begin, f"ramp to {there:+.4g} rad at {speed:.3g} rad/s"))
        elif end > begin and (not marks or marks[-1][0] != begin):
            marks.append((begin, "rest"))
    return marks


_WRITERS: dict[str, Callable[[Record, Path], None]] = {
    "csv": _write_csv,
    "parquet": _write_parquet,
    "mcap": _write_messages,
}

FORMATS = tuple(_WRITERS)
"""Formats of `export_record`."""
