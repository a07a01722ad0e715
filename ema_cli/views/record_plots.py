"""Plots of one record, as PNG: speed, folded currents, spectrum, surface motion, torque.

Colours are those of Okabe and Ito, told apart by colour-blind readers; line styles tell the
same apart in black and white. Angles are in degrees, all else in SI units.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ema_cli.console import check_new, check_new_file, neutral
from ema_cli.views.pictures import save_picture
from ema_prognostics.features.turns import TURN, Turns, paper_window, rotor_lines, whole_turns
from ema_prognostics.paper.features import fold
from ema_record.actuator import Actuator, load_actuator
from ema_record.channels import (
    ALL,
    CHANNELS,
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
)
from ema_record.errors import OutputError, RecordError
from ema_record.files import cannot_write
from ema_record.record import Record
from ema_sim.rebuild import completed

BLACK, ORANGE, GREEN = "#000000", "#E69F00", "#009E73"
BLUE, VERMILION, GREY = "#0072B2", "#D55E00", "#7F7F7F"
PHASE_COLOURS = {"a": BLUE, "b": VERMILION, "c": GREEN}

STYLE: dict[Any, Any] = {
    "font.size": 10.0, "axes.labelsize": 10.0, "axes.titlesize": 11.0, "legend.fontsize": 9.0,
    "axes.grid": True, "grid.color": "#DDDDDD", "grid.linewidth": 0.6, "lines.linewidth": 1.2,
    "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
    "savefig.dpi": 150, "figure.constrained_layout.use": True, "agg.path.chunksize": 10_000,
}
SIZE = (7.2, 4.4)
"""Width and height (inch): a page between its margins."""
FOLD_BINS = 180
"""Bins of a turn of folded currents, 2° each."""
LINEAR = 1.0 / 600.0
"""Of the way to the end stop, to a power of ten: up to there errors are drawn linearly."""
MAX_ORDER = 12
"""Highest multiple of f_e in the spectrum."""
NAMES = ("speed", "currents", "spectrum", "surface", "torque")
"""The plots; each makes one PNG of that name."""


def check_plot_folder(folder: Path) -> None:
    """Raise OutputError unless the plots can be made in `folder`; nothing is overwritten."""
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is no folder: choose another name for the plots")
    if folder.exists():
        check_new_file(*(folder / f"{name}.png" for name in NAMES))
    else:
        check_new(folder)


def plot_record(record: Record, folder: Path, *, trace: np.ndarray | None = None) -> list[Path]:
    """Plot a record.

    Parameters
    ----------
    record : what is shown.
    folder : where the PNG go; made if it does not exist.
    trace : ndarray, shape (n, 3). Motor torque (N m), shaft torque (N m), surface speed (rad/s)
        from the simulation. Without it the torque is estimated from the currents, and labelled so.

    Returns
    -------
    list of Path
        The files, in the order of `NAMES`. Those that need turns of the rotor are left out
        of a record without any.

    Raises
    ------
    OutputError
        A plot exists, or cannot be written.
    """
    check_plot_folder(folder)
    figures = record_figures(record, trace=trace)
    with mpl.rc_context(STYLE):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            return [save_picture(figures[name], folder / f"{name}.png") for name in figures]
        except OSError as error:
            raise cannot_write(folder, error) from None


def record_figures(record: Record, *, trace: np.ndarray | None = None) -> dict[str, Figure]:
    """Return the plots of a record by name, in the order of `NAMES`; `trace` as above."""
    actuator = load_actuator()
    record, rebuilt = completed_record(record)
    turns = None
    if ROTOR_ANGLE in record.columns:
        with contextlib.suppress(RecordError):
            turns = whole_turns(record, paper_window(record.profile))
    with mpl.rc_context(STYLE):
        figures = {"speed": _speed(record)}
        if rebuilt:
            figures["speed"].text(0.01, 0.005, rebuilt, fontsize=8.0, color=GREY)
        if turns is not None:
            figures["currents"] = _currents(record, turns)
            figures["spectrum"] = _spectrum(turns)
        figures["surface"] = _surface(record, actuator)
        figures["torque"] = _torque(record, trace)
    return figures


def completed_record(record: Record) -> tuple[Record, str]:
    """Return a record with the channels that it lacks rebuilt, and a line that says which."""
    missing = [CHANNELS[c].name for c in ALL if c not in record.columns]
    if not missing:
        return record, ""
    try:
        whole = replace(record, samples=completed(record, load_actuator()))
    except RecordError:
        return record, f"not recorded: {', '.join(missing)}"
    return whole, f"not recorded, rebuilt from the others: {', '.join(missing)}"


def _title(record: Record, what: str) -> str:
    serial_number = record.provenance.serial_number
    return literal(f"{what}: profile {record.profile.name}, actuator {serial_number}")


def literal(text: str) -> str:
    """Return text from a record as a plot shows it: on one line, no formula between dollars."""
    return neutral(text).replace("$", r"\$")


def _speed(record: Record) -> Figure:
    figure = Figure(figsize=SIZE)
    axes = figure.subplots()
    first, last = paper_window(record.profile)
    if last <= record.time[-1] + 0.01:
        axes.axvspan(first, last, color=ORANGE, alpha=0.15, lw=0.0, label="analysis window")
    axes.plot(record.time, record.channel("motor_speed"), color=BLUE, lw=0.7, label="measured")
    axes.set(xlabel="time (s)", ylabel="motor speed (rad/s)", title=_title(record, "Motor speed"))
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def _currents(record: Record, turns: Turns) -> Figure:
    figure = Figure(figsize=(SIZE[0], 6.2))
    panels = figure.subplots(3, 1, sharex=True, sharey=True)
    for k, axes in enumerate(panels):
        _fold_panel(axes, turns, k)
    panels[0].set_title(
        f"{_title(record, 'Phase currents')}\nfolded over {turns.count} turns, "
        f"$f_e$ = {turns.frequency:.1f} Hz"
    )
    panels[-1].set(xlabel="electrical rotor angle (°)", xlim=(0.0, 360.0))
    panels[-1].set_xticks(np.arange(0, 361, 30))
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, markerscale=5.0)
    return figure


def _fold_panel(axes: Axes, turns: Turns, phase: int) -> None:
    """Draw the current of phase 0, 1 or 2 and its reference against the rotor angle."""
    name = "abc"[phase]
    current = turns.samples[:, PHASE_CURRENTS][:, phase]
    reference = turns.samples[:, REFERENCE_CURRENTS][:, phase]
    bins = (np.arange(FOLD_BINS) + 0.5) * (360.0 / FOLD_BINS)
    axes.plot(np.degrees(np.mod(turns.theta, TURN)), current, ".", ms=1.2, color=GREY, alpha=0.35,
              rasterized=True, label="samples")
    axes.plot(bins, fold(turns, current, FOLD_BINS), color=PHASE_COLOURS[name], lw=1.8,
              label="mean of the current (solid, coloured)")
    axes.plot(bins, fold(turns, reference, FOLD_BINS), color=BLACK, lw=1.2, ls="--",
              label="mean of the reference")
    axes.set_ylabel(f"phase {name} (A)")


def speed_spectrum(turns: Turns) -> tuple[np.ndarray, np.ndarray]:
    """Return the lines of the motor speed at multiples of the rotor angle, mean and drift apart.

    Returns
    -------
    order : ndarray, shape (MAX_ORDER * turns.count + 1,)
        Multiples of f_e, spaced by one over the number of turns.
    amplitude : ndarray, same shape
        Peak (rad/s); 0 at order 0.
    """
    whole = replace(turns, theta=turns.theta / turns.count)  # all the turns as one
    lines = rotor_lines(whole, turns.samples[:, MOTOR_SPEED], MAX_ORDER * turns.count)
    return np.arange(len(lines)) / turns.count, np.abs(np.append(0.0, lines[1:]))


def _spectrum(turns: Turns) -> Figure:
    order, amplitude = speed_spectrum(turns)
    figure = Figure(figsize=SIZE)
    axes = figure.subplots()
    axes.semilogy(order, amplitude, color=GREY, lw=0.8, label="between the lines")
    whole = (np.abs(order - np.rint(order)) < 1e-9) & (order > 0.5)
    even = whole & (np.rint(order) % 2 == 0)
    odd = whole & ~even
    for chosen, colour, marker, label in (
        (odd, VERMILION, "D", "odd multiples"), (even, BLUE, "o", "even multiples"),
    ):
        axes.vlines(order[chosen], 1e-12, amplitude[chosen], color=colour, lw=1.5)
        axes.plot(order[chosen], amplitude[chosen], marker, color=colour, ms=5.0, label=label)
    top = float(amplitude[order > 0.5].max())
    bottom = float(np.median(amplitude[order > 0.5]))
    axes.set_ylim(0.3 * bottom, 3.0 * top)
    axes.set_xlim(0.0, order[-1] + 0.3)
    axes.set_xticks(np.arange(0, int(order[-1]) + 1))
    axes.set(
        xlabel=f"multiple of the electrical frequency $f_e$ = {turns.frequency:.2f} Hz",
        ylabel="amplitude of motor speed (rad/s)",
        title=f"Speed against rotor angle: lines over {turns.count} turns",
    )
    figure.legend(loc="outside lower center", ncols=3)
    return figure


def _surface(record: Record, actuator: Actuator) -> Figure:
    figure = Figure(figsize=(SIZE[0], 5.4))
    position, error = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    command = record.profile.command(record.time)
    measured = record.channel("surface_position")
    position.plot(record.time, command, color=BLACK, ls="--", label="command")
    position.plot(record.time, measured, color=BLUE, label="measured")
    position.set(ylabel="surface position (rad)", title=_title(record, "Surface"))
    position.legend(loc="lower right")
    difference = 1e3 * (command - measured)
    error.plot(record.time, difference, color=VERMILION, lw=0.7)
    linear = 10.0 ** np.rint(np.log10(1e3 * LINEAR * actuator.surface.end_stop))
    ticks = linear * 10.0 ** np.arange(4)
    labels = [f"{tick:g}" if k % 2 else "" for k, tick in enumerate(ticks)]
    error.set_yscale("symlog", linthresh=linear)
    error.set_yticks([*-ticks[::-1], 0.0, *ticks])
    error.set_yticklabels([*(f"−{text}" if text else "" for text in labels[::-1]), "0", *labels])
    error.set(xlabel="time (s)", ylabel=f"command − measured\n(mrad, linear to ±{linear:g})")
    return figure


def torque_estimate(record: Record) -> np.ndarray:
    """Return the torque that the measured currents give with nominal constants.

    ``k Σ f(θ − φ_k) i_k``, f the back-EMF of a turn: what a healthy motor would have. Shape (n,)
    (N m).
    """
    from ema_sim.machine import THIRD, unit_back_emf

    motor = load_actuator().motor
    theta = record.channel("rotor_angle")
    torque = np.zeros(len(record))
    for k, phase in enumerate("abc"):
        shape = unit_back_emf(theta - k * THIRD, motor)
        torque += motor.back_emf_constant * shape * record.channel(f"phase_current_{phase}")
    return torque


def _torque(record: Record, trace: np.ndarray | None) -> Figure:
    time = record.time
    if trace is None:
        figure = Figure(figsize=SIZE)
        axes = figure.subplots()
        axes.plot(time, torque_estimate(record), color=GREEN, lw=0.7,
                  label="estimate from currents and nominal back-EMF constants; not measured")
        axes.set(xlabel="time (s)", ylabel="motor torque, estimate (N m)",
                 title=_title(record, "Torque"))
        figure.legend(loc="outside lower center")
        return figure
    figure = Figure(figsize=(SIZE[0], 5.4))
    motor, shaft = figure.subplots(2, 1, sharex=True)
    motor.plot(time, trace[:, 0], color=BLUE, lw=0.7)
    motor.set(ylabel="motor torque (N m)", title=_title(record, "Torque, simulated"))
    shaft.plot(time, trace[:, 1], color=VERMILION, lw=0.7)
    shaft.set(xlabel="time (s)", ylabel="shaft torque on surface (N m)")
    return figure
