"""Counts with exact 95 % bounds (Clopper and Pearson)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from scipy.stats import beta


@dataclass(frozen=True, slots=True)
class Rate:
    """`hits` of `count`."""

    hits: int
    count: int

    @property
    def bounds(self) -> tuple[float, float]:
        """Two-sided 95 % bounds."""
        k, n = self.hits, self.count
        low = 0.0 if k == 0 else float(beta.ppf(0.025, k, n - k + 1))
        high = 1.0 if k == n else float(beta.ppf(0.975, k + 1, n - k))
        return low, high

    def __str__(self) -> str:
        """Return share, bounds and counts."""
        if self.count == 0:
            return "–"
        low, high = self.bounds
        share = 100.0 * self.hits / self.count
        return f"{share:.0f} % [{100 * low:.0f}, {100 * high:.0f}] {self.hits}/{self.count}"


def rate(outcomes: Iterable[bool | None]) -> Rate:
    """Return the rate of true ones; None does not count."""
    counted = [outcome for outcome in outcomes if outcome is not None]
    return Rate(sum(counted), len(counted))
