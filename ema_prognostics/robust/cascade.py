"""The cascade at work on feature vectors: which, how much, and is it of a known kind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_prognostics.model_body import OutputPart, SeverityPart, ViewPart
from ema_prognostics.robust.classes import CLASS_OF, OUTPUTS, SEVERITY_OF, SHORTS
from ema_prognostics.robust.guard import build_guard
from ema_prognostics.robust.inputs import Inputs
from ema_prognostics.robust.vector import rotate

MAX_FAULTS = 2


def logit(p: np.ndarray) -> np.ndarray:
    """Return log(p / (1 − p)), bounded."""
    p = np.clip(p, 1e-12, 1.0 - 1e-12)
    return np.log(p / (1.0 - p))


@dataclass(frozen=True, slots=True, kw_only=True)
class Severity:
    """How much, with its 90 % interval, in the effect's unit."""

    value: float
    lower: float
    upper: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What the cascade says of one record.

    Attributes
    ----------
    outputs : outputs announced, most certain first, at most two, of different classes.
    severity : of each of them.
    probability : ndarray, shape (8,), of the outputs.
    margin : ndarray, shape (8,), logit less threshold.
    guard : ndarray, shape (m,), of each feature checked; above 1: unusual. Empty: no guard.
    """

    outputs: tuple[str, ...]
    severity: tuple[Severity, ...]
    probability: np.ndarray
    margin: np.ndarray
    guard: np.ndarray


class OutputNetwork:
    """Which: one network at work."""

    def __init__(self, part: OutputPart, inputs: Inputs) -> None:
        """Build the network."""
        self._network, self._threshold = part.network.build(), part.threshold
        self._columns = inputs.columns(part.inputs)

    def __call__(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return probability, and logit less threshold, each (n,), for all inputs `u`."""
        p = self._network(u[:, self._columns])[:, 0]
        return p, logit(p) - self._threshold


class SeverityNetwork:
    """How much, with an interval: one network at work."""

    def __init__(self, part: SeverityPart, inputs: Inputs) -> None:
        """Build the network."""
        self._network, self._columns = part.network.build(), inputs.columns(part.inputs)
        self._unit, self._upper = part.unit, part.upper
        self._edges, self._half_width = np.array(part.edges), np.array(part.half_width)

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """Return value, lower and upper bound, shape (n, 3), in the effect's unit."""
        y = self._network(u[:, self._columns])[:, 0]
        half = self._half_width[np.searchsorted(self._edges, y)]
        bounds = np.stack([y, y - half, y + half], axis=1)
        return np.clip(self._unit * np.sinh(bounds), 0.0, 2.0 * self._upper)


class Cascade:
    """The networks of one view, built once."""

    def __init__(self, view: ViewPart) -> None:
        """Build the networks; ValueError if a part is missing."""
        needed = set(SEVERITY_OF.values())
        if set(view.severity) != needed or set(view.which) != needed:
            raise ValueError("a network of the cascade is missing or foreign")
        self.view = view
        self.inputs = Inputs(
            view.names, view.lines.build(),
            None if view.absolute_lines is None else view.absolute_lines.build(),
            np.array(view.center), np.array(view.spread),
        )
        self._which = {n: OutputNetwork(part, self.inputs) for n, part in view.which.items()}
        self._severity = {
            n: SeverityNetwork(part, self.inputs) for n, part in view.severity.items()
        }
        self.guard = build_guard(view, view.guard) if view.guard is not None else None

    def find(self, x: np.ndarray) -> list[Finding]:
        """Return what the cascade says of each row of features `x`, shape (n, d)."""
        turned = [self.inputs(rotate(x, self.view.names, k)) for k in range(3)]
        u = turned[0]
        p, margin = np.empty((len(x), len(OUTPUTS))), np.empty((len(x), len(OUTPUTS)))
        for k, output in enumerate(OUTPUTS):
            seen = turned[k] if output in SHORTS else u
            p[:, k], margin[:, k] = self._which[SEVERITY_OF[output]](seen)
        guard = self.guard.scores(u) if self.guard is not None else np.empty((len(x), 0))
        severity = {
            output: self._severity[SEVERITY_OF[output]](turned[k] if output in SHORTS else u)
            for k, output in enumerate(OUTPUTS)
        }
        found = []
        for row in range(len(x)):
            outputs = announced(p[row], margin[row])
            values = [Severity(value=float(v), lower=float(low), upper=float(high))
                      for v, low, high in (severity[o][row] for o in outputs)]
            found.append(Finding(
                outputs=outputs, severity=tuple(values), probability=p[row], margin=margin[row],
                guard=guard[row],
            ))
        return found


def announced(probability: np.ndarray, margin: np.ndarray) -> tuple[str, ...]:
    """Return the outputs that are announced, most certain first.

    The first is the most probable of those above their threshold; a second one must be more
    likely than not, and of another class.
    """
    above = [k for k in np.argsort(-margin) if margin[k] > 0.0]
    above.sort(key=lambda k: -probability[k])
    chosen: list[str] = []
    for k in above:
        new = CLASS_OF[OUTPUTS[k]] not in {CLASS_OF[c] for c in chosen}
        if new and (not chosen or probability[k] > 0.5) and len(chosen) < MAX_FAULTS:
            chosen.append(OUTPUTS[k])
    return tuple(chosen)
