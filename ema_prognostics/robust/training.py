"""Training of one view of the cascade on a campaign: networks, thresholds, interval widths."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ema_prognostics.model_body import (
    FamilyPart,
    LinePart,
    MemberPart,
    NetworkPart,
    SeverityPart,
    View,
    ViewPart,
    rounded,
)
from ema_prognostics.network import logit
from ema_prognostics.robust.calibration import conformal_quantile, tail_quantile
from ema_prognostics.robust.campaign import Campaign
from ema_prognostics.robust.cascade import Cascade
from ema_prognostics.robust.classes import FAMILIES, OUTPUTS, SEVERITY_OF
from ema_prognostics.robust.guard_training import GuardRecords, train_guard
from ema_prognostics.robust.inputs import Inputs, derive, group_inputs
from ema_prognostics.robust.lines import LineFilter, fit_line_filter
from ema_prognostics.robust.networks import fit_classifier, fit_regressor
from ema_prognostics.robust.vector import ABSOLUTE, difference_names, differences, rotate

UNITS = {"short": 2e-3, "eccentricity": 2e-3, "static_eccentricity": 2e-3,
         "motor_friction": 0.05, "surface_friction": 0.05, "backlash": 3e-5}
"""Severity below which a network's target is linear (of each class)."""
FALSE_ALARMS = {"asymmetry": 0.002, "eccentricity": 0.0005, "motor_friction": 0.001,
                "surface_friction": 0.001, "backlash": 0.0005}
"""Rate of healthy records of which each family may be announced."""
LEAST_ERROR = 0.02
"""Floor of a severity's error, in the network's output."""
DOUBT = 0.004
"""Rate of healthy records that may be called unknown because healthy is improbable."""
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
    campaign: Campaign, healthy: Campaign, strangers: Campaign, kind: str, view: View, *,
    seed: int,
    hidden: int = 16, epochs: int = 60, progress: Callable[[str], None] = lambda _: None,
) -> ViewPart:
    """Return the cascade of one view.

    Parameters
    ----------
    campaign : units with and without faults; one unit in `HELD_BACK` calibrates.
    healthy : other units, healthy only; they set the thresholds.
    strangers : other units, with effects that are no class of ours.
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
    work = _Work(inputs, xs, ys, seed, hidden, epochs)
    families, members = {}, {}
    for name, outputs in FAMILIES.items():
        progress(name)
        families[name] = work.family(name, sound)
        for group in dict.fromkeys(SEVERITY_OF[o] for o in outputs):
            if len(outputs) > 1:
                members[group] = work.member(group, name)
    severity = {}
    for group in dict.fromkeys(SEVERITY_OF.values()):
        progress(f"severity, {group.replace('_', ' ')}")
        severity[group] = work.severity(group, x[~fit], y[~fit])
    progress("guard")
    d = len(names)
    guard = train_guard(
        GuardRecords(*(inputs(rows)[:, :d] for rows in (
            xs, x[~fit], sound, view_inputs(strangers, view)[1]))),
        names, kind, seed=seed, epochs=epochs,
    )
    part = ViewPart(
        names=names, lines=LinePart.of(lines),
        absolute_lines=None if absolute is None else LinePart.of(absolute),
        center=center, spread=spread, families=families, members=members, severity=severity,
        doubt=0.0, guard=guard,
    )
    sure = [f.class_probability["healthy"] for f in Cascade(part).find(sound)]
    doubt = -tail_quantile(-np.array(sure), DOUBT)
    return part.model_copy(update={"doubt": float(np.clip(float(f"{doubt:.6g}"), 0.0, 1.0))})


class _Work:
    """Records that train, and the training of each network on them."""

    def __init__(
        self, inputs: Inputs, x: np.ndarray, y: np.ndarray, seed: int, hidden: int, epochs: int
    ) -> None:
        self._inputs, self._x, self._y = inputs, x, y
        self._settings = {"hidden": hidden, "seed": seed}
        self._epochs = epochs

    def _see(self, group: str, x: np.ndarray) -> np.ndarray:
        """Return the inputs of a group; for the shorts those seen from each phase."""
        columns = self._inputs.columns(group_inputs(group, self._inputs.input_names))
        turns = 3 if group == "short" else 1
        return np.vstack([
            self._inputs(rotate(x, self._inputs.names, k))[:, columns] for k in range(turns)
        ])

    @staticmethod
    def _label(group: str, y: np.ndarray) -> np.ndarray:
        """Return the severity of a group, for the shorts that of each phase."""
        if group == "short":
            return np.concatenate([_turn_labels(y, k)[:, 0] for k in range(3)])
        return y[:, OUTPUTS.index(group)]

    def family(self, name: str, sound: np.ndarray) -> FamilyPart:
        """Return the network that says whether, its threshold set on healthy records."""
        there = self._y[:, [OUTPUTS.index(o) for o in FAMILIES[name]]].max(axis=1) > 0.0
        network = fit_classifier(
            self._see(name, self._x), there, epochs=self._epochs, **self._settings)
        part = NetworkPart.of(network)
        score = logit(part.build()(self._see(name, sound))[:, 0])
        threshold = float(f"{tail_quantile(score, FALSE_ALARMS[name]):.6g}")
        return FamilyPart(inputs=group_inputs(name, self._inputs.input_names), network=part,
                          threshold=threshold)

    def member(self, group: str, family: str) -> MemberPart:
        """Return the network that says which, trained where the family is there."""
        columns = [OUTPUTS.index(o) for o in FAMILIES[family]]
        there = self._y[:, columns].max(axis=1) > 0.0
        x, label = self._see(group, self._x[there]), self._label(group, self._y[there])
        network = fit_classifier(x, label > 0.0, epochs=self._epochs, **self._settings)
        return MemberPart(inputs=group_inputs(group, self._inputs.input_names),
                          network=NetworkPart.of(network))

    def severity(self, group: str, x: np.ndarray, y: np.ndarray) -> SeverityPart:
        """Return the network that says how much, its intervals set on held-back records."""
        unit, label = UNITS[group], self._label(group, self._y)
        rows = label > 0.0
        network = fit_regressor(
            self._see(group, self._x)[rows], np.arcsinh(label[rows] / unit)[:, None],
            epochs=3 * self._epochs, members=3, **self._settings
        )
        part = NetworkPart.of(network)
        error = np.abs(np.arcsinh(label[rows] / unit)
                       - part.build()(self._see(group, self._x)[rows])[:, 0])
        scale = NetworkPart.of(fit_regressor(
            self._see(group, self._x)[rows], np.log(error + LEAST_ERROR)[:, None],
            epochs=self._epochs, members=2, hidden=6, seed=self._settings["seed"], decay=1.0,
        ))
        truth = self._label(group, y)
        there = truth > 0.0
        seen = self._see(group, x)[there]
        error = np.abs(np.arcsinh(truth[there] / unit) - part.build()(seen)[:, 0])
        factor = conformal_quantile(error / np.exp(scale.build()(seen)[:, 0]))
        return SeverityPart(
            inputs=group_inputs(group, self._inputs.input_names), network=part, scale=scale,
            unit=unit, factor=float(f"{factor:.6g}"), upper=float(f"{label.max():.6g}"),
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
