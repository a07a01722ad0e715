"""Matched filters on the lines: the phase of a short, its size, what is no short."""

from __future__ import annotations

import numpy as np
import pytest

from ema_prognostics.cascade.lines import DERIVED, LineFilter, fit_line_filter, hidden_lines

NAMES = [f"{speed}_{part}_m{h}_{side}" for speed in ("quarter", "full")
         for part in ("even", "odd") for h in range(1, 7) for side in ("re", "im")]
TEMPLATE = np.array([278.0, 132.0])  # lines are counted in thousandths of the torque


def features(lines: np.ndarray, odd: np.ndarray | None = None) -> np.ndarray:
    """Return the features with these even lines, complex, shape (n, 2, 6)."""
    odd = np.zeros_like(lines) if odd is None else odd
    both = np.stack([lines, odd], axis=2)  # n, speed, part, h
    return np.stack([both.real, both.imag], axis=-1).reshape(len(lines), -1)


def short(phase: int, fraction: float) -> np.ndarray:
    lines = np.zeros((1, 2, 6), complex)
    for h, size in zip((2, 4), TEMPLATE):
        lines[0, :, h - 1] = fraction * size * np.exp(-2j * np.pi / 3.0 * h * phase)
    return lines


@pytest.fixture(scope="module")
def found() -> LineFilter:
    rng = np.random.default_rng(1)
    noise = rng.normal(size=(4000, 2, 6, 2)) @ np.array([1.0, 1.0j])
    noise *= np.array([1.0, 3.0])[None, :, None]
    fraction = np.linspace(0.01, 0.1, 40)
    shorted = np.vstack([short(0, x) for x in fraction])
    return fit_line_filter(NAMES, features(noise), features(shorted), fraction)


def test_weights_favour_the_quiet_speed_and_sum_to_one(found: LineFilter) -> None:
    # Weights inverse to the variances: 9 to 1.
    assert found.weight[0] == pytest.approx(np.full(6, 0.9), abs=0.02)
    assert found.weight.sum(axis=0) == pytest.approx(np.ones(6))
    assert found.deviation == pytest.approx(np.sqrt(2.0) * np.sqrt(0.9), rel=0.05)


def test_template_is_that_of_phase_a(found: LineFilter) -> None:
    assert np.allclose(found.template, TEMPLATE, rtol=1e-3)


@pytest.mark.parametrize("phase", [0, 1, 2])
def test_short_is_seen_in_its_phase_only(found: LineFilter, phase: int) -> None:
    values = dict(zip(DERIVED, found.derive(NAMES, features(short(phase, 0.05)))[0]))
    like = [values[f"short_like_{p}"] for p in "abc"]
    assert int(np.argmax(like)) == phase
    assert values["short_like_best"] == max(like)
    expected = 0.05 * np.hypot(*TEMPLATE) / found.deviation[1]
    assert like[phase] == pytest.approx(expected, rel=0.06)
    assert values["short_unlike"] < 0.05 * expected
    assert values["amplitude_1"] < 1e-6


def test_no_constants_of_the_phases_make_the_lines_of_a_wrong_current() -> None:
    """Torque that the windings make less than what the recorder's currents would.

    Currents a and b are recorded, c is what makes the sum zero: of a wrong scale g of a the torque
    is off by g i_a (t_c - t_a); of other constants by sum c_k t_k i_k.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, 3600, endpoint=False)
    shape = [np.clip(np.arcsin(np.sin(angle - 2.0 * np.pi / 3.0 * k)) * 3.0 / np.pi * 2.0, -1, 1)
             for k in range(3)]
    current = [np.where(np.abs(t) > 0.999, np.sign(t), 0.0) for t in shape]

    def lines(torque: np.ndarray) -> np.ndarray:
        row = [2.0 * np.mean(torque * np.exp(-1j * h * angle)) for h in range(1, 7)]
        return 1000.0 * np.array([[row, row]])

    fraction = np.linspace(0.01, 0.1, 40)
    rng = np.random.default_rng(4)
    filters = fit_line_filter(
        NAMES, features(rng.normal(size=(4000, 2, 6, 2)) @ np.array([1.0, 1.0j])),
        features(np.vstack([lines(-x * shape[0] * current[0]) for x in fraction])), fraction)

    def unlike(torque: np.ndarray) -> float:
        found = dict(zip(DERIVED, filters.derive(NAMES, features(lines(torque)))[0]))
        size = np.hypot(found["amplitude_2"], found["amplitude_4"])
        assert size > 10.0
        return float(found["constants_unlike"] / size)

    for constants in ((0.1, 0, 0), (0, -0.1, 0), (0.05, -0.02, 0.08), (-0.1, 0.05, 0.05)):
        assert unlike(sum(c * t * i for c, t, i in zip(constants, shape, current))) < 0.01
    for scale in (-0.1, 0.1):
        assert unlike(scale * current[0] * (shape[2] - shape[0])) > 0.3


def test_where_a_line_is_not_told_nothing_is_said_of_constants(found: LineFilter) -> None:
    """Zero, as a limit cycle leaves it at one speed, no longer goes with the line that is told."""
    lines = short(0, 0.1)
    lines[0, 0, 3] *= 1e-9
    at = DERIVED.index("constants_unlike")
    assert found.derive(NAMES, features(lines))[0, at] > 5.0
    lines[0, 0, 3] = 0.0
    assert found.derive(NAMES, features(lines))[0, at] == 0.0
    told = np.array([False])
    assert found.derive(NAMES, features(short(0, 0.1)), told)[0, at] == 0.0


def test_only_lines_that_are_zero_are_hidden() -> None:
    names = ["quarter_even_m1_re", "absolute_full_odd_m2_im", "start_position"]
    assert hidden_lines(names, np.array([[0.0, 1.0, 0.0], [2.0, -0.0, 0.0]])).tolist() == [
        [True, False, False], [False, True, False]]


def test_odd_line_is_no_short(found: LineFilter) -> None:
    lines = np.zeros((1, 2, 6), complex)
    lines[0, :, 2] = 10.0j
    values = dict(zip(DERIVED, found.derive(NAMES, features(lines))[0]))
    assert values["amplitude_3"] == pytest.approx(10.0 / found.deviation[2])
    assert values["short_like_best"] == 0.0


def test_run_out_of_the_speed_sensor_changes_sign_with_the_direction(found: LineFilter) -> None:
    odd = np.zeros((1, 2, 6), complex)
    odd[0, :, 0] = 20.0
    values = dict(zip(DERIVED, found.derive(NAMES, features(np.zeros((1, 2, 6)), odd))[0]))
    assert values["odd_amplitude"] > 10.0
    assert values["amplitude_1"] == 0.0


def test_short_takes_turns_from_its_winding() -> None:
    names = [*NAMES, *(f"{what}_m1_{side}" for what in ("resistance", "inductance")
                       for side in ("re", "im"))]
    rng = np.random.default_rng(2)

    def seen(lines: np.ndarray, winding: np.ndarray) -> np.ndarray:
        return np.hstack([features(lines), winding.view(float).reshape(len(winding), -1)])

    noise = rng.normal(size=(4000, 2, 6, 2)) @ np.array([1.0, 1.0j])
    unlike = (rng.normal(size=(4000, 2, 2)) @ np.array([1.0, 1.0j])) * [0.5, 1.0]
    taken = np.array([-100.0 + 0.0j, -50.0 + 0.0j])  # percent a fraction
    fraction = np.linspace(0.01, 0.1, 40)
    shorted = np.vstack([short(0, x) for x in fraction])
    filters = fit_line_filter(names, seen(noise, unlike),
                              seen(shorted, fraction[:, None] * taken), fraction)
    for phase in range(3):
        turned = 0.05 * taken[None] * np.exp(-2j * np.pi / 3.0 * phase)
        row = filters.derive(names, seen(short(phase, 0.05), turned))[0]
        values = dict(zip(DERIVED, row))
        like = [values[f"winding_like_{p}"] for p in "abc"]
        assert int(np.argmax(like)) == phase
        # Two normal deviates a complex number: the variance is twice that of one side.
        expected = 5.0 * np.sqrt((1.0 / 0.5) ** 2 / 2.0 + 0.5**2 / 2.0)
        assert like[phase] == values["winding_like_best"] == pytest.approx(expected, rel=0.06)
        both = np.hypot(values["short_like_best"], values["winding_like_best"])
        assert values["lines_and_winding_best"] == pytest.approx(both, rel=1e-6)
        assert values["winding_unlike"] < 1e-3
    # An inductance alone is no short: the resistance would have to fall with it.
    for size in (-10.0, 10.0):
        row = filters.derive(names, seen(np.zeros((1, 2, 6)), np.array([[0.0, size + 0.0j]])))[0]
        values = dict(zip(DERIVED, row))
        power = size**2 / 2.0
        assert np.hypot(values["winding_unlike"], values["winding_like_best"]) == pytest.approx(
            np.sqrt(power), rel=0.05)
        assert values["winding_unlike"] > 0.9 * np.sqrt(power)


def test_line_is_weighed_against_the_noise_of_its_own_record() -> None:
    rng = np.random.default_rng(3)
    noise = np.exp(rng.uniform(-0.7, 0.7, 6000))
    names = [*NAMES, "noise_speed"]

    def seen(lines: np.ndarray, noise: np.ndarray) -> np.ndarray:
        return np.hstack([features(lines), np.log(noise)[:, None]])

    spread = np.sqrt(np.array([[0.5], [0.2]]) ** 2 + (np.array([[1.0], [3.0]]) * noise) ** 2)
    lines = spread.T[:, :, None] * (rng.normal(size=(6000, 2, 6, 2)) @ np.array([1.0, 1.0j]))
    shorted = np.vstack([short(0, x) for x in (0.05, 0.1)])
    filters = fit_line_filter(names, seen(lines, noise), seen(shorted, np.ones(2)),
                              np.array([0.05, 0.1]))
    assert filters.by_noise == pytest.approx(np.array([[1.0, 3.0]] * 2), rel=0.05)
    assert filters.floor[:, 0] == pytest.approx([0.5, 0.5], rel=0.15)
    values = filters.derive(names, seen(lines, noise))[:, DERIVED.index("third_line_strength")]
    quiet = noise < 1.0
    for part in (values[quiet], values[~quiet]):  # the same law at every noise: Rayleigh's
        assert np.mean(part**2) == pytest.approx(2.0, rel=0.06)
        assert np.quantile(part, 0.99) == pytest.approx(np.sqrt(-2.0 * np.log(0.01)), rel=0.06)


def test_third_line_along_and_across_the_phase(found: LineFilter) -> None:
    lines = np.zeros((1, 2, 6), complex)
    lines[:, :, 2] = -3.0 + 4.0j
    values = dict(zip(DERIVED, found.derive(NAMES, features(lines))[0]))
    assert values["third_line_along"] == pytest.approx(3.0 / found.deviation[2])
    assert values["third_line_across"] == pytest.approx(4.0 / found.deviation[2])
    assert values["third_line_size"] == pytest.approx(np.hypot(3.0, 12.0) / found.deviation[2])
    assert values["amplitude_3"] == pytest.approx(5.0 / found.deviation[2])
