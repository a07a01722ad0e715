"""What a rule finds, and what a rule is."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

if TYPE_CHECKING:
    from ema_record.checks.facts import BagFacts

Level = Literal["error", "warning"]


class Hit(NamedTuple):
    """One place where a rule is broken."""

    message: str
    time: float | None = None
    """Since the acceptance of the command (s); None: the whole record."""
    size: float | None = None
    unit: str = ""
    channel: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One defect of a recording."""

    rule: str
    level: Level
    message: str
    time: float | None
    """Since the acceptance of the command (s); None: the whole record."""
    size: float | None
    unit: str
    """Of `size`."""
    channel: str
    """Channel or topic, empty where it is none."""
    remedy: str

    def to_dict(self) -> dict[str, object]:
        """Return the fields as plain types."""
        return asdict(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One kind of defect and how it is found."""

    name: str
    remedy: str
    find: Callable[[BagFacts], Iterable[Hit]]
    level: Level = "error"

    def check(self, facts: BagFacts) -> list[Finding]:
        """Return what the rule finds in a bag."""
        return [
            Finding(rule=self.name, level=self.level, remedy=self.remedy, **hit._asdict())
            for hit in self.find(facts)
        ]
