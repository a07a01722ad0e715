"""Training of one view of the cascade on a campaign: networks, thresholds, interval widths."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ema_prognostics.model_body import (
    LinePart,
    NetworkPart,
    OutputPart,
    SeverityPart,
    View,
    ViewPart,
    rounded,
)
from ema_prognostics.robust.calibration import bin_widths, tail_quantile
from ema_prognostics.robust.campaign import Campaign
from ema_prognostics.robust.cascade import logit
from ema_prognostics.robust.classes import OUTPUTS, SEVERITY_OF
from ema_prognostics.robust.guard_training import train_guard
from ema_prognostics.robust.inputs import Inputs, derive, group_inputs
from ema_prognostics.robust.lines import LineFilter, fit_line_filter
from ema_prognostics.robust.networks import fit_classifier, fit_regressor
from ema_prognostics.robust.vector import ABSOLUTE, difference_names, differences, rotate

UNITS = {"short": 2e-3, "eccentricity": 2e-3, "static_eccentricity": 2e-3,
         "motor_friction": 0.05, "surface_friction": 0.05, "backlash": 3e-5}
"""Severity below which a network's target is linear (of each class)."""
FALSE_ALARMS = 0.0005
"""Rate of healthy records that each of the outputs may announce."""
HELD_BACK = 5
"""One unit in this many calibrates instead of training."""


def view_inputs(campaign: Campaign, view: View) -> tuple[list[str], np.ndarray]:
    """Return the names and the features of a view, shape (n, d)."""
    names = list(campaign.names)
    if view == "fleet":
        return names, campaign.record
    return difference_names(names), differences(campaign.record, campaign.baseline)


def _turn_labels(y: np.ndarray, thirds: int) -> np.ndarray:
    """Return severities, shape (n, 8), after `vector.rotate` by `thirds`."""
    out = y.copy()
    out[:, :3] = np.roll(y[:, :3], -thirds, axis=1)
    return out


def train_view(
    campaign: Campaign, healthy: Campaign, kind: str, view: View, *, seed: int,
    hidden: int = 16, epochs: int = 60, progress: Callable[[str], None] = lambda _: None,
) -> ViewPart:
    """Return the cascade of one view.

    Parameters
    ----------
    campaign : units with and without faults; one unit in `HELD_BACK` calibrates.
    healthy : other units, healthy only; they set the thresholds.
    kind : of the test.
    view : with or without baseline.
    seed : of the networks' weights.
    hidden, epochs : size of a member of the networks; passes through the data.
    progress : called with what begins.
    """
    names, x = view_inputs(campaign, view)
    y = campaign.severity
    fit = campaign.unit % HELD_BACK != 0
    _, sound = view_inputs(healthy, view)
    reference = x[fit & (y == 0.0).all(axis=1)]
    extra = campaign.baseline[fit] if view == "fleet" else np.empty((0, x.shape[1]))
    if view == "fleet":  # every acceptance record is a healthy one
        reference = np.vstack([reference, extra])
        sound = np.vstack([sound, healthy.baseline])
    else:  # either of two healthy records may be the baseline
        sound = np.vstack([sound, differences(healthy.baseline, healthy.record)])
    lines, absolute = _filters(names, reference, x[fit], y[fit], view)
    raw = derive(names, reference, lines, absolute)
    center, spread = rounded(np.median(raw, axis=0)), rounded(np.maximum(raw.std(axis=0), 1e-6))
    inputs = Inputs(names, lines, absolute, np.array(center), np.array(spread))
    xs = np.vstack([x[fit], extra])
    ys = np.vstack([y[fit], np.zeros((len(extra), y.shape[1]))])
    which, severity = {}, {}
    for group in dict.fromkeys(SEVERITY_OF.values()):
        progress(group.replace("_", " "))
        job = _Group(group, inputs, xs, ys, seed, hidden, epochs)
        which[group] = job.which(sound)
        severity[group] = job.severity(x[~fit], y[~fit])
    guard = None
    if view == "fleet":
        progress("guard")
        d = len(names)
        known = inputs(xs)[:, :d]
        other = np.vstack([inputs(x[~fit]), inputs(sound)])[:, :d]
        guard = train_guard(known, other, names, kind, seed=seed, epochs=epochs)
    return ViewPart(
        names=names, lines=LinePart.of(lines),
        absolute_lines=None if absolute is None else LinePart.of(absolute),
        center=center, spread=spread, which=which, severity=severity, guard=guard,
    )


class _Group:
    """Data and training of the networks of one group of inputs."""

    def __init__(
        self, group: str, inputs: Inputs, x: np.ndarray, y: np.ndarray, seed: int, hidden: int,
        epochs: int,
    ) -> None:
        self._inputs, self._names = inputs, group_inputs(group, inputs.input_names)
        self._columns = inputs.columns(self._names)
        self._output = next(k for k, o in enumerate(OUTPUTS) if SEVERITY_OF[o] == group)
        self._turns = range(3) if group == "short" else range(1)
        self._unit = UNITS[group]
        self._settings = {"hidden": hidden, "seed": seed}
        self._epochs = epochs
        self._x, self._y = self._see(x), self._label(y)

    def _see(self, x: np.ndarray) -> np.ndarray:
        names = self._inputs.names
        return np.vstack([
            self._inputs(rotate(x, names, k))[:, self._columns] for k in self._turns
        ])

    def _label(self, y: np.ndarray) -> np.ndarray:
        return np.concatenate([_turn_labels(y, k)[:, self._output] for k in self._turns])

    def which(self, sound: np.ndarray) -> OutputPart:
        """Return the network that says whether, its threshold set on healthy records."""
        network = fit_classifier(self._x, self._y > 0.0, epochs=self._epochs, **self._settings)
        part = NetworkPart.of(network)
        score = logit(part.build()(self._see(sound))[:, 0])
        threshold = float(f"{tail_quantile(score, FALSE_ALARMS):.6g}")
        return OutputPart(inputs=self._names, network=part, threshold=threshold)

    def severity(self, x: np.ndarray, y: np.ndarray) -> SeverityPart:
        """Return the network that says how much, its intervals set on held-back records."""
        rows = self._y > 0.0
        target = np.arcsinh(self._y[rows] / self._unit)
        network = fit_regressor(
            self._x[rows], target[:, None], epochs=3 * self._epochs, members=3, **self._settings
        )
        part = NetworkPart.of(network)
        truth = self._label(y)
        there = truth > 0.0
        predicted = part.build()(self._see(x)[there])[:, 0]
        error = np.abs(np.arcsinh(truth[there] / self._unit) - predicted)
        edges, widths = bin_widths(predicted, error)
        return SeverityPart(
            inputs=self._names, network=part, unit=self._unit, edges=rounded(np.array(edges)),
            half_width=rounded(np.array(widths)), upper=float(f"{self._y.max():.6g}"),
        )


def _filters(
    names: list[str], healthy: np.ndarray, x: np.ndarray, y: np.ndarray, view: View
) -> tuple[LineFilter, LineFilter | None]:
    """Return the filters of the lines, rounded as they stand in the file."""
    one = (y > 0.0).sum(axis=1) == 1
    rows = [one & (y[:, k] > 0.0) for k in range(3)]
    shorted = np.vstack([rotate(x[r], names, k) for k, r in enumerate(rows)])
    fraction = np.concatenate([y[r, k] for k, r in enumerate(rows)])
    lines = LinePart.of(fit_line_filter(names, healthy, shorted, fraction)).build()
    if view == "fleet":
        return lines, None
    own = [k for k, n in enumerate(names) if n.startswith(ABSOLUTE)]
    bare = [names[k].removeprefix(ABSOLUTE) for k in own]
    found = fit_line_filter(bare, healthy[:, own], shorted[:, own], fraction)
    return lines, LinePart.of(found).build()
