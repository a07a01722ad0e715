"""What is left of a balance, and where: shapes without a name, against their own chance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ema_identification.rig.fit.balance import InputBalance
from ema_identification.rig.fit.regression import Blocks
from ema_identification.rig.fit.sign_flips import LEVEL_OF_CHANCE, screen_by_sign_flips
from ema_identification.rig.search.shapes import GenericShape

LEAST_LEFT = 0.05
"""Least share of the held-out squares for a shape to count as something that is missing."""
LEAST_UNKNOWN = 0.03
"""Least rms of a shape, over that of the input, for the model to be called incomplete: less is
within what transducers and tolerances leave, and is reported without a verdict."""
MIMICRY = 0.25
"""A law is given up where a nameless shape takes more than this share of what both take ..."""
COLLAPSE = 0.5
"""... and beside that shape the law takes less than this share of what it took alone."""
NEARLY = 0.85
"""Shapes that take this share of the largest gain say the same."""
SMOOTHING = 0.1
SMALL = 0.01
WAVE = 5.0
"""Periods in the travel from which a wave cannot be taken for a smooth shape."""
MAX_HELD_OUT = 8


@dataclass(frozen=True, kw_only=True)
class Left:
    """A shape that the residual has."""

    shape: GenericShape
    gain: float
    """Share of the held-out squares that it takes."""
    p_value: float
    """After all looks."""
    share: float
    """Rms of what it takes, over that of the input."""
    coefficients: np.ndarray

    @property
    def significant(self) -> bool:
        """Whether it is more than chance and large enough to matter."""
        return self.p_value <= LEVEL_OF_CHANCE and self.gain >= LEAST_LEFT


def portrait(balance: InputBalance, blocks: Blocks, shapes: Sequence[GenericShape]) -> list[Left]:
    """Return the shapes that a residual may have, the largest held-out gain first.

    Parameters
    ----------
    balance : the model.
    blocks : what is held out, and flips its sign, together.
    shapes : all that are looked for; of waves only the strongest are held out.
    """
    found = screen_by_sign_flips([shape.columns for shape in shapes], balance.free_columns,
                                 balance.fit.residual, blocks)
    squares = balance.squares(blocks)
    total = float(np.sum(balance.design.trajectory.target**2))
    waves = [i for i in np.argsort(-found.gain) if shapes[i].order is not None][:MAX_HELD_OUT]
    smooth = [i for i, shape in enumerate(shapes) if shape.order is None]
    left = []
    for index in [*smooth, *waves]:
        shape = shapes[index]
        after = balance.squares_beside(shape.columns, blocks)
        left.append(Left(
            shape=shape, gain=1.0 - after / squares,
            p_value=min(1.0, float(found.family_p_value[index])
                        + (shape.looks - 1) * float(found.p_value[index])),
            share=math.sqrt(max(squares - after, 0.0) / total),
            coefficients=_smoothest(balance, shape)))
    return sorted(left, key=lambda item: -item.gain)


def _smoothest(balance: InputBalance, shape: GenericShape) -> np.ndarray:
    """Return the coefficients of a shape beside the known terms.

    A smooth shape can hold what a known term holds (a viscous friction); of all such splits
    that is taken in which the shape changes least along its abscissa, and then is smallest.
    """
    columns = np.column_stack([balance.free_columns, shape.columns])
    scale = np.sqrt(np.maximum(np.mean(columns**2, axis=0), 1e-300))
    first = balance.free_columns.shape[1]
    rows = []
    at = first
    for size in shape.groups:
        for k in range(at, at + size - 1):
            row = np.zeros(columns.shape[1])
            row[k], row[k + 1] = -1.0, 1.0
            rows.append(row)
        at += size
    weight = SMOOTHING * np.sqrt(len(columns)) * float(scale[first:].mean())
    small = np.eye(columns.shape[1])[first:] * (SMALL * weight)
    steps = weight * np.array(rows).reshape(len(rows), columns.shape[1])
    stacked = np.vstack([columns, steps, small])
    extended = np.concatenate([balance.target, np.zeros(len(steps) + len(small))])
    found, *_ = np.linalg.lstsq(stacked / scale, extended, rcond=1e-9)
    return np.asarray((found / scale)[first:])


def main_shape(left: Sequence[Left], least: float = LEAST_UNKNOWN) -> Left | None:
    """Return the shape that says best what is left: the simplest of the largest.

    None where no shape is both significant and at least `least` of the input.
    """
    good = [item for item in left if item.significant and item.share >= least]
    if not good:
        return None
    near = [item for item in good if item.gain >= NEARLY * good[0].gain]
    return min(near, key=lambda item: (item.shape.rank, -item.gain))


def mimics(balance: InputBalance, blocks: Blocks, left: Left, first: int) -> list[int]:
    """Return the terms that only stood in for a shape that no law holds.

    Terms are judged together that live against the same quantity; waves of many periods in
    the travel stand in for nothing else.

    Parameters
    ----------
    balance : the model with what was added.
    blocks : what is held out together.
    left : what is left of it.
    first : index of the first term that was added.
    """
    now, shaped = balance.squares(blocks), balance.squares_beside(left.shape.columns, blocks)
    taken = now - shaped
    groups: dict[str, list[int]] = {}
    for index in range(first, len(balance.terms)):
        term = balance.terms[index]
        periods = term.shape[0] * balance.design.trajectory.turns if term.law.in_position else 0.0
        if periods < WAVE and not term.law.looked_for:
            groups.setdefault(term.law.against, []).append(index)
    found: list[int] = []
    for indices in groups.values():
        smaller = balance
        for index in reversed(indices):
            smaller = smaller.without(index)
        own = smaller.squares(blocks) - now
        beside = smaller.squares_beside(left.shape.columns, blocks) - shaped
        if taken > MIMICRY * (taken + max(own, 0.0)) and beside < COLLAPSE * own:
            found += indices
    return sorted(found)
