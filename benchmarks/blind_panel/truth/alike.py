"""A stratum of its own: effects that look alike, seen by the short test only.

The default test tells nearly all effects apart; one step does not. Here the answer is often a
set with a proposed next test, which is then run on the same unit.
"""

from __future__ import annotations

import numpy as np

from benchmarks.blind_panel.truth.cases import Case
from benchmarks.blind_panel.truth.hidden import HARD_TO_TELL, SIZES, draw_effect
from benchmarks.units import draw_unit

SEED = 20_261_122
SEEDS_A_SIZE = 3
FIRST, HELD_OUT = "step", "reversal"
LARGEST = 2
"""Sizes that are hidden: the smaller ones, since large effects are told apart."""


def draw_alike(seed: int = SEED) -> list[Case]:
    """Return the cases: each look-alike in its smaller sizes, interleaved, three of each."""
    names = sorted(set().union(*HARD_TO_TELL))
    plan = [(name, size) for name in names for size in range(LARGEST)]
    count = SEEDS_A_SIZE * len(plan)
    labels = np.random.default_rng([seed, 1]).permutation(count)
    order = [k for turn in range(SEEDS_A_SIZE)
             for k in np.random.default_rng([seed, 2, turn]).permutation(len(plan))]
    cases = []
    for place, k in enumerate(order):
        name, size = plan[k]
        rng = np.random.default_rng([seed, 10, place])
        cases.append(Case(
            group="effect", names=(name,), size=SIZES[size],
            settings=draw_effect(name, size, rng), foreign="", without=(), unit=draw_unit(rng),
            held_out=HELD_OUT, first=FIRST, seed=int(rng.integers(1 << 31)),
            id=f"r{labels[place]:04d}"))
    return cases
