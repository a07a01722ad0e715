"""What is left of a balance, and where: shapes without a name, against their own chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ema_identification.rig.balance import Balance
from ema_identification.rig.blocks import Blocks
from ema_identification.rig.regression import held_out
from ema_identification.rig.selection import LEVEL_OF_CHANCE, PARSIMONY
from ema_identification.rig.shapes import GenericShape
from ema_identification.rig.sign_flips import screen

LEAST_LEFT = 0.05
"""Least share of the held-out squares for a shape to count as something that is missing."""
MIMICRY = 0.25
"""A law is given up where a nameless shape takes more than this share of what both take ..."""
COLLAPSE = 0.5
"""... and beside that shape the law takes less than this share of what it took alone."""
MAX_HELD_OUT = 8


@dataclass(frozen=True, kw_only=True)
class Left:
    """A shape that the residual has."""

    shape: GenericShape
    gain: float
    """Share of the held-out squares that it takes."""
    p_value: float
    """After all looks."""
    coefficients: np.ndarray

    @property
    def significant(self) -> bool:
        """Whether it is more than chance and large enough to matter."""
        return self.p_value <= LEVEL_OF_CHANCE and self.gain >= LEAST_LEFT


def portrait(balance: Balance, blocks: Blocks, shapes: Sequence[GenericShape]) -> list[Left]:
    """Return the shapes that a residual may have, the largest held-out gain first.

    Parameters
    ----------
    balance : Balance
        The model.
    blocks : Blocks
        What is held out, and flips its sign, together.
    shapes : sequence of GenericShape
        All that are looked for; of waves only the strongest are held out.

    """
    found = screen([shape.columns for shape in shapes], balance.free_columns,
                   balance.fit.residual, blocks)
    squares = float(np.sum(balance.held_out(blocks) ** 2))
    waves = [i for i in np.argsort(-found.gain) if shapes[i].order is not None][:MAX_HELD_OUT]
    smooth = [i for i, shape in enumerate(shapes) if shape.order is None]
    left = []
    for index in [*smooth, *waves]:
        shape = shapes[index]
        columns = np.column_stack([balance.free_columns, shape.columns])
        after = held_out(columns, balance.target, blocks)
        scale = np.sqrt(np.maximum(np.mean(columns**2, axis=0), 1e-300))
        own, *_ = np.linalg.lstsq(columns / scale, balance.target, rcond=1e-6)
        left.append(Left(
            shape=shape, gain=1.0 - float(after @ after) / squares,
            p_value=min(1.0, float(found.family_p_value[index])
                        + (shape.looks - 1) * float(found.p_value[index])),
            coefficients=(own / scale)[balance.free_columns.shape[1]:]))
    return sorted(left, key=lambda item: -item.gain)


def main_shape(left: Sequence[Left]) -> Left | None:
    """Return the shape that says best what is left: the simplest of the largest."""
    good = [item for item in left if item.significant]
    if not good:
        return None
    near = [item for item in good if item.gain >= PARSIMONY * good[0].gain]
    return min(near, key=lambda item: (item.shape.columns.shape[1], -item.gain))


def mimics(
    balance: Balance, blocks: Blocks, left: Left, first: int
) -> list[int]:
    """Return the terms that only stood in for a shape that no law holds.

    Parameters
    ----------
    balance : Balance
        The model with what was added.
    blocks : Blocks
        What is held out together.
    left : Left
        What is left of it.
    first : int
        Index of the first term that was added.

    """
    now = float(np.sum(balance.held_out(blocks) ** 2))
    shaped = _held_out_with(balance, blocks, left)
    taken = now - shaped
    found = []
    for index in range(first, len(balance.terms)):
        if balance.terms[index].law.periodic and left.shape.order is not None:
            continue  # two waves do not stand in for one another
        smaller = balance.without(index)
        own = float(np.sum(smaller.held_out(blocks) ** 2)) - now
        beside = _held_out_with(smaller, blocks, left) - shaped
        if taken > MIMICRY * (taken + max(own, 0.0)) and beside < COLLAPSE * own:
            found.append(index)
    return found


def _held_out_with(balance: Balance, blocks: Blocks, left: Left) -> float:
    columns = np.column_stack([balance.free_columns, left.shape.columns])
    after = held_out(columns, balance.target, blocks)
    return float(after @ after)
