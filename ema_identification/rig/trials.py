"""What a step of the search tried, and what it chose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_identification.rig.laws import Term

TWICE = 2.0
"""Times the residual of one law that another may leave and still do instead of it."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One law that was tried in addition to a balance."""

    term: Term
    name: str
    companion: Term | None
    """A law that sharpens this one, tried and taken together with it."""
    p_value: float
    """After all looks of the step."""
    squares: np.ndarray
    """Held-out sum of squares of each block with it, shape (blocks,)."""
    rows: int
    gain: float
    """Share of the held-out squares that it takes."""
    significant: bool

    @property
    def complexity(self) -> int:
        """Number of free parameters."""
        own = self.term.law.complexity
        return own if self.companion is None else own + self.companion.law.complexity

    @property
    def score(self) -> float:
        """Held-out residual with it, rms."""
        return float(np.sqrt(self.squares.sum() / self.rows))


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What one step chose, and what it compared."""

    trial: Trial
    equivalent: tuple[str, ...]
    trials: tuple[Trial, ...]
    """All that were held out, best first."""
    contested: bool = False
    """Whether a law that filters the motion took more, and had to wait."""


def standard_error(differences: np.ndarray) -> float:
    """Return the standard error of a sum over blocks, of their differences, shape (blocks,)."""
    return float(np.sqrt(len(differences)) * np.std(differences, ddof=1))
