"""Whole turns and lines: rate, partial turns, direction, too short a window."""

import numpy as np
import pytest

from ema_prognostics.features.turns import cut, rotor_lines, whole_turns
from ema_record.errors import IncompleteRecordError, InvalidRecordError
from support.simulations import TURN, slewing_record

WINDOW = (0.082, 0.382)
LINES = [(1, 0.4, 0.3), (2, 1.5, -1.0), (4, 0.7, 2.0), (6, 0.2, 0.5)]


@pytest.mark.parametrize("rate", [5_000.0, 20_000.0, 48_000.0])
@pytest.mark.parametrize("speed", [790.6, 733.3, 197.0])
@pytest.mark.parametrize("direction", [1, -1])
def test_lines_do_not_depend_on_rate_speed_or_partial_turns(rate, speed, direction):
    record = slewing_record(speed=speed, rate=rate, speed_lines=LINES, direction=direction)
    turns = whole_turns(record, WINDOW)
    assert turns.count == int(speed * 0.3 / TURN + 1e-9) or rate < 20_000
    assert turns.frequency == pytest.approx(speed / TURN, rel=1e-6)
    assert turns.direction == direction
    assert turns.weight.sum() == pytest.approx(1.0)
    lines = rotor_lines(turns, turns.samples[:, 1])
    assert lines[0].real == pytest.approx(direction * speed, rel=1e-9)
    for h in range(1, 7):
        found = {k: a * np.exp(1j * p) for k, a, p in LINES}.get(h, 0.0)
        assert abs(lines[h] - found) < 1e-6


def test_a_drift_along_the_window_does_not_leak_into_the_lines():
    record = slewing_record(speed_lines=LINES)
    turns = whole_turns(record, WINDOW)
    drifting = turns.samples[:, 1] + np.linspace(-3.0, 3.0, len(turns.theta))
    np.testing.assert_allclose(
        rotor_lines(turns, drifting)[1:], rotor_lines(turns, turns.samples[:, 1])[1:], atol=1e-6
    )


def test_window_that_the_record_does_not_cover():
    with pytest.raises(IncompleteRecordError, match="covers"):
        cut(slewing_record(duration=0.2), WINDOW)
    with pytest.raises(IncompleteRecordError, match="turns"):
        whole_turns(slewing_record(speed=50.0), WINDOW)
    with pytest.raises(InvalidRecordError, match="samples a turn"):
        whole_turns(slewing_record(rate=2_000.0), WINDOW)
