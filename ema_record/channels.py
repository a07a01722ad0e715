"""The channels of `/ema/samples`: names, units, order.

A sample is the mean over its interval. Sample k covers ``[k, k + 1] / rate``;
its time is the middle of the interval.
"""

from __future__ import annotations

from typing import NamedTuple

from ema_record.errors import InvalidRecordError


class Channel(NamedTuple):
    """One column of the acquisition."""

    name: str
    unit: str

    @property
    def label(self) -> str:
        """Name and unit as they stand in a message, e.g. ``motor_speed[rad/s]``."""
        return f"{self.name}[{self.unit}]"


CHANNELS: tuple[Channel, ...] = (
    Channel("time", "s"),
    Channel("motor_speed", "rad/s"),
    Channel("phase_current_a", "A"),
    Channel("phase_current_b", "A"),
    Channel("phase_current_c", "A"),
    Channel("reference_current_a", "A"),
    Channel("reference_current_b", "A"),
    Channel("reference_current_c", "A"),
    Channel("rotor_angle", "rad"),
    Channel("surface_position", "rad"),
)

N_CHANNELS = len(CHANNELS)
CHANNEL_NAMES: tuple[str, ...] = tuple(c.name for c in CHANNELS)
CHANNEL_LABEL: str = ",".join(c.label for c in CHANNELS)

TIME = 0
MOTOR_SPEED = 1
PHASE_CURRENTS = slice(2, 5)
REFERENCE_CURRENTS = slice(5, 8)
ROTOR_ANGLE = 8
SURFACE_POSITION = 9


def check_channel_label(label: str) -> None:
    """Raise InvalidRecordError unless `label` is `CHANNEL_LABEL`."""
    if label == CHANNEL_LABEL:
        return
    found = label.split(",")
    for index, channel in enumerate(CHANNELS):
        if index >= len(found) or found[index] != channel.label:
            got = found[index][:60] if index < len(found) else "nothing"
            raise InvalidRecordError(
                f"/ema/samples: channel {index} is {got!r}, expected {channel.label!r}: "
                "record with an acquisition that publishes the channels of this version, or "
                "convert the file with 'ema import'"
            )
    raise InvalidRecordError(
        f"/ema/samples: {len(found)} channels, expected {N_CHANNELS}: the last ones "
        f"({found[N_CHANNELS].strip()[:60]!r} ...) are not known"
    )
