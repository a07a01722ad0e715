"""Training of one view of the cascade on a campaign: networks, thresholds, interval widths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ema_prognostics.cascade.classes import FAMILIES, FAMILY_OF, OUTPUTS, SEVERITY_OF, kind_found
from ema_prognostics.cascade.find import Cascade
from ema_prognostics.cascade.guard import LOG_SIZES, build_guard
from ema_prognostics.cascade.inputs import ITSELF, Inputs, derive, group_inputs, input_names
from ema_prognostics.cascade.lines import LineFilter, fit_line_filter
from ema_prognostics.cascade.model_body import (
    FamilyPart,
    LinePart,
    MemberPart,
    NetworkPart,
    SeverityPart,
    View,
    ViewPart,
    rounded,
)
from ema_prognostics.features.vector import (
    ABSOLUTE,
    difference_names,
    differences,
    rotate,
    start_allowed,
    steady,
)
from ema_prognostics.networks.fitting import MEMBERS, as_classifier, fit_classifier, fit_regressor
from ema_prognostics.networks.network import Network, logit
from ema_prognostics.training.calibration import borne_out, tail_quantile
from ema_prognostics.training.fleet import FleetFeatures
from ema_prognostics.training.guard_training import GuardRecords, train_guard
from ema_prognostics.training.severity_training import train_severity
from ema_prognostics.training.stranger_training import train_strangers

FRICTIONS = ("motor_friction", "surface_friction")
"""Families that are found by how large a quantity is, in the order of `FleetFeatures.friction`."""
FALSE_ALARMS: dict[View, dict[str, float]] = {
    "fleet": {"asymmetry": 0.004, "eccentricity": 0.001, "motor_friction": 0.0005,
              "surface_friction": 0.0005, "backlash": 0.0002},
    "baseline": {"asymmetry": 0.002, "eccentricity": 0.0015, "motor_friction": 0.0002,
                 "surface_friction": 0.0002, "backlash": 0.0002},
}
"""Rate of healthy records of which each family may be announced: most to those that need it."""
STEP_FALSE_ALARMS = {"asymmetry": 0.002, "eccentricity": 0.0003, "motor_friction": 0.0007,
                     "surface_friction": 0.0007, "backlash": 0.0002}
"""The same of a single step, in either view."""
DOUBT = 0.004
"""Rate of healthy records that may be called unknown because healthy is improbable; no more than
of all families together may be announced."""
LEAST_SPREAD, LEAST_SIZE_SPREAD = 1e-3, 0.25
"""Floor of a feature's spread, in its own unit; of sizes that are logarithms."""
HELD_BACK = 5
"""One unit in this many calibrates instead of training."""


def view_inputs(campaign: FleetFeatures, view: View) -> tuple[list[str], np.ndarray]:
    """Return the names and the features of a view, shape (n, d)."""
    names = list(campaign.names)
    record = start_allowed(campaign.record, names)
    if view == "fleet":
        return names, record
    return difference_names(names), differences(record, start_allowed(campaign.baseline, names))


def sound_rows(healthy: FleetFeatures, view: View) -> np.ndarray:
    """Return the features of healthy tests as a view sees them, each record in either part.

    Shape (2 n, d): with a baseline either of two healthy records may be it.
    """
    names, rows = view_inputs(healthy, view)
    if view == "fleet":
        return np.vstack([rows, start_allowed(healthy.baseline, names)])
    swapped = replace(healthy, baseline=healthy.record, record=healthy.baseline)
    return np.vstack([rows, view_inputs(swapped, view)[1]])


def stricter(part: ViewPart, kind: str, view: View, sound: np.ndarray, alarms: float = 1.0
             ) -> ViewPart:
    """Return a view whose families are announced on half as many of the healthy `sound` rows.

    Half the rates of `rates_of`; no threshold falls.
    """
    margin = np.array([found.margin for found in Cascade(part).find(sound)])
    families = {}
    for k, (name, family) in enumerate(part.families.items()):
        more = tail_quantile(margin[:, k], 0.5 * rates_of(kind, view, alarms)[name])
        families[name] = family.model_copy(update={
            "threshold": float(f"{family.threshold + max(more, 0.0):.6g}")})
    return part.model_copy(update={"families": families})


def rates_of(kind: str, view: View, most: float) -> dict[str, float]:
    """Return the rate of healthy records of which each family may be announced, at most `most`."""
    rates = STEP_FALSE_ALARMS if kind == "step" else FALSE_ALARMS[view]
    return {name: min(rate, most) for name, rate in rates.items()}


def train_view(
    campaign: FleetFeatures, healthy: FleetFeatures, kind: str, view: View, *, seed: int,
    hidden: int, iterations: int, strangers: FleetFeatures | None = None,
    alarms: float = 1.0, progress: Callable[[str], None] = lambda _: None,
) -> ViewPart:
    """Return the cascade of one view.

    Parameters
    ----------
    campaign : units with and without faults; one unit in `HELD_BACK` calibrates.
    healthy : other units, healthy only; they set the thresholds.
    kind : of the test.
    view : with or without baseline.
    seed : of the networks' weights.
    hidden, iterations : size of a member of the networks; most steps of the optimiser.
    strangers : other units, each with one; None: only the guard tells them.
    alarms : most of `FALSE_ALARMS` that there may be of any family.
    progress : called with what begins.
    """
    names, x = view_inputs(campaign, view)
    y = campaign.severity
    fit = campaign.unit % HELD_BACK != 0
    sound = sound_rows(healthy, view)
    reference = x[fit & (y == 0.0).all(axis=1)]
    # The acceptance record of a unit stands for all of its tests: once, with their weight.
    _, first, tests = np.unique(campaign.unit[fit], return_index=True, return_counts=True)
    accepted = start_allowed(campaign.baseline[fit][first], list(campaign.names))
    extra, itself = np.empty((0, x.shape[1])), np.empty((0, x.shape[1]))
    own, weight = None, np.ones(np.count_nonzero(fit))
    if view == "fleet":  # every acceptance record is a healthy one
        extra = accepted
        own = np.vstack([campaign.friction[fit], campaign.friction[fit][first]])
        weight = np.concatenate([weight, tests])
        reference = np.vstack([reference, extra])
    else:
        itself = differences(accepted, accepted)
        own = np.zeros((len(x[fit]), len(FRICTIONS))) if kind == "step" else None
    reference = steady(names, reference, np.median(reference, axis=0))
    lines, absolute = _filters(names, reference, x[fit], y[fit], view)
    raw = derive(names, reference, lines, absolute)
    least = np.where([n.removeprefix(ABSOLUTE).startswith(LOG_SIZES) for n in input_names(names)],
                     LEAST_SIZE_SPREAD, LEAST_SPREAD)
    center, spread = rounded(np.median(raw, axis=0)), rounded(
        np.maximum(raw.std(axis=0), least))
    inputs = Inputs(names, lines, absolute, np.array(center), np.array(spread))
    xs = np.vstack([x[fit], extra])
    ys = np.vstack([y[fit], np.zeros((len(extra), y.shape[1]))])
    rates = rates_of(kind, view, alarms)
    work = _Work(inputs, xs, ys, weight, itself, tests[:len(itself)].astype(float), own, kind,
                 view, rates, {"hidden": hidden, "seed": seed, "iterations": iterations})
    parts = campaign.unit % HELD_BACK
    families, members = {}, {}
    for name, outputs in FAMILIES.items():
        progress(name)
        families[name] = work.family(name, sound, int(fit.sum()))
        for group in dict.fromkeys(SEVERITY_OF[o] for o in outputs):
            if len(outputs) > 1:
                members[group] = work.member(group, name)
    severity = {}
    for group in dict.fromkeys(SEVERITY_OF.values()):
        progress(f"severity, {group.replace('_', ' ')}")
        severity[group] = work.severity(group, x, y, parts, families)
    progress("guard")
    guard = train_guard(
        GuardRecords(known=inputs(xs), known_kind=kind_found(ys), weight=weight,
                     other=inputs(x[~fit]), kind=kind_found(y[~fit]), healthy=inputs(sound)),
        inputs.input_names, kind, seed=seed, iterations=iterations,
    )
    progress("strangers")
    part = ViewPart(
        names=names, lines=LinePart.of(lines),
        absolute_lines=None if absolute is None else LinePart.of(absolute),
        center=center, spread=spread, families=families, members=members, severity=severity,
        doubt=0.0, guard=guard,
    )
    judge = build_guard(part)
    strange = None if strangers is None else train_strangers(
        inputs.input_names,
        lambda rows: judge.bounded([inputs(rotate(rows, names, k)) for k in range(3)]),
        xs, kind_found(ys), view_inputs(strangers, view)[1],
        [s for s in strangers.strangers if s is not None], sound, x[~fit], kind_found(y[~fit]))
    part = part.model_copy(update={"strangers": strange})
    sure = [f.healthy for f in Cascade(part).find(sound)]
    doubt = -tail_quantile(-np.array(sure), min(DOUBT, sum(rates.values())))
    return part.model_copy(update={"doubt": float(np.clip(float(f"{doubt:.6g}"), 0.0, 1.0))})


class _Work(NamedTuple):
    """Records that train, and the training of each network on them."""

    inputs: Inputs
    x: np.ndarray
    """Features, shape (n, d)."""
    y: np.ndarray
    """Severities, shape (n, 8)."""
    weight: np.ndarray
    """Shape (n,)."""
    itself: np.ndarray
    """Healthy records for the groups that see the record itself, shape (m, d)."""
    itself_weight: np.ndarray
    """Shape (m,)."""
    own: np.ndarray | None
    """Log of the units' own friction, shape (n, 2), zero with a baseline; None: not regressed."""
    kind: str
    view: View
    rates: dict[str, float]
    settings: dict[str, Any]
    """Hidden neurons, seed and most steps of the networks."""

    def _see(self, group: str, x: np.ndarray, *, size: bool = False) -> np.ndarray:
        """Return the inputs of a group; for the shorts those seen from each phase."""
        columns = self.inputs.columns(group_inputs(group, self.inputs.input_names, size=size))
        turns = 3 if group == "short" else 1
        return np.vstack([self.inputs(rotate(x, self.inputs.names, k))[:, columns]
                          for k in range(turns)])

    def _announced(
        self, group: str, x: np.ndarray, families: dict[str, FamilyPart]
    ) -> np.ndarray:
        """Return where the family of a group is announced; for the shorts from each phase."""
        name = next(FAMILY_OF[o] for o in OUTPUTS if SEVERITY_OF[o] == group)
        part = families[name]
        found = logit(part.network.build()(self._see(name, x))[:, 0]) > part.threshold
        return np.tile(found, 3) if group == "short" else found

    @staticmethod
    def _label(group: str, y: np.ndarray) -> np.ndarray:
        """Return the severity of a group, for the shorts that of each phase."""
        if group == "short":
            return y[:, :3].T.ravel()
        return y[:, OUTPUTS.index(group)]

    def family(self, name: str, sound: np.ndarray, tests: int) -> FamilyPart:
        """Return the network that says whether, its threshold set on healthy records.

        The first `tests` records are no acceptance records.
        """
        x, weight = self.x, self.weight
        if name in ITSELF:
            x = np.vstack([x, self.itself])
            weight = np.concatenate([weight, self.itself_weight])
        there = np.zeros(len(x), dtype=bool)
        there[:len(self.y)] = self.y[:, [OUTPUTS.index(o) for o in FAMILIES[name]]].any(axis=1)
        if name in FRICTIONS and self.own is not None:
            network = self._friction(self.own[:, FRICTIONS.index(name)], name, there)
            # One logistic curve is not how probable: within what units differ by nearly none is
            # an increase, beyond it all are.
            curve = borne_out(logit(network(self._see(name, x[:tests]))[:, 0]), there[:tests])
        else:
            curve = np.zeros(1), np.zeros(1)
            network = fit_classifier(self._see(name, x), there, weight=weight, **self.settings)
        part = NetworkPart.of(network)
        score = logit(part.build()(self._see(name, sound))[:, 0])
        threshold = float(f"{tail_quantile(score, self.rates[name]):.6g}")
        return FamilyPart(inputs=group_inputs(name, self.inputs.input_names), network=part,
                          threshold=threshold, knots=rounded(curve[0]), logits=rounded(curve[1]))

    def _friction(self, own: np.ndarray, name: str, there: np.ndarray) -> Network:
        """Return a network for the probability that a friction has grown.

        It is taught the friction itself, the unit's `own` and the increase together, which
        every record tells of; how probable an increase is at that friction is one logistic
        curve. With a baseline the unit's own falls out: at three speeds a classifier finds less
        than 1 %, at one a small increase is like none, and only its size teaches.
        """
        total = own + np.log1p(self.y[:, OUTPUTS.index(name)])
        x = self._see(name, self.x)
        network = fit_regressor(x, total[:, None], members=MEMBERS, weight=self.weight,
                                **self.settings)
        return as_classifier(network, network(x)[:, 0], there, self.weight)

    def member(self, group: str, family: str) -> MemberPart:
        """Return the network that says which, trained where the family is there."""
        columns = [OUTPUTS.index(o) for o in FAMILIES[family]]
        there = self.y[:, columns].max(axis=1) > 0.0
        x, label = self._see(group, self.x[there]), self._label(group, self.y[there])
        network = fit_classifier(x, label > 0.0, **self.settings)
        return MemberPart(inputs=group_inputs(group, self.inputs.input_names),
                          network=NetworkPart.of(network))

    def severity(
        self, group: str, x: np.ndarray, y: np.ndarray, part: np.ndarray,
        families: dict[str, FamilyPart],
    ) -> SeverityPart:
        """Return the network that says how much, see `train_severity`.

        Parameters
        ----------
        group : of outputs.
        x, y : features and severities of all records, those held back too.
        part : ndarray of int, shape (n,). Part of the units; 0: held back.
        families : networks that say whether, of this view.
        """
        label = self._label(group, y)
        there = label > 0.0
        turns = 3 if group == "short" else 1
        parts, alone = np.tile(part, turns), np.tile((y > 0.0).sum(axis=1) == 1, turns)
        noise = np.tile(self.inputs.noise(self.inputs(x)), turns)
        return train_severity(
            group, self.view, self._see(group, x, size=True)[there], label[there],
            parts[there], self._announced(group, x, families)[there], alone[there],
            noise[there], group_inputs(group, self.inputs.input_names, size=True),
            kind=self.kind, **self.settings)


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
