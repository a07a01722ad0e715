"""The paper's features on records whose answer is known."""

import numpy as np
import pytest

from ema_prognostics.paper.cascade import EXTENTS, level_target
from ema_prognostics.paper.experiment import add_noise
from ema_prognostics.paper.features import (
    ANN_A_INPUTS,
    ECCENTRICITY_INPUTS,
    HALF_PORTION,
    TURN_SHORT_INPUTS,
    concavity,
    envelopes,
    paper_features,
    paper_turns,
    portion_centre,
    symmetry,
)
from support.simulations import slewing_record


def curvature(h, amplitude, phase, centre):
    """Second-degree coefficient of a line over a trimmed portion, by dense least squares."""
    u = np.linspace(-1, 1, 2001)
    wave = amplitude * np.cos(h * (centre + HALF_PORTION * u) + phase)
    return np.polyfit(u, wave, 2)[0]


@pytest.mark.parametrize("h", [2, 3])
def test_concavity_of_one_line(h):
    amplitude, phase = 0.5, 0.8
    found = concavity(paper_turns(slewing_record(current_lines=[(h, amplitude, phase)])))
    for k in range(3):
        for row, sign in ((0, 1.0), (1, -1.0)):
            want = sign * curvature(h, amplitude, phase, portion_centre(k, row == 0))
            assert found[row, k] == pytest.approx(want, abs=5e-3)


@pytest.mark.parametrize(("h", "want"), [(2, -1.0), (4, -1.0), (1, 1.0), (3, 1.0)])
def test_even_lines_are_symmetric_odd_lines_are_shifted(h, want):
    turns = paper_turns(slewing_record(current_lines=[(h, 0.4, 0.2)]))
    assert symmetry(*envelopes(turns)) == pytest.approx(want, abs=0.01)


def test_feature_vectors_have_the_sizes_of_the_paper():
    features = paper_features(paper_turns(slewing_record(
        speed_lines=[(2, 1.0, 0.0), (4, 0.4, 0.0), (6, 3.0, 0.0)], current_lines=[(2, 0.3, 0.0)]
    )))
    assert len(features.vector(ANN_A_INPUTS)) == 7
    assert len(features.vector(TURN_SHORT_INPUTS)) == 11
    assert len(features.vector(ECCENTRICITY_INPUTS)) == 12
    assert features.carriers == (2, 4)
    np.testing.assert_allclose(
        features.vector(TURN_SHORT_INPUTS)[:4], [790.6, 1.0, 0.4, 3.0], atol=1e-6
    )
    assert features.envelope_maximum == pytest.approx(7.3, abs=0.01)
    assert features.envelope_mean == pytest.approx(7.0, abs=0.01)
    assert features.speed_maximum_to_mean == pytest.approx(1 + 4.4 / 790.6, rel=1e-3)


def test_direction_does_not_change_the_lines_of_the_speed():
    lines = [(1, 0.5, 0.1), (3, 0.2, 0.4)]
    forward = paper_features(paper_turns(slewing_record(speed_lines=lines)))
    back = paper_features(paper_turns(slewing_record(speed_lines=lines, direction=-1)))
    np.testing.assert_allclose(forward.speed_lines, back.speed_lines, atol=1e-9)
    assert forward.carriers == back.carriers == (1, 3)


def test_targets_share_the_row_at_a_cut():
    rows = np.arange(1, 22)
    two, three = level_target(rows, 2), level_target(rows, 3)
    assert two.sum(axis=1).tolist() == [1] * 13 + [2] + [1] * 7
    assert three.sum(axis=0).tolist() == [6, 9, 8]
    assert np.flatnonzero(three.sum(axis=1) == 2).tolist() == [5, 13]
    assert all(len(e) == 21 for e in EXTENTS.values())


def test_noise_has_the_deviation_of_its_level_and_rate():
    turns = paper_turns(slewing_record())
    noisy = add_noise(turns, 0.05, np.random.default_rng(1))
    speed = noisy.samples[:, 1] - turns.samples[:, 1]
    assert speed.std() == pytest.approx(0.05 * 790.6 / np.sqrt(50), rel=0.05)
    current = noisy.samples[:, 5] - turns.samples[:, 5]
    assert current.std() == pytest.approx(0.05 * 7.0 / np.sqrt(50), rel=0.05)
    assert add_noise(turns, 0.0, np.random.default_rng(1)) is turns
