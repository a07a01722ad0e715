"""Matched filters on lines and windings: how strong each line is, how much like a short it all is.

A fault changes the torque constants, so line h of the torque residual is the same part of the
torque at every speed: the lines of the slews are averaged with the weights
that scatter least over healthy units, and counted in healthy deviations σ_h. A short in phase k
has lines 2 and 4 in fixed proportion, turned by −h k 120°. So has any change of the phases' own
constants, c_k in phase k: lines w p₂ and w* p₄ with w = Σ c_k exp(j k 120°). A wrong scale of a
current that the control believes has others, since the current that is rebuilt from it is wrong
too: what of these lines no constants make. An eccentricity has lines 1 and 3 in any direction, so
there the amplitude is what tells; no tolerance of a unit makes them, so it is weighed against the
scatter that control and sensor noise of the very record give them. A short
also takes turns from its winding: resistance and inductance of the phases then differ, in the
direction of the phase (line 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ema_record.actuator import load_actuator

HARMONICS = 6
SPEEDS = ("quarter", "full")
SHORT_LINES = (2, 4)
ECCENTRIC_LINES = (1, 3)
ACROSS = 3.0
"""How much weaker line 3 of an eccentricity across the phase is than along it, where the phases
see the gap each at its own angle: so weighed, its size alone tells the eccentricity's."""
NOISE, CURRENT_NOISE = "noise_speed", "noise_current_least"
"""Features that tell the noise of speed and current sensors, as logarithms."""
TWO_OF_THREE = 0.7
"""Noise of the torque current over that of a phase: half the sum of two."""
WINDING = ("resistance_m1", "inductance_m1")
"""How the windings of the phases differ, complex."""
STRONG = 10.0
"""Healthy deviations from which on lines are a short's own."""
FLOOR = 1e-6
NO_CONSTANTS = "constants_unlike"
"""Of lines 2 and 4 what no constants of the phases make, over what healthy units and shorts
leave."""
DERIVED = (
    *(f"amplitude_{h}" for h in range(1, HARMONICS + 1)),
    "short_like_a", "short_like_b", "short_like_c", "short_like_best", "short_unlike",
    "odd_amplitude", "winding_like_a", "winding_like_b", "winding_like_c", "winding_like_best",
    "lines_and_winding_best", "winding_unlike", "third_line_along", "third_line_across",
    "third_line_size", "first_line_strength", "third_line_strength", NO_CONSTANTS,
)
"""Names of what `LineFilter.derive` returns, in order."""


def even_lines(names: Sequence[str], x: np.ndarray, part: str = "even") -> np.ndarray:
    """Return the lines of the slews forward and back, averaged; complex, shape (n, speeds, 6).

    Parameters
    ----------
    names : of the features.
    x : ndarray, shape (n, d). Features.
    part : even, or odd: half the difference of forward and back.
    """
    index = {name: k for k, name in enumerate(names)}
    speeds = [s for s in SPEEDS if f"{s}_{part}_m1_re" in index]
    found = np.empty((len(x), len(speeds), HARMONICS), dtype=complex)
    for i, speed in enumerate(speeds):
        for h in range(HARMONICS):
            stem = f"{speed}_{part}_m{h + 1}"
            found[:, i, h] = x[:, index[f"{stem}_re"]] + 1j * x[:, index[f"{stem}_im"]]
    return found


def hidden_lines(names: Sequence[str], x: np.ndarray) -> np.ndarray:
    """Return which features `x`, shape (n, d), are lines that a limit cycle hides: zero."""
    return np.array(["_even_m" in n or "_odd_m" in n for n in names]) & (x == 0.0)


def short_lines_told(names: Sequence[str], x: np.ndarray) -> np.ndarray:
    """Return whether no line of a short is hidden, bool, shape (n,), of features `x`."""
    lines = even_lines(names, x)[:, :, [h - 1 for h in SHORT_LINES]]
    return np.asarray((lines != 0.0).all(axis=(1, 2)))


def winding_differences(names: Sequence[str], x: np.ndarray) -> np.ndarray:
    """Return `WINDING` of features `x`, complex, shape (n, 2); zero where not among `names`."""
    found = np.zeros((len(x), len(WINDING)), dtype=complex)
    for k, stem in enumerate(WINDING):
        if f"{stem}_re" in names:
            place = list(names).index(f"{stem}_re")
            found[:, k] = x[:, place] + 1j * x[:, place + 1]
    return found


def sensor_noise(names: Sequence[str], x: np.ndarray) -> np.ndarray:
    """Return the noise of features `x` as one of the speed (rad/s), shape (n,); 1: not measured.

    The torque current has the noise of the speed sensor times the controller's gain, and that of
    the current sensors.
    """
    if NOISE not in names:
        return np.ones(len(x))
    speed = np.exp(x[:, list(names).index(NOISE)])
    gain = load_actuator().control.proportional_gain
    if CURRENT_NOISE not in names or gain <= 0.0:
        return speed
    return np.hypot(speed, TWO_OF_THREE / gain * np.exp(x[:, list(names).index(CURRENT_NOISE)]))


@dataclass(frozen=True, slots=True, kw_only=True)
class LineFilter:
    """The filters of one view.

    Attributes
    ----------
    weight : ndarray, shape (speeds, 6). Of each speed's line, summing to 1.
    deviation : ndarray, shape (6,). Healthy standard deviation of the weighted lines.
    template : ndarray, complex, shape (2,). Lines 2 and 4 of a short in phase a, per fraction.
    winding : ndarray, complex, shape (2,). `WINDING` of a short in phase a, per fraction.
    precision : ndarray, shape (2, 2). Inverse covariance of `WINDING` over healthy units.
    floor, by_noise : ndarray, shape (2, speeds). Healthy standard deviation of `ECCENTRIC_LINES`
        at each speed: what is always there, and what comes with a unit of sensor noise.
    share : of lines 2 and 4 of a short, what no constants make: its template is not exact.
    """

    weight: np.ndarray
    deviation: np.ndarray
    template: np.ndarray
    winding: np.ndarray
    precision: np.ndarray
    floor: np.ndarray
    by_noise: np.ndarray
    share: float

    def derive(
        self, names: Sequence[str], x: np.ndarray, told: np.ndarray | None = None
    ) -> np.ndarray:
        """Return `DERIVED` for features `x`, shape (n, d), in healthy deviations.

        `told` : `short_lines_told` of the records, default of `x`. A line that is hidden no longer
        goes with the others, so nothing is said of `NO_CONSTANTS` there.
        """
        told = short_lines_told(names, x) if told is None else told
        lines = (even_lines(names, x) * self.weight).sum(axis=1) / self.deviation
        pick = [h - 1 for h in SHORT_LINES]
        measured = lines[:, pick]
        turns = np.exp(-2j * np.pi / 3.0 * np.outer(np.arange(3), SHORT_LINES))
        patterns = turns * self.template / self.deviation[pick]
        strength = np.sqrt((np.abs(patterns) ** 2).sum(axis=1))[0]
        like = (measured @ patterns.conj().T).real / strength
        best = np.maximum(like.max(axis=1), 0.0)
        power = (np.abs(measured) ** 2).sum(axis=1)
        rest = np.maximum(power - best**2, 0.0)
        odd = even_lines(names, x, "odd")
        run_out = (np.abs(odd).max(axis=(1, 2)) if odd.shape[1] else np.zeros(len(x)))
        wound, wound_strength, wound_rest = self._winding_like(names, x)
        both = (strength * like + wound_strength * wound) / np.hypot(strength, wound_strength)
        return np.column_stack([
            np.abs(lines), like, best, np.sqrt(rest), run_out / self.deviation.min(),
            wound, np.maximum(wound.max(axis=1), 0.0), np.maximum(both.max(axis=1), 0.0),
            wound_rest / np.sqrt(1.0 + power),
            np.abs(lines[:, 2].real), np.abs(lines[:, 2].imag),
            np.hypot(lines[:, 2].real, ACROSS * lines[:, 2].imag), self._strength(names, x),
            told * _no_constants(measured, patterns[0]) / np.sqrt(1.0 + self.share**2 * power),
        ])

    def _strength(self, names: Sequence[str], x: np.ndarray) -> np.ndarray:
        """Return the amplitude of `ECCENTRIC_LINES` in deviations of the record, shape (n, 2).

        Speeds are weighed by how little the line scatters there at the record's noise.
        """
        noise = sensor_noise(names, x)[:, None, None]
        weight = 1.0 / (self.floor**2 + (self.by_noise * noise) ** 2)
        lines = even_lines(names, x)[:, :, [h - 1 for h in ECCENTRIC_LINES]].swapaxes(1, 2)
        return np.abs((lines * weight).sum(axis=2)) / np.sqrt(weight.sum(axis=2))

    def _winding_like(
        self, names: Sequence[str], x: np.ndarray
    ) -> tuple[np.ndarray, float, np.ndarray]:
        """Return how much like a short of each phase the windings differ, and the rest.

        Resistance and inductance of a phase with a short fall together. What is left of their
        differences beside the best such fall, no short makes. The first has shape (n, 3), in
        healthy deviations; the second is deviations per fraction of turns; what no short makes
        has shape (n,), in healthy deviations.
        """
        weight = self.precision @ self.winding
        strength = float(np.sqrt(max((self.winding.conj() @ weight).real, FLOOR)))
        turns = np.exp(-2j * np.pi / 3.0 * np.arange(3))
        unlike = winding_differences(names, x)
        seen = unlike @ weight.conj()
        like = (seen[:, None] * turns.conj()).real / strength
        power = np.einsum("ni,ij,nj->n", unlike.conj(), self.precision, unlike).real
        rest = np.sqrt(np.maximum(power - np.maximum(like.max(axis=1), 0.0) ** 2, 0.0))
        return like, strength, rest


def fit_line_filter(
    names: Sequence[str], healthy: np.ndarray, shorted: np.ndarray, fraction: np.ndarray
) -> LineFilter:
    """Return the filters from healthy records and shorts of phase a.

    Parameters
    ----------
    names : of the features.
    healthy : ndarray, shape (n, d).
    shorted : ndarray, shape (m, d). Records with a short in phase a alone.
    fraction : ndarray, shape (m,). Their shorted turns.
    """
    sound = even_lines(names, healthy)
    speeds = sound.shape[1]
    weight, deviation = np.empty((speeds, HARMONICS)), np.empty(HARMONICS)
    for h in range(HARMONICS):
        part = sound[:, :, h]
        covariance = (part.conj().T @ part).real / len(part) + FLOOR * np.eye(speeds)
        inverse = np.linalg.solve(covariance, np.ones(speeds))
        weight[:, h] = inverse / inverse.sum()
        deviation[h] = np.sqrt(weight[:, h] @ covariance @ weight[:, h])
    pick = [h - 1 for h in SHORT_LINES]
    lines = (even_lines(names, shorted) * weight).sum(axis=1)[:, pick]
    small = fraction < 0.15
    power = max(float((fraction[small] ** 2).sum()), FLOOR)
    template = (fraction[small] @ lines[small]) / power
    in_deviations = lines / deviation[pick]
    size = np.sqrt((np.abs(in_deviations) ** 2).sum(axis=1))
    share = _no_constants(in_deviations, template / deviation[pick])[size > STRONG] / size[
        size > STRONG]
    unlike = winding_differences(names, healthy)
    covariance = (unlike.conj().T @ unlike).real / len(unlike) + FLOOR * np.eye(len(WINDING))
    return LineFilter(
        weight=weight, deviation=deviation, template=template,
        share=float(np.median(share)) if len(share) else 0.0,
        winding=fraction[small] @ winding_differences(names, shorted)[small] / power,
        precision=np.linalg.inv(covariance), **_scatter(sound, sensor_noise(names, healthy)),
    )


def _no_constants(lines: np.ndarray, pattern: np.ndarray) -> np.ndarray:
    """Return the size of what no constants make, shape (n,), of lines 2 and 4, (n, 2).

    `pattern`: those of a short in phase a; all in healthy deviations.
    """
    two, four = (lines * pattern.conj()).T
    of_constants = np.abs(two + four.conj()) ** 2 / (np.abs(pattern) ** 2).sum()
    return np.sqrt(np.maximum((np.abs(lines) ** 2).sum(axis=1) - of_constants, 0.0))


def _scatter(lines: np.ndarray, noise: np.ndarray) -> dict[str, np.ndarray]:
    """Return `floor` and `by_noise` of healthy lines, shape (n, speeds, 6): most likely values."""
    from scipy.optimize import minimize

    found = np.empty((2, len(ECCENTRIC_LINES), lines.shape[1]))
    for i, h in enumerate(ECCENTRIC_LINES):
        for k in range(lines.shape[1]):
            power = 0.5 * np.abs(lines[:, k, h - 1]) ** 2 + FLOOR

            def loss(logs: np.ndarray, power: np.ndarray = power) -> float:
                variance = np.exp(2.0 * logs[0]) + np.exp(2.0 * logs[1]) * noise**2
                return float(np.sum(np.log(variance) + power / variance))

            start = 0.5 * np.log(0.5 * power.mean() / np.array([1.0, np.mean(noise**2)]))
            found[:, i, k] = np.exp(minimize(loss, start, method="Nelder-Mead").x)
    return {"floor": found[0], "by_noise": found[1]}
