"""Plots as data: before and after, where it lives, and whether the rest is noise."""

from __future__ import annotations

import re

import numpy as np

from ema_identification.report.words import number
from ema_identification.result import Curve, Panel
from ema_identification.rig.fit.balance import InputBalance, rms
from ema_identification.rig.laws.static import wave
from ema_identification.rig.report.words import binned, curve, signal_name, wave_words
from ema_identification.rig.search.remainder import Left
from ema_identification.rig.search.search import whiteness
from ema_identification.rig.signals.trajectory import Trajectory

MAX_POINTS = 4000
SPECTRUM_BINS = 400


def all_panels(before: InputBalance, after: InputBalance) -> tuple[Panel, ...]:
    """Return the plots of the model as given and with what was found."""
    trajectory = before.design.trajectory
    axis = trajectory.axis
    panels = [over_time(before, after),
              against(before, after, trajectory.speed, "speed", axis.speed_unit),
              against(before, after, trajectory.position, "position", axis.position_unit)]
    orders = [t.shape[0] for t in after.terms if t.law.in_position][:3]
    panels += [folded(before, after, order) for order in dict.fromkeys(orders)]
    return (*panels, spectrum(before, after), correlation(before, after))


def _labels(trajectory: Trajectory) -> tuple[str, str]:
    name = signal_name(trajectory)
    return name, f"{name} ({trajectory.axis.input_channel.unit})"


def over_time(before: InputBalance, after: InputBalance) -> Panel:
    """Return the measured input and what both models say, over the liveliest stretch."""
    trajectory = before.design.trajectory
    name, label = _labels(trajectory)
    count = len(trajectory.target)
    width = min(count, 800)
    gap = np.convolve(before.fit.residual**2, np.ones(width), mode="valid")
    first = int(np.argmax(gap)) if len(gap) else 0
    rows = slice(first, first + width)
    time = trajectory.time[rows]
    return Panel(
        name="input_over_time", step="show", x_label="time (s)", y_label=label,
        title=f"Measured {name} and what the model says of it, where they differ most",
        curves=(
            Curve(label="measured", x=time, y=trajectory.target[rows], role="measured"),
            Curve(label="model before", x=time,
                  y=(trajectory.target - before.fit.residual)[rows], role="before"),
            Curve(label="model after", x=time,
                  y=(trajectory.target - after.fit.residual)[rows], role="after"),
        ))


def against(
    before: InputBalance, after: InputBalance, x: np.ndarray, name: str, unit: str
) -> Panel:
    """Return the residual against speed or position, shape (rows,)."""
    port, label = _labels(before.design.trajectory)
    thin = slice(None, None, max(1, len(x) // MAX_POINTS))
    return Panel(
        name=f"residual_{name}", step="where", x_label=f"{name} ({unit})",
        y_label=f"residual of the {label}",
        title=f"Residual of the {port} against {name}: points before, lines are means",
        curves=(
            Curve(label="before", x=x[thin], y=before.fit.residual[thin], role="before",
                  style="points"),
            _means("mean before", x, before.fit.residual, "other"),
            _means("mean after", x, after.fit.residual, "after"),
        ))


def _means(label: str, x: np.ndarray, y: np.ndarray, role: str) -> Curve:
    mean_x, mean_y = binned(x, y, 60)
    return Curve(label=label, x=mean_x, y=mean_y, role=role)  # type: ignore[arg-type]


def folded(before: InputBalance, after: InputBalance, order: float) -> Panel:
    """Return the residual without one wave, folded over its period."""
    trajectory = before.design.trajectory
    _, label = _labels(trajectory)
    phase = np.mod(wave(trajectory, order) * trajectory.position, 2 * np.pi)
    index = next(i for i, t in enumerate(after.terms)
                 if t.law.in_position and t.shape[0] == order)
    span = after.span(index)
    own = after.columns[:, span] @ after.fit.coefficients[span]
    size = np.hypot(*after.columns[:, span].T)
    slow = size > min(0.2, 0.5 * float(size.max()))  # the filter lets it pass
    return Panel(
        name=re.sub(r"\W+", "_", f"folded_{order:.9g}"), step="name",
        title=f"Residual folded over one period of the wave in position, "
              f"{wave_words(trajectory, order)}",
        x_label="phase of the wave (rad)", y_label=f"residual of the {label}",
        curves=(
            _means("without this wave", phase[slow], (after.fit.residual + own)[slow], "before"),
            _means("with it", phase[slow], after.fit.residual[slow], "after"),
        ))


def spectrum(before: InputBalance, after: InputBalance) -> Panel:
    """Return the amplitude of waves in position, before and after."""
    trajectory = before.design.trajectory
    rotary = trajectory.axis.motion == "rotary"
    travel = max(trajectory.turns, 1e-9)
    orders = [t.shape[0] for t in after.terms if t.law.in_position]
    highest = max([1.3 * o for o in orders] + [50.0 if rotary else 50.0 / travel])
    grid = np.linspace(0.5 / travel, highest, SPECTRUM_BINS)
    grid = np.unique(np.concatenate([grid, orders, np.arange(1.0, highest) if rotary else []]))

    def waves(values: np.ndarray) -> np.ndarray:
        phase = np.exp(-1j * np.outer(grid, wave(trajectory, 1.0) * trajectory.position))
        return np.asarray(2.0 * np.abs(phase @ values) / len(values))

    port, label = _labels(trajectory)
    return Panel(
        name="spectrum_position", step="where",
        title=f"Waves in position that the residual of the {port} holds, before and after",
        x_label="periods a turn" if rotary else "periods a m", y_label=f"amplitude of the {label}",
        curves=(Curve(label="before", x=grid, y=waves(before.fit.residual), role="before"),
                Curve(label="after", x=grid, y=waves(after.fit.residual), role="after")))


def correlation(before: InputBalance, after: InputBalance) -> Panel:
    """Return the autocorrelation of the residual, before and after."""
    lags, first, bound = whiteness(before)
    _, last, _ = whiteness(after)
    level = np.full(len(lags), bound)
    return Panel(
        name="residual_whiteness", step="show", x_label="lag (s)",
        y_label="autocorrelation of the residual",
        title="Autocorrelation of the residual: within the dashed lines it would be white noise",
        curves=(Curve(label="before", x=lags, y=first, role="before"),
                Curve(label="after", x=lags, y=last, role="after"),
                Curve(label="95 % of white noise", x=lags, y=level, role="floor"),
                Curve(label="", x=lags, y=-level, role="floor")))


def unknown_panel(left: Left, trajectory: Trajectory) -> Panel:
    """Return the shape of what no law holds."""
    port, label = _labels(trajectory)
    axis = trajectory.axis
    if left.shape.order is not None:
        x = np.linspace(0.0, 4 * np.pi, 200)
        first, second = left.coefficients
        y = first * np.cos(x) + second * np.sin(x)
        x_label = "phase of the wave (rad)"
    else:
        x, y = curve(left, trajectory)
        x_label = {
            "speed": f"speed ({axis.speed_unit})", "position": f"position ({axis.position_unit})",
            "load": f"acceleration ({axis.speed_unit}/s)", "test phase": "time (s)",
        }[left.shape.against]
    return Panel(
        name="unknown_effect", step="where", x_label=x_label, y_label=label,
        title=f"What no law of the catalogue holds: {port} against {left.shape.label}, "
              f"{number(rms(left.shape.columns @ left.coefficients))} {axis.input_channel.unit} "
              "rms",
        curves=(Curve(label="measured shape", x=x, y=y, role="measured"),))
