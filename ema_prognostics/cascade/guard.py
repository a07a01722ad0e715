"""The guard: whether a record looks like anything that the networks were trained on.

Faults move some features (the drivers: lines, torques, gap). Given these, all others are
predicted, with their scatter; a record whose others lie elsewhere is of an unknown kind. Judged
are each feature, the features of each part of the physics together, and all together. What an
ideal machine and recorder have none of (errors, scatter, noise, rounding) is judged on the bad
side only: a record better than expected is not suspicious for it.

Strangers, which befall actuators and are no fault of the classes, are told by matched filters on
the inputs. A small shift of many of these is hard to see in the scatter of known records, unless
they are weighted by its inverse covariance (R. A. Fisher, Ann. Eugenics 7 (1936) 179). It is
another one where a fault is found, of which the size is not known, so each kind of stranger has a
filter for each of `KINDS_FOUND`. A filter needs only a mean direction, which few examples give; a
network would have to learn the covariance too. What no direction tells, since its sign or its
phase is part of it, is told by a single input that nothing known moves: `PATTERNS`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ema_prognostics.cascade.classes import (
    KINDS_FOUND,
    TAIL_RATES,
    probability_known,
    tail_probability,
)
from ema_prognostics.cascade.guard_groups import group_columns
from ema_prognostics.cascade.inputs import SURFACE, input_names
from ema_prognostics.cascade.lines import DERIVED, NO_CONSTANTS
from ema_prognostics.cascade.model_body import LimitPart, StrangersPart, ViewPart
from ema_prognostics.features.vector import ABSOLUTE, SWINGS
from ema_prognostics.networks.network import Network

RECORDER = ("noise_speed", "noise_current_least", "position_step", "speed_step")
"""How noisy and how coarse the record is: all else scatters with it."""
ALONE = (*RECORDER, "viscous_share")
"""Drivers that no fault moves, judged each by itself: the recorder, and the grease."""
DRIVERS = (*(f"quarter_even_m{h}_" for h in (1, 2, 3, 4)), "torque_quarter", "gap_torque",
           "gap_width", "load_quarter", "temperature", "bus_voltage", "speed_full",
           "full_even_m1", "full_even_m2", "full_even_m3", *ALONE)
STEP_DRIVERS = (*(f"full_even_m{h}_" for h in (1, 2, 3, 4)), "torque_", "temp", "bus_voltage",
                "speed_full", *RECORDER)
"""Features that faults move, and `ALONE`."""
NOT_CHECKED = ("gap_width_difference", "overshoot", "dry_torque", *SWINGS.values())
"""A unit that swings is no stranger. The peak of the speed depends on what the supply
can still drive at full speed, and grows tenfold where that is little: a low bus, a hot winding.
Inertia and rise time tell the rest. The dry torque is made of other torques."""
FLOOR = 0.02
"""Least scatter, in the squashed unit."""

ABSOLUTE_DRIVERS = tuple(f"{ABSOLUTE}{n}" for n in (
    "temperature", "bus_voltage", "torque_quarter", "torque_full", "gap_width", "gap_torque",
    "load_quarter", "speed_full", *RECORDER))
"""Of the features themselves, beside the differences to a baseline."""
NO_FAULT_MOVES = "winding_unlike"
"""Of the filtered lines and windings the one that is checked: differences of the windings that no
short makes, over the lines that such a fault would have."""
LOG_SIZES = ("sum_rms", "reference_sum", "resistance_spread", "inductance_spread", "rise_spread",
             "gap_error", "winding_error", "inertia_error", "high_", "position_rms", "speed_rms",
             "torque_rms", "noise_", "position_step", "speed_step", "bus_sag")
BETTER_IS_LESS = (
    *LOG_SIZES, NO_FAULT_MOVES, "offset_largest", "gain_largest", "reference_spread")
"""Beginnings of names: sizes of what an ideal machine and recorder have none of; the first are
logarithms."""
LEAST_EXCESS = 1.0
"""Healthy spreads by which such a size exceeds what is expected before it counts, however little
it scattered in training: a sum that was exactly zero there may be nearly so elsewhere."""
MARGIN = 2.0
"""On the limits, where the test is not exactly the one trained on."""
MEASURED = tuple(prefix + n for prefix in ("", ABSOLUTE)
                 for n in ("temperature", "bus_voltage", "load_quarter"))
"""Conditions of the test that no fault makes: two that the aircraft measures, and the load, which
the torque forward less that back tells."""
BEYOND, MOST_BEYOND = 0.5, 1.0
"""Part by which all limits grow a healthy deviation outside the measured conditions that were
seen, where what is expected of the features is but a continuation; and the most of it."""
LEAST_KNOWN = float(probability_known(np.array(TAIL_RATES[-1])))
"""Probability that what the guard lets pass is of a known kind, at least: beyond the least rate
that is tabulated the tail is but a trend, and some limits lie far beyond what was seen."""
BESIDE_OWN = 1.25
"""Bound of the scores without the baseline, where there is one and its guard judges too."""
STRANGER_RATE = 0.004
"""Part of the known records of which a stranger may be said: as many as may be doubtful."""
PATTERNS = {"current_scale": NO_CONSTANTS}
"""Strangers that one input tells: a current whose scale is wrong, where none contradicts it."""
SQUEEZE, GROUP_SQUEEZE = 3.0, 8.0
"""Scaled residual beyond which a single feature adds little to the distance of all, of a group."""


def drivers_of(names: list[str], kind: str) -> list[str]:
    """Return the names of the drivers."""
    if kind == "step":
        own = [n for n in names if n.startswith(STEP_DRIVERS)]
    else:
        own = [n for n in names if n.startswith(DRIVERS) and n not in {
            "torque_quarter_over_ramp", *NOT_CHECKED}]
    return [*own, *(n for n in names if n in ABSOLUTE_DRIVERS)]


def checked_of(names: list[str], kind: str) -> list[str]:
    """Return the names of the inputs that are checked; with a baseline the differences."""
    out = {*drivers_of(names, kind), *NOT_CHECKED, *DERIVED, SURFACE} - {NO_FAULT_MOVES, *ALONE}
    return [n for n in names if n not in out and not n.startswith(ABSOLUTE)]


def signed(names: list[str]) -> np.ndarray:
    """Return which of the checked inputs may be off to either side, bool, shape (m,)."""
    return np.array([not n.startswith(BETTER_IS_LESS) for n in names], dtype=bool)


def squeeze(z: np.ndarray, bound: float = SQUEEZE) -> np.ndarray:
    """Return scaled residuals, bounded so that one alone does not make the distance."""
    return bound * np.tanh(z / bound)


def length(z: np.ndarray, whitening: np.ndarray, bound: float = SQUEEZE) -> np.ndarray:
    """Return the length, shape (n,), of scaled residuals, shape (n, m), squeezed and whitened."""
    return np.linalg.norm(squeeze(z, bound) @ whitening.T, axis=1)


class GroupLimit(NamedTuple):
    """How far features that belong together may be off."""

    columns: np.ndarray
    """Of them among the checked, shape (g,)."""
    whitening: np.ndarray
    """Of their squeezed, scaled residuals, shape (g, g)."""
    distance: float
    """Usual bound of the whitened residuals' length."""


class Limits(NamedTuple):
    """How far a kind of record may be off."""

    limit: np.ndarray
    """Usual bound of |residual| / scatter, shape (m,)."""
    whitening: np.ndarray
    """Of the squeezed, scaled residuals, shape (m, m)."""
    distance: float
    """Usual bound of the whitened residuals' length."""
    tail: np.ndarray
    """Worst scores exceeded at `classes.TAIL_RATES`, shape (8,)."""
    groups: tuple[GroupLimit, ...] = ()
    """Of the features that belong together, in the order of `guard_groups.GROUPS`."""

    def scores(self, z: np.ndarray) -> np.ndarray:
        """Return how far off each feature is, each group, and all together; 1: the limit.

        Shape (n, m + groups + 1), of scaled residuals `z`, shape (n, m).
        """
        groups = [length(z[:, g.columns], g.whitening, GROUP_SQUEEZE) / g.distance
                  for g in self.groups]
        return np.column_stack([np.abs(z) / self.limit, *groups,
                                length(z, self.whitening) / self.distance])

    def known(self, scores: np.ndarray) -> np.ndarray:
        """Return the probability that records with these scores are of a known kind."""
        worst = scores.max(axis=1)
        known = probability_known(tail_probability(worst, self.tail))
        return np.where(worst > 1.0, known, np.maximum(known, LEAST_KNOWN))


@dataclass(frozen=True, slots=True, kw_only=True)
class Guard:
    """The guard at work.

    Attributes
    ----------
    drivers, checked : columns of the inputs.
    signed : which of the checked may be off to either side, bool, shape (m,).
    mean, scale : networks from drivers to the checked features, and to the log of the scatter.
    limits : for records by what is found in them, as `classes.KINDS_FOUND`.
    groups : names of the groups of checked features, of `guard_groups.GROUPS`.
    measured, seen : columns of the measured conditions, shape (c,), and their least and largest
        values in training, shape (c, 2).
    """

    drivers: np.ndarray
    checked: np.ndarray
    signed: np.ndarray
    mean: Network
    scale: Network
    limits: tuple[Limits, ...]
    groups: tuple[str, ...] = ()
    measured: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=int))
    seen: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))

    def residuals(self, u: np.ndarray) -> np.ndarray:
        """Return the scaled residuals, shape (n, m), of squashed inputs, shape (n, d).

        What is exactly a healthy unit's was not measured (`vector.steady`) and is not judged.
        """
        x, checked = u[:, self.drivers], u[:, self.checked]
        z = (checked - self.mean(x)) / (np.exp(self.scale(x)) + FLOOR)
        z = np.where(self.signed, z, np.maximum(z, 0.0)) / self.beyond(u)[:, None]
        return np.where(checked == 0.0, 0.0, z)

    def beyond(self, u: np.ndarray) -> np.ndarray:
        """Return by what the limits grow, shape (n,): 1 within the measured conditions seen."""
        there = u[:, self.measured]
        outside = np.maximum(self.seen[:, 0] - there, there - self.seen[:, 1])
        return 1.0 + np.clip(BEYOND * outside.max(axis=1, initial=0.0), 0.0, MOST_BEYOND)

    def bounded(self, turned: list[np.ndarray]) -> list[np.ndarray]:
        """Return squashed inputs, as seen from each phase, less where limits grow."""
        return [u / self.beyond(u)[:, None] for u in turned]

    def scores(
        self, u: np.ndarray, kind: np.ndarray, *, exact: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return scores, shape (n, m + groups + 1), and the probability of a known kind, (n,).

        Parameters
        ----------
        u : ndarray, shape (n, d). Squashed features.
        kind : ndarray of int, shape (n,). What is found in the record, of `KINDS_FOUND`.
        exact : whether the test is exactly the one trained on; of others only single features
            are judged, by the widest limits and with a margin.
        """
        z = self.residuals(u)
        if not exact:
            widest = np.max([part.limit for part in self.limits], axis=0)
            single = np.abs(z) / (MARGIN * widest)
            rest = np.zeros((len(z), len(self.groups) + 1))
            return np.hstack([single, rest]), np.ones(len(z))
        scores = np.empty((len(z), z.shape[1] + len(self.groups) + 1))
        known = np.empty(len(z))
        for k, part in enumerate(self.limits):
            mine = kind == k
            if mine.any():
                scores[mine] = part.scores(z[mine])
                known[mine] = part.known(scores[mine])
        return scores, known


def limits_of(part: LimitPart, checked: list[str]) -> Limits:
    """Return the limits of a kind of record for the `checked` features."""
    groups = tuple(
        GroupLimit(columns, np.array(part.groups[name].whitening), part.groups[name].distance)
        for name, columns in group_columns(tuple(checked)).items())
    return Limits(np.array(part.limit), np.array(part.whitening), part.distance,
                  np.array(part.tail), groups)


def build_guard(view: ViewPart) -> Guard:
    """Return the guard of a view."""
    names, data = input_names(view.names), view.guard
    return Guard(
        drivers=np.array([names.index(n) for n in data.drivers]),
        checked=np.array([names.index(n) for n in data.checked]),
        signed=signed(data.checked), mean=data.mean.build(), scale=data.scale.build(),
        limits=tuple(limits_of(data.limits[k], data.checked)  # type: ignore[index]
                     for k in KINDS_FOUND),
        groups=tuple(group_columns(tuple(data.checked))),
        measured=np.array([names.index(n) for n in data.seen], dtype=int),
        seen=np.array(list(data.seen.values())).reshape(-1, 2),
    )


class Strange(NamedTuple):
    """What the filters say of records."""

    score: np.ndarray
    """Largest output over its limit, shape (n,); above 1: unusual."""
    kind: tuple[str, ...]
    """Of the filter that it is of."""
    rate: np.ndarray
    """Part of the known records that score as much, shape (n,): by the tail of a normal law."""


class StrangerFilters:
    """The filters at work."""

    def __init__(self, part: StrangersPart) -> None:
        self._kinds = tuple(part.filters)
        self._weights = np.array([one.weights for one in part.filters.values()])
        self._turned = np.array([one.turns == 3 for one in part.filters.values()])
        self._alone = np.array([name in PATTERNS for name in part.filters])
        self._both = np.array([one.both for one in part.filters.values()])
        self._limits = np.array([one.limits for one in part.filters.values()])

    def outputs(self, turned: list[np.ndarray], found: int) -> np.ndarray:
        """Return the size of each filter's output, shape (n, kinds), from any phase.

        Parameters
        ----------
        turned : of ndarray, shape (n, d). Squashed inputs as seen from each phase.
        found : in the records, of `KINDS_FOUND`.
        """
        output = np.array([z @ self._weights[:, found].T for z in turned])
        output[..., self._alone] = np.sinh(output[..., self._alone])  # one input, in deviations
        size = np.where(self._both, np.abs(output), np.maximum(output, 0.0))
        return np.where(self._turned, size.max(axis=0), size[0])

    def __call__(self, turned: list[np.ndarray], kind: np.ndarray) -> Strange:
        """Return what is said of records.

        Parameters
        ----------
        turned : as in `outputs`.
        kind : ndarray of int, shape (n,). What is found in each, of `KINDS_FOUND`.
        """
        ratio = np.empty((len(kind), len(self._kinds)))
        for k in set(kind.tolist()):
            mine = kind == k
            ratio[mine] = self.outputs([z[mine] for z in turned], k) / self._limits[:, k]
        best = ratio.argmax(axis=1)
        score = ratio[np.arange(len(ratio)), best]
        return Strange(score, tuple(self._kinds[k] for k in best), STRANGER_RATE ** (score**2))
