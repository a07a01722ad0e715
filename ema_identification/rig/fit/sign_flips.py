"""Is it more than chance: sign flips of whole blocks as the null distribution.

Under the hypothesis that a regressor adds nothing, the residual of a block may as well have
had the other sign. That keeps its colour and its unequal size, and unlike circular shifts
it does not reject every constant. All candidates see the same flips, so that the largest
of them all gives the p-value after many looks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from ema_identification.rig.fit.regression import Blocks

FLIPS = 999
CHUNK = 100
"""Candidates that are held in memory at once."""
SEED = 20260
LEVEL_OF_CHANCE = 0.005
"""Highest p-value, after all looks of a step, at which something is named."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Screening:
    """What sign flips say of many candidates, arrays of shape (candidates,)."""

    gain: np.ndarray
    """Sum of squares that each would take, less what it takes by chance; over that of all."""
    p_value: np.ndarray
    """Of each alone."""
    family_p_value: np.ndarray
    """After all looks together; at least 1 / (`FLIPS` + 1)."""
    coefficients: tuple[np.ndarray, ...]
    """Of each candidate, beside the known columns; shape (k,) each."""


def screen_by_sign_flips(
    candidates: Sequence[np.ndarray], known: np.ndarray, residual: np.ndarray, blocks: Blocks
) -> Screening:
    """Return what each candidate adds beyond the known columns.

    Parameters
    ----------
    candidates : sequence of ndarray, shape (rows, k). Regressors of each candidate.
    known : ndarray, shape (rows, p). Regressors in the model, which candidates are made orthogonal
        to.
    residual : ndarray, shape (rows,). Of the model.
    blocks : what flips together.
    """
    basis = orthonormal(known)
    sizes = np.array([columns.shape[1] for columns in candidates])
    moments = np.zeros((blocks.count, int(sizes.sum())))
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    coefficients: list[np.ndarray] = [np.empty(0)] * len(candidates)
    for size in np.unique(sizes):
        of_size = np.nonzero(sizes == size)[0]
        for first in range(0, len(of_size), CHUNK):
            chosen = of_size[first:first + CHUNK]
            pieces, own = _block_moments(
                [candidates[i] for i in chosen], basis, residual, blocks)
            for place, index in enumerate(chosen):
                moments[:, starts[index]:starts[index] + size] = pieces[:, place]
                coefficients[index] = own[place]
    signs = np.random.default_rng(SEED).choice([-1.0, 1.0], size=(FLIPS, blocks.count))
    observed = np.add.reduceat(moments.sum(axis=0) ** 2, starts)
    flipped = np.add.reduceat((signs @ moments) ** 2, starts, axis=1)
    mean, variance = _null_moments(moments, starts, sizes)
    surprise = _normal_score(observed, mean, variance)
    largest = np.sort(_normal_score(flipped, mean, variance).max(axis=1))
    counts = FLIPS - np.searchsorted(largest, surprise, side="left")
    return Screening(
        gain=(observed - mean) / max(float(residual @ residual), 1e-300),
        p_value=special.ndtr(-surprise), family_p_value=(1.0 + counts) / (1.0 + FLIPS),
        coefficients=tuple(coefficients),
    )


def p_of_much(
    columns: np.ndarray, known: np.ndarray, before: np.ndarray, after: np.ndarray, blocks: Blocks,
    looks: int,
) -> float:
    """Return the p-value of a candidate that takes nearly all, after all looks.

    What is so large is in every flipped residual of the model without it, and hides it there; so
    the residual of the model with it is flipped (ter Braak 1992, Permutation versus bootstrap
    significance tests in multiple regression and ANOVA).

    Parameters
    ----------
    columns, known : ndarray, shape (rows, k), (rows, p). Regressors of the candidate, and those in
        the model.
    before, after : ndarray, shape (rows,). Residuals of the model without the candidate and with
        it.
    blocks : what flips together.
    looks : candidates that were looked at.
    """
    basis = orthonormal(known)
    observed = _block_moments([columns], basis, before, blocks)[0][:, 0]
    flipped = _block_moments([columns], basis, after, blocks)[0][:, 0]
    mean, variance = _null_moments(flipped, np.array([0]), np.array([flipped.shape[1]]))
    surprise = _normal_score(np.sum(observed.sum(axis=0, keepdims=True) ** 2, axis=1), mean,
                             variance)
    return float(np.clip(looks * special.ndtr(-surprise[0]), 1.0 / (1.0 + FLIPS), 1.0))


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the columns, shape (rows, rank)."""
    if columns.shape[1] == 0:
        return columns
    scale = np.sqrt(np.mean(columns**2, axis=0))
    scale[scale == 0.0] = 1.0
    upper = np.linalg.qr(columns / scale)  # quicker than the singular values of all rows
    left, values, _ = np.linalg.svd(upper.R, full_matrices=False)
    return np.asarray(upper.Q @ left[:, values > 1e-9 * values[0]])


def squares_taken(columns: np.ndarray, basis: np.ndarray, residual: np.ndarray) -> float:
    """Return the squares that columns take of a residual beside an orthonormal basis."""
    own = orthonormal(columns - basis @ (basis.T @ columns))
    return float(np.sum((own.T @ residual) ** 2))


def _block_moments(
    candidates: Sequence[np.ndarray], basis: np.ndarray, residual: np.ndarray, blocks: Blocks
) -> tuple[np.ndarray, np.ndarray]:
    """Return what several candidates of k columns each have in common with the residual.

    Returns
    -------
    moments : ndarray, shape (blocks, candidates, k)
        Products of the residual and the orthonormal regressors, summed by block.
    coefficients : ndarray, shape (candidates, k)
        Of the regressors themselves, beside the known ones.
    """
    columns = np.concatenate(candidates, axis=1)
    count, size = len(candidates), candidates[0].shape[1]
    power = np.sum(columns**2, axis=0)
    rest = columns - basis @ (basis.T @ columns)
    rest = rest.reshape(len(residual), count, size)
    floor = 1e-8 * np.maximum(power.reshape(count, size), 1e-300)
    triangle = np.zeros((count, size, size))
    for k in range(size):  # Gram and Schmidt, all candidates at once
        for j in range(k):
            triangle[:, j, k] = np.einsum("ni,ni->i", rest[:, :, j], rest[:, :, k])
            rest[:, :, k] -= rest[:, :, j] * triangle[:, j, k]
        length = np.einsum("ni,ni->i", rest[:, :, k], rest[:, :, k])
        there = length > floor[:, k]
        triangle[:, k, k] = np.where(there, np.sqrt(length), np.inf)
        rest[:, :, k] *= there / np.sqrt(np.maximum(length, 1e-300))
    moments = blocks.sums(rest * residual[:, None, None])
    coefficients = moments.sum(axis=0)
    for k in reversed(range(size)):
        for j in range(k + 1, size):
            coefficients[:, k] -= triangle[:, k, j] * coefficients[:, j]
        coefficients[:, k] /= triangle[:, k, k]
    return moments, coefficients


def _null_moments(
    moments: np.ndarray, starts: np.ndarray, sizes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and variance of each candidate's sum of squares over all sign flips."""
    mean = np.zeros(len(starts))
    variance = np.zeros(len(starts))
    for index, (start, size) in enumerate(zip(starts, sizes)):
        piece = moments[:, start:start + size]
        own = np.sum(piece**2, axis=1)
        mean[index] = own.sum()
        variance[index] = 2.0 * (np.sum((piece.T @ piece) ** 2) - np.sum(own**2))
    return mean, np.maximum(variance, 1e-12 * mean**2)


def _normal_score(value: np.ndarray, mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the normal score of a gamma variable with these moments (Wilson, Hilferty 1931)."""
    there = mean > 0.0
    safe = np.where(there, mean, 1.0)
    spread = np.where(there, variance / (9.0 * safe**2), 1.0)
    score: np.ndarray = (np.cbrt(value / safe) - 1.0 + spread) / np.sqrt(spread)
    return np.where(there, score, -np.inf)
