"""The answers of a panel: what is hidden in each unit, drawn before any record is made."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.blind_panel.truth.units import STRATA, HiddenUnit, kit_of
from ema_record.errors import InvalidRecordError


class Panel(NamedTuple):
    """What is declared before it is run."""

    seed: int
    tests: tuple[str, ...]
    """Profile of the measured record, then of those that are held out."""
    counts: Mapping[str, int]
    """Units of each stratum."""

    def rounds(self) -> list[list[tuple[str, int]]]:
        """Return stratum and number of each unit, in rounds: each has all strata in their shares.

        So a panel that is cut short has them, too.
        """
        found: list[list[tuple[str, int]]] = [
            [] for _ in range(max(1, min(self.counts.values(), default=1)))]
        for stratum, count in self.counts.items():
            for k in range(count):
                found[k * len(found) // count].append((stratum, k))
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What is hidden in a unit, and all that it is made from."""

    id: str
    """By which others know it; chosen at random, so that it tells nothing."""
    seed: int
    tests: tuple[str, ...]
    stratum: str
    k: int
    """Number in the stratum."""
    names: tuple[str, ...]
    without: tuple[str, ...]
    truth: dict[str, float | str]
    """Parameters of the catalogue's laws as they are hidden, dotted names."""

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Answer:
        """Return the answer that was sealed as JSON."""
        lists = {name: tuple(data[name]) for name in ("tests", "names", "without")}
        return cls(**{**data, **lists})

    @property
    def kit(self) -> Path | None:
        """Kit of the machine, None for the present one."""
        return kit_of(self.stratum)

    @property
    def accepted(self) -> bool:
        """Whether what is asked is what has changed since the unit was accepted."""
        return "accepted" in self.stratum

    def unit(self) -> HiddenUnit:
        """Return the unit with its records.

        Raises
        ------
        InvalidRecordError
            It is not what was sealed: the code that draws it has changed since.
        """
        made = STRATA[self.stratum](self.seed, self.k, self.tests)
        if (made.names, made.without, made.truth) != (self.names, self.without, self.truth):
            raise InvalidRecordError(f"unit {self.k} of {self.stratum!r} is drawn otherwise than "
                                     "when it was sealed: make a new panel")
        return made


def drawn(panel: Panel, stratum: str, k: int) -> Answer:
    """Return the answer of a unit, without its records."""
    unit = STRATA[stratum](panel.seed, k, ())
    return Answer(id=secrets.token_hex(6), seed=panel.seed, tests=panel.tests, stratum=stratum,
                  k=k, names=unit.names, without=unit.without, truth=unit.truth)
