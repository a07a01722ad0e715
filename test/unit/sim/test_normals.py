"""Kept noise is the noise of the generators, in blocks of any size and beyond what is kept."""

import numpy as np
import pytest

from ema_sim.acquisition import KEPT, Normals


def plain(seed: int, stream: int, n: int) -> np.ndarray:
    """Return the first `n` numbers of a stream as numpy draws them."""
    child = np.random.SeedSequence(seed).spawn(stream + 1)[stream]
    return np.random.Generator(np.random.PCG64(child)).standard_normal(n)


@pytest.mark.parametrize("sizes", [[7, 1000, 3], [KEPT - 1, 5, 11], [KEPT, 4], [KEPT + 9, 2]])
def test_blocks_of_any_size(sizes: list[int]) -> None:
    """Twice, so that the second pass meets numbers that are kept."""
    for _ in range(2):
        normals = Normals(31, 1)
        found = np.concatenate([normals.take((n,)) for n in sizes])
        np.testing.assert_array_equal(found, plain(31, 1, sum(sizes)))


def test_two_at_a_time() -> None:
    """Two streams of a seed, and two readers of one stream, do not disturb each other."""
    ahead, behind, other = Normals(32, 0), Normals(32, 0), Normals(32, 1)
    first = [ahead.take((KEPT + 10,)), behind.take((4, 2)).ravel(), other.take((6,)),
             behind.take((KEPT, 2)).ravel(), ahead.take((5,))]
    np.testing.assert_array_equal(
        np.concatenate([first[0], first[4]]), plain(32, 0, KEPT + 15))
    np.testing.assert_array_equal(
        np.concatenate([first[1], first[3]]), plain(32, 0, 2 * KEPT + 8))
    np.testing.assert_array_equal(first[2], plain(32, 1, 6))
