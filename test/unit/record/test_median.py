"""The median is that of numpy, bit for bit, and loads no masked arrays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from ema_record.channels import median


@given(arrays(np.float64, array_shapes(min_dims=1, max_dims=3), elements=st.floats(width=64)),
       st.sampled_from([None, -1]))
def test_it_is_that_of_numpy(values, axis):
    with np.errstate(all="ignore"):
        expected, found = np.median(values, axis=axis), median(values, axis=axis)
    assert np.asarray(found).tobytes() == np.asarray(expected).tobytes()


def test_of_nothing_as_numpy():
    with pytest.warns(RuntimeWarning):
        assert np.isnan(median(np.empty(0)))
