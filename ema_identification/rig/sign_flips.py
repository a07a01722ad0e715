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

from ema_identification.rig.blocks import Blocks
from ema_identification.rig.regression import solve

FLIPS = 999
SEED = 20260


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


def screen(
    candidates: Sequence[np.ndarray], known: np.ndarray, residual: np.ndarray, blocks: Blocks,
    flips: int = FLIPS,
) -> Screening:
    """Return what each candidate adds beyond the known columns.

    Parameters
    ----------
    candidates : sequence of ndarray, shape (rows, k)
        Regressors of each candidate.
    known : ndarray, shape (rows, p)
        Regressors in the model, which candidates are made orthogonal to.
    residual : ndarray, shape (rows,)
        Of the model.
    blocks : Blocks
        What flips together.
    flips : int
        Number of sign flips.

    """
    basis = orthonormal(known)
    pieces, owner = [], []
    coefficients = []
    for index, columns in enumerate(candidates):
        piece, own = _block_moments(columns, basis, residual, blocks)
        pieces.append(piece)
        coefficients.append(own)
        owner += [index] * piece.shape[1]
    moments = np.concatenate(pieces, axis=1)
    of = np.array(owner)
    signs = np.random.default_rng(SEED).choice([-1.0, 1.0], size=(flips, blocks.count))
    observed = _taken(moments.sum(axis=0)[None, :], of, len(candidates))[0]
    flipped = _taken(signs @ moments, of, len(candidates))
    mean = np.zeros(len(candidates))
    variance = np.zeros(len(candidates))
    for index, piece in enumerate(pieces):
        own = np.sum(piece**2, axis=1)
        mean[index] = own.sum()
        variance[index] = 2.0 * (np.sum((piece.T @ piece) ** 2) - np.sum(own**2))
    log_p = _log_tail(observed, mean, variance)
    smallest = _log_tail(flipped, mean, variance).min(axis=1)
    counts = np.searchsorted(np.sort(smallest), log_p, side="right")
    return Screening(
        gain=(observed - mean) / max(float(residual @ residual), 1e-300),
        p_value=np.exp(np.maximum(log_p, -700.0)),
        family_p_value=(1.0 + counts) / (1.0 + flips), coefficients=tuple(coefficients),
    )


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the columns, shape (rows, rank)."""
    if columns.shape[1] == 0:
        return columns
    scale = np.sqrt(np.mean(columns**2, axis=0))
    scale[scale == 0.0] = 1.0
    left, values, _ = np.linalg.svd(columns / scale, full_matrices=False)
    basis: np.ndarray = left[:, values > 1e-9 * values[0]]
    return basis


def _block_moments(
    columns: np.ndarray, basis: np.ndarray, residual: np.ndarray, blocks: Blocks
) -> tuple[np.ndarray, np.ndarray]:
    """Return products of residual and orthonormal regressors by block, and coefficients."""
    rest = columns - basis @ (basis.T @ columns)
    before = np.sum(columns**2, axis=0)
    left = np.sum(rest**2, axis=0) > 1e-8 * np.maximum(before, 1e-300)
    coefficients = np.zeros(columns.shape[1])
    if not left.any():
        return np.zeros((blocks.count, 1)), coefficients
    rest = rest[:, left]
    coefficients[left] = solve(rest.T @ rest, rest.T @ residual)
    for index in range(rest.shape[1]):  # Gram and Schmidt: columns are few
        rest[:, index] -= rest[:, :index] @ (rest[:, :index].T @ rest[:, index])
        rest[:, index] /= max(float(np.sqrt(rest[:, index] @ rest[:, index])), 1e-300)
    return blocks.sums(rest * residual[:, None]), coefficients


def _taken(sums: np.ndarray, owner: np.ndarray, count: int) -> np.ndarray:
    """Return the sum of squares of each candidate's columns, shape (flips, candidates)."""
    starts = np.searchsorted(owner, np.arange(count))
    taken: np.ndarray = np.add.reduceat(sums**2, starts, axis=1)
    return taken


def _log_tail(value: np.ndarray, mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the logarithm of the tail of a gamma distribution with these moments."""
    mean = np.maximum(mean, 1e-300)
    variance = np.maximum(variance, 1e-12 * mean**2)
    shape, scale = mean**2 / variance, variance / mean
    ratio = value / scale
    tail = special.gammaincc(shape, ratio)
    with np.errstate(divide="ignore"):
        # Far out the function underflows; its leading term goes on.
        far = (shape - 1.0) * np.log(np.maximum(ratio, 1e-300)) - ratio - special.gammaln(shape)
        log_tail: np.ndarray = np.where(tail > 1e-280, np.log(np.maximum(tail, 1e-300)), far)
    return log_tail
