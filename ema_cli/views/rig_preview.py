"""What a map makes of a rig's file: the first rows in SI units, and a picture of the signals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ema_cli.views.pictures import save_picture
from ema_rig.record import RigRecord

ROWS = 5
POINTS = 4000
"""Most points of a line; of each interval its smallest and its largest value."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#7F7F7F", "#E69F00")


def first_rows(record: RigRecord) -> list[list[str]]:
    """Return the labels of the channels and the first rows, as text."""
    return [[channel.label for channel in record.channels],
            *([f"{value:.6g}" for value in row] for row in record.samples[:ROWS])]


def draw(record: RigRecord, path: Path) -> None:
    """Draw each channel over time into a PNG that is new.

    Raises
    ------
    OutputError
        It exists, or cannot be written.
    """
    channels = record.channels[1:]
    figure = Figure(figsize=(8.0, 1.7 * len(channels) + 0.5), layout="constrained")
    axes = figure.subplots(len(channels), 1, sharex=True, squeeze=False)[:, 0]
    for k, (axis, channel) in enumerate(zip(axes, channels)):
        axis.plot(*_thinned(record.time, record.samples[:, k + 1]), linewidth=0.8,
                  color=COLOURS[k % len(COLOURS)])
        axis.set_ylabel(f"{channel.name.replace('_', ' ')}\n({channel.unit})")
        axis.grid(visible=True, color="#DDDDDD")
    axes[-1].set_xlabel("time (s)")
    figure.suptitle(f"{record.axis.name}: {len(record)} samples at {record.rate:.4g} 1/s")
    save_picture(figure, path)


def _thinned(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a line of at most `POINTS` points that looks the same."""
    step = len(values) // (POINTS // 2)
    if step < 2:
        return time, values
    count = len(values) // step
    blocks = values[:count * step].reshape(count, step)
    both = np.sort(np.column_stack([blocks.argmin(axis=1), blocks.argmax(axis=1)]), axis=1)
    rows = (both + step * np.arange(count)[:, None]).ravel()
    return time[rows], values[rows]
