"""What is wrong with a file that people write, in one line."""

import pytest

from ema_record.errors import EmaError
from ema_record.profile import load_profile


@pytest.mark.parametrize(("points", "said"), [
    ("[]", "points: needs at least 1 item (value [])"),
    ("[[0, 0], [1]]", "points.1.1: is missing (value [1])"),
    ("[[0, 0], [1, 900]]", "points.1.1: must be less than or equal to 10 (value 900)"),
    ("[[0, 0], [1, much]]",
     "points.1.1: must be a valid number, unable to parse string as a number (value much)"),
])
def test_field_what_and_value_are_told(points, said, tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text(f"name: own\npoints: {points}\n", encoding="utf-8")
    with pytest.raises(EmaError) as caught:
        load_profile(str(path))
    assert str(caught.value) == f"{path}: {said}: config/profiles/step.yaml shows the form"
