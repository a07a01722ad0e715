"""Of a library that comes from outside, the form is looked at before anything is made of it."""

import numpy as np
import pytest

from ema_identification.actuator.library.form import check_form
from ema_record.array_cache import read_arrays
from ema_record.kit import LIBRARY, shipped_kit


@pytest.mark.parametrize(("name", "array"), [
    ("healthy", np.empty((0, 4))), ("healthy", np.full((480, 4), np.nan)),
    ("carried", np.zeros((2, 2))), ("carried", np.array(np.nan)), ("carried", np.array(1j)),
    ("features", np.zeros((3, 7))), ("features", np.full((480, 7), "x")),
    ("surrogate_quiet", np.zeros(200_000)), ("repeat_noisy", np.zeros((2, 7), "M8[s]")),
])
def test_another_form_is_no_library(name, array):
    kept = read_arrays(min((shipped_kit() / LIBRARY).glob("library_*.npz")))
    features = kept["features"].shape[1]
    check_form(kept, features)
    with pytest.raises(ValueError, match=name):
        check_form({**kept, name: array}, features)
