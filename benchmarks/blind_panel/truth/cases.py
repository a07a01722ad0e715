"""The list of cases: what is hidden in each record of the panel, balanced in any prefix."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from benchmarks.blind_panel.truth.foreign import FOREIGN
from benchmarks.blind_panel.truth.hidden import HIDEABLE, SIZES, draw_effect, draw_pair
from benchmarks.units import Unit, draw_unit

SEEDS_A_SIZE = 5
N_NOTHING = 200
N_STRANGERS = 60
N_FOREIGN = 20
"""Of the strangers, those that are no entry of the catalogue at all."""
N_PAIRS = 60
HELD_OUT = ("step", "reversal")
"""Command of the held-out record: one or the other."""
DEFAULT_SEED = 20_261_121


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One unit under test and the answer."""

    group: str
    """effect, nothing, stranger or pair."""
    names: tuple[str, ...]
    """Entries of the catalogue that are hidden; empty for nothing and for what is in none."""
    size: str
    settings: dict[str, float | str]
    """Of the hidden effects, dotted names."""
    foreign: str
    """Key of `foreign.FOREIGN`, or empty."""
    without: tuple[str, ...]
    """Entries that the workflow must do without."""
    unit: Unit
    held_out: str
    seed: int
    first: str = "extended"
    """Command of the record to explain."""
    id: str = field(default="")

    def to_dict(self) -> dict[str, Any]:
        """Return what is sealed."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Case:
        """Return the case of a sealed answer."""
        return cls(**{**data, "unit": Unit(**data["unit"]), "names": tuple(data["names"]),
                      "without": tuple(data["without"])})


def draw_cases(seed: int = DEFAULT_SEED) -> list[Case]:
    """Return all cases in the order in which they are made and run.

    The groups are interleaved, and within each the effects: any prefix of the list has them
    in nearly the shares of the whole. Names of records are drawn, so they tell nothing.
    """
    groups = {
        "effect": [(name, size) for _ in range(SEEDS_A_SIZE) for size in range(3)
                   for name in HIDEABLE],
        "nothing": [None] * N_NOTHING,
        "stranger": _stranger_plan(),
        "pair": [None] * N_PAIRS,
    }
    order = sorted(
        ((k + 0.5) / len(plan), name, k) for name, plan in groups.items()
        for k in range(len(plan))
    )
    effect_order = _spread(seed, len(HIDEABLE))
    names = np.random.default_rng([seed, 1]).permutation(len(order))
    codes = {name: code for code, name in enumerate(groups, start=10)}
    cases = []
    for place, (_, group, k) in enumerate(order):
        rng = np.random.default_rng([seed, codes[group], k])
        plan = groups[group][effect_order[k] if group == "effect" else k]
        cases.append(_case(group, plan, rng, f"r{names[place]:04d}"))
    return cases


def _spread(seed: int, effects: int) -> list[int]:
    """Return an order of the plan of single effects: each round has every effect once.

    The size of an effect turns from round to round, and effects differ in where they begin.
    """
    rng = np.random.default_rng([seed, 2])
    start = rng.integers(3, size=effects)
    order = []
    for turn in range(3 * SEEDS_A_SIZE):
        for e in rng.permutation(effects):
            size = int(start[e] + turn) % 3
            order.append((turn // 3 * 3 + size) * effects + int(e))
    return order


def _stranger_plan() -> list[tuple[str, str]]:
    """Return (kind, name): two of the catalogue with their entry hidden, one of no entry."""
    known = [name for name, h in HIDEABLE.items() if h.without is not None]
    foreign = list(FOREIGN)
    plan = []
    for k in range(N_STRANGERS):
        if k % 3 == 2 and k // 3 < N_FOREIGN:
            plan.append(("foreign", foreign[(k // 3) % len(foreign)]))
        else:
            plan.append(("hidden entry", known[(k - k // 3) % len(known)]))
    return plan


def _case(group: str, plan: Any, rng: np.random.Generator, record: str) -> Case:
    names: tuple[str, ...] = ()
    settings: dict[str, float | str] = {}
    foreign, size, without = "", "", ()
    if group == "effect":
        names, size = (plan[0],), SIZES[plan[1]]
        settings = draw_effect(plan[0], plan[1], rng)
    elif group == "pair":
        names = draw_pair(rng)
        sizes = [int(s) for s in rng.integers(1, 3, size=2)]
        size = " + ".join(SIZES[s] for s in sizes)
        for name, s in zip(names, sizes):
            settings |= draw_effect(name, s, rng)
    elif group == "stranger" and plan[0] == "foreign":
        foreign = plan[1]
    elif group == "stranger":
        names = (plan[1],)
        s = int(rng.integers(1, 3))
        size, settings = SIZES[s], draw_effect(plan[1], s, rng)
        without = HIDEABLE[plan[1]].without or ()
    return Case(
        group=group, names=names, size=size, settings=settings, foreign=foreign,
        without=without, unit=draw_unit(rng), held_out=HELD_OUT[rng.integers(2)],
        seed=int(rng.integers(1 << 31)), id=record,
    )
