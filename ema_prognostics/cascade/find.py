"""The cascade at work on feature vectors: which, how much, and is it of a known kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ema_prognostics.cascade.classes import (
    CLASS_OF,
    FAMILIES,
    FAULTS,
    OUTPUTS,
    SEVERITY_OF,
    SHORTS,
    kind_found,
    probability_known,
)
from ema_prognostics.cascade.guard import Strange, StrangerFilters, build_guard
from ema_prognostics.cascade.inputs import Inputs
from ema_prognostics.cascade.model_body import MemberPart, SeverityPart, ViewPart
from ema_prognostics.features.vector import rotate
from ema_prognostics.networks.network import logit, logsig
from ema_record.errors import ModelError

MAX_FAULTS = 2
LEAST_SEVERITY = 1e-9
"""Of a fault that is announced."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Severity:
    """How much, with its 90 % interval, in the effect's unit."""

    value: float
    lower: float
    upper: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """What the cascade says of one record.

    Attributes
    ----------
    outputs : outputs announced, most certain first, at most two, of different classes.
    severity : of each of them.
    probability : ndarray, shape (8,), of the outputs.
    margin : ndarray, shape (5,), logit of each family less its threshold.
    guard : ndarray, shape (m + groups + 1,), of each feature checked, of each group of them,
        of all together; above 1: unusual.
    stranger : how much something is there that is no fault of a family, but known to befall
        actuators, over the usual limit; above 1: unusual.
    stranger_kind : what it is most like.
    known : probability that the record is of a kind that the networks know.
    doubtful : nothing is announced, but healthy is too improbable to be said, or a fault is
        seen that is smaller than those announced.
    """

    outputs: tuple[str, ...]
    severity: tuple[Severity, ...]
    probability: np.ndarray
    margin: np.ndarray
    guard: np.ndarray
    stranger: float
    stranger_kind: str
    known: float
    doubtful: bool

    def unusual(self, bound: float = 1.0, *, stranger: bool = True) -> bool:
        """Whether the record is unlike those with and without the faults that are named.

        Parameters
        ----------
        bound : of the guard's scores.
        stranger : whether the odds of a stranger count.
        """
        return bool(self.guard.max() > bound or (stranger and self.stranger > 1.0))

    @property
    def healthy(self) -> float:
        """Probability that no class is there, if the record is of a known kind."""
        return float(np.prod([1.0 - p for p in self._classes.values()]))

    @property
    def class_probability(self) -> dict[str, float]:
        """Probability that each class is there; ``healthy``: that none; ``unknown``: another."""
        found = {"healthy": self.healthy, **self._classes}
        return {**{name: self.known * p for name, p in found.items()},
                "unknown": 1.0 - self.known}

    @property
    def _classes(self) -> dict[str, float]:
        found = dict.fromkeys(FAULTS, 0.0)
        for name, p in zip(OUTPUTS, self.probability):
            found[CLASS_OF[name]] = max(found[CLASS_OF[name]], float(p))
        return found


def classifier(part: MemberPart, inputs: Inputs) -> Callable[[np.ndarray], np.ndarray]:
    """Return what gives the probability, shape (n,), for all inputs, shape (n, inputs)."""
    network, columns = part.network.build(), inputs.columns(part.inputs)
    return lambda u: network(u[:, columns])[:, 0]


class SeverityNetwork:
    """How much, with an interval: one network at work."""

    def __init__(self, part: SeverityPart, inputs: Inputs) -> None:
        self._network, self._columns = part.network.build(), inputs.columns(part.inputs)
        self._scale, self._noise = part.scale.build(), inputs.noise
        self._factors = np.array(part.knots), np.array(part.factors)
        self._noise_factors = np.array(part.noise_knots), np.array(part.noise_factors)
        self._company, self._unit, self._upper = part.company, part.unit, part.upper
        self.least = part.least

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """Return how much, in the effect's unit, alone and beside another fault.

        Shape (n, 2, 3): value, lower and upper bound; the value is the same.
        """
        x = u[:, self._columns]
        y = self._network(x)[:, 0]
        error = np.exp(np.clip(self._scale(x)[:, 0], -12.0, 3.0))
        factor = np.interp(y, *self._factors) * np.interp(self._noise(u), *self._noise_factors)
        half = np.outer(factor * error, [1.0, self._company])
        y = np.column_stack([y, y])
        bounds = np.stack([y, y - half, y + half], axis=2)
        return np.clip(self._unit * np.sinh(bounds), 0.0, 2.0 * self._upper)


class Cascade:
    """The networks of one view, built once."""

    def __init__(self, view: ViewPart) -> None:
        """Build the networks; ValueError if a part is missing."""
        needed = set(SEVERITY_OF.values())
        named = {SEVERITY_OF[o] for f in FAMILIES.values() if len(f) > 1 for o in f}
        if (set(view.severity), set(view.members), set(view.families)) != (
                needed, named, set(FAMILIES)):
            raise ValueError("a network of the cascade is missing or foreign")
        self.view = view
        self.inputs = Inputs(
            view.names, view.lines.build(),
            None if view.absolute_lines is None else view.absolute_lines.build(),
            np.array(view.center), np.array(view.spread),
        )
        self._families = {n: classifier(part, self.inputs) for n, part in view.families.items()}
        self._threshold = np.array([view.families[n].threshold for n in FAMILIES])
        self._members = {n: classifier(part, self.inputs) for n, part in view.members.items()}
        self._severity = {
            n: SeverityNetwork(part, self.inputs) for n, part in view.severity.items()
        }
        self.guard = build_guard(view)
        self._strangers = (
            None if view.strangers is None else StrangerFilters(view.strangers))

    @np.errstate(over="ignore", divide="ignore", invalid="ignore")  # NaN is refused below
    def find(self, x: np.ndarray, *, exact: bool = True) -> list[Detection]:
        """Return what the cascade says of each row of features `x`, shape (n, d).

        Parameters
        ----------
        x : features.
        exact : whether the test is exactly the one trained on; of others of its kind (step of
            another size, other sample rate) the guard judges less strictly.
        """
        turned = [self.inputs(rotate(x, self.view.names, k)) for k in range(3)]
        u = turned[0]
        said = logit(np.column_stack([self._families[n](u) for n in FAMILIES]))
        margin = said - self._threshold
        family = np.column_stack([
            logsig(meant(one, self.view.families[n].knots, self.view.families[n].logits))
            for n, one in zip(FAMILIES, said.T)])
        p = self._probabilities(turned, family)
        severity = {
            output: self._severity[SEVERITY_OF[output]](turned[k] if output in SHORTS else u)
            for k, output in enumerate(OUTPUTS)
        }
        size = np.column_stack([severity[o][:, 0, 0] for o in OUTPUTS])
        outputs_of = [announced(*row) for row in zip(p, self._announceable(margin, p, size))]
        present = np.array([[o in outputs for o in OUTPUTS] for outputs in outputs_of])
        kind = kind_found(np.where(present, np.maximum(size, LEAST_SEVERITY), 0.0))
        guard, known = self.guard.scores(u, kind, exact=exact)
        strange = Strange(np.zeros(len(x)), ("",) * len(x), np.ones(len(x)))
        if self._strangers is not None and exact:
            strange = self._strangers(self.guard.bounded(turned), kind)
            known = np.minimum(known, probability_known(strange.rate))
        said_all = (margin, p, guard, known, strange.score, *severity.values())
        if not np.isfinite(u).all() or any(np.isnan(part).any() for part in said_all):
            raise ModelError("the networks give no number for a record, expected finite ones: the "
                             "model was changed or its scales are too small, train again")
        found = []
        for row, outputs in enumerate(outputs_of):
            company = int(len(outputs) > 1)
            values = [Severity(value=float(v), lower=float(low), upper=float(high))
                      for v, low, high in (severity[o][row, company] for o in outputs)]
            one = Detection(
                outputs=outputs, severity=tuple(values), probability=p[row], margin=margin[row],
                guard=guard[row], stranger=float(strange.score[row]),
                stranger_kind=strange.kind[row], known=float(known[row]),
                doubtful=False,
            )
            seen = bool((margin[row] > 0.0).any()) or one.healthy < self.view.doubt
            found.append(replace(one, doubtful=seen and not outputs))
        return found

    def _announceable(self, margin: np.ndarray, p: np.ndarray, size: np.ndarray) -> np.ndarray:
        """Return the margins, shape (n, 5), -inf where the severity is too small to be told."""
        enough = size >= [self._severity[SEVERITY_OF[o]].least for o in OUTPUTS]
        found = np.empty_like(margin)
        for k, outputs in enumerate(FAMILIES.values()):
            columns = np.array([OUTPUTS.index(o) for o in outputs])
            named = columns[p[:, columns].argmax(axis=1)]
            found[:, k] = np.where(enough[np.arange(len(p)), named], margin[:, k], -np.inf)
        return found

    def _probabilities(self, turned: list[np.ndarray], family: np.ndarray) -> np.ndarray:
        """Return the probability of each output, shape (n, 8): of its family, shared out."""
        p = np.empty((len(family), len(OUTPUTS)))
        for k, outputs in enumerate(FAMILIES.values()):
            share = np.ones((len(family), len(outputs)))
            if len(outputs) > 1:
                for m, output in enumerate(outputs):
                    seen = turned[SHORTS.index(output)] if output in SHORTS else turned[0]
                    share[:, m] = self._members[SEVERITY_OF[output]](seen) + 1e-9
                share /= share.sum(axis=1, keepdims=True)
            for m, output in enumerate(outputs):
                p[:, OUTPUTS.index(output)] = family[:, k] * share[:, m]
        return p


def meant(said: np.ndarray, knots: Sequence[float], logits: Sequence[float]) -> np.ndarray:
    """Return logits as they were borne out, shape (n,): linear between, parallel beyond."""
    inside = np.clip(said, knots[0], knots[-1])
    return np.asarray(np.interp(inside, knots, logits) + said - inside)


def announced(probability: np.ndarray, margin: np.ndarray) -> tuple[str, ...]:
    """Return the outputs that are announced, most certain first.

    Of each family above its threshold the most probable output is named. The first is that of
    the most probable family; a second one must be more likely there than not, and of another
    class.

    Parameters
    ----------
    probability : ndarray, shape (8,). Of the outputs.
    margin : ndarray, shape (5,). Of the families.
    """
    found = []
    for name, above in zip(FAMILIES, margin):
        if above > 0.0:
            outputs = FAMILIES[name]
            p = [float(probability[OUTPUTS.index(o)]) for o in outputs]
            found.append((sum(p), outputs[int(np.argmax(p))]))
    chosen: list[str] = []
    for p_family, output in sorted(found, reverse=True):
        new = CLASS_OF[output] not in {CLASS_OF[c] for c in chosen}
        if new and (not chosen or p_family > 0.5) and len(chosen) < MAX_FAULTS:
            chosen.append(output)
    return tuple(chosen)
