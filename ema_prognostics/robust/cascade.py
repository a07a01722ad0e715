"""The cascade at work on feature vectors: which, how much, and is it of a known kind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_prognostics.robust.conditions import CLASS_OF, OUTPUTS
from ema_prognostics.robust.guard import build_guard
from ema_prognostics.robust.model import SeverityData, ViewData
from ema_prognostics.robust.vector import rotate, squash

SHORTS = OUTPUTS[:3]
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
    probability : ndarray, shape (7,), of the outputs.
    margin : ndarray, shape (7,), logit less threshold.
    guard : ndarray, shape (m,), of each feature checked; above 1: unusual. Empty: no guard.
    """

    outputs: tuple[str, ...]
    severity: tuple[Severity, ...]
    probability: np.ndarray
    margin: np.ndarray
    guard: np.ndarray


def predict_severity(data: SeverityData, u: np.ndarray) -> np.ndarray:
    """Return value, lower and upper bound, shape (n, 3), in the effect's unit."""
    y = data.network.build()(u)[:, 0]
    half = np.array(data.half_width)[np.searchsorted(np.array(data.edges), y)]
    bounds = np.stack([y, y - half, y + half], axis=1)
    return np.clip(data.unit * np.sinh(bounds), 0.0, 2.0 * data.upper)


class Cascade:
    """The networks of one view, built once."""

    def __init__(self, view: ViewData) -> None:
        """Build the networks."""
        self.view = view
        self._center, self._spread = np.array(view.center), np.array(view.spread)
        self._which = view.which.build()
        self._threshold = np.array(view.threshold)
        self.guard = build_guard(view, view.guard) if view.guard is not None else None

    def squash(self, x: np.ndarray) -> np.ndarray:
        """Return the inputs of the networks for features `x`, shape (n, d)."""
        return squash(x, self._center, self._spread)

    def deviations(self, x: np.ndarray) -> np.ndarray:
        """Return `x` in healthy standard deviations, shape (n, d)."""
        return (x - self._center) / self._spread

    def find(self, x: np.ndarray) -> list[Finding]:
        """Return what the cascade says of each row of `x`, shape (n, d)."""
        u = self.squash(x)
        p = self._which(u)
        margin = logit(p) - self._threshold
        guard = self.guard.scores(u) if self.guard is not None else np.empty((len(x), 0))
        turned = [u] + [self.squash(rotate(x, self.view.names, k)) for k in (1, 2)]
        severity = {
            name: np.stack([predict_severity(data, t) for t in turned])
            for name, data in self.view.severity.items()
        }
        found = []
        for row in range(len(x)):
            outputs = announced(p[row], margin[row])
            values = []
            for output in outputs:
                name = "short" if output in SHORTS else output
                phase = SHORTS.index(output) if output in SHORTS else 0
                value, lower, upper = (float(v) for v in severity[name][phase, row])
                values.append(Severity(value=value, lower=lower, upper=upper))
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
