"""Numbers of channels: the median is that of numpy, bit for bit; the fall of a bus."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from ema_record.channels import fall_of_bus, median


@given(arrays(np.float64, array_shapes(min_dims=1, max_dims=3), elements=st.floats(width=64)),
       st.sampled_from([None, -1]))
def test_it_is_that_of_numpy(values, axis):
    with np.errstate(all="ignore"):
        expected, found = np.median(values, axis=axis), median(values, axis=axis)
    assert np.asarray(found).tobytes() == np.asarray(expected).tobytes()


def test_of_nothing_as_numpy():
    with pytest.warns(RuntimeWarning):
        assert np.isnan(median(np.empty(0)))


def test_the_fall_of_a_bus_is_told_from_the_noise_of_its_meter():
    rng, current = np.random.default_rng(3), np.array([0.0, 0.03, 0.07, 0.05, 0.02])

    def bus(resistance, noise):
        voltage = 96.0 - resistance * current + noise * rng.normal(size=5)
        return np.column_stack([np.arange(5) / 10.0, voltage, current])

    assert fall_of_bus(bus(0.3, 0.0)) == pytest.approx(0.3)
    assert fall_of_bus(bus(0.0, 0.0)) == 0.0
    told = [fall_of_bus(bus(0.0, 0.05)) != 0.0 for _ in range(2000)]
    assert np.mean(told) == pytest.approx(0.0021, abs=0.003)
    assert fall_of_bus(np.empty((0, 3))) == fall_of_bus(bus(1.0, 0.0)[:2]) == 0.0
