"""The paper's experiment again: 21 extents a fault, three noise levels, both networks.

Simulations are free of sensor noise; the paper's (section V.A), white and a part of the maximum
of each signal, is added to the recorded window. Training and test share the simulations, so the
start angles of the rotor, but no noise; a second test uses start angles that were never trained
on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ema_prognostics.features.turns import Turns
from ema_prognostics.networks.levenberg_marquardt import train as train_network
from ema_prognostics.networks.network import Network
from ema_prognostics.paper.cascade import (
    ANN_B_INPUTS,
    EXTENTS,
    FAULTS,
    FaultName,
    PaperCascade,
    level_target,
)
from ema_prognostics.paper.features import ANN_A_INPUTS, PaperFeatures, paper_features, paper_turns
from ema_record.actuator import load_actuator
from ema_record.channels import MOTOR_SPEED, PHASE_CURRENTS, REFERENCE_CURRENTS
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate

Progress = Callable[[str], None]
"""Called once for each step that is done, with its name."""
NOISE_LEVELS = (0.0, 0.025, 0.05)
"""Deviation as a part of the maximum of the signal in the window."""
REFERENCE_RATE = 1e6
"""Rate at which the levels hold (1/s).

White noise makes any result depend on the bandwidth. A sample here is the mean over its
interval, so the deviation a sample is the level divided by sqrt(REFERENCE_RATE / rate).
"""


def add_noise(turns: Turns, level: float, rng: np.random.Generator) -> Turns:
    """Return `turns` with white noise on speed and currents.

    Parameters
    ----------
    turns : the window.
    level : deviation at `REFERENCE_RATE`, as a part of the largest magnitude in the window.
    rng : where the noise comes from.
    """
    if level == 0.0:
        return turns
    samples = turns.samples.copy()
    scale = level / np.sqrt(REFERENCE_RATE / load_actuator().acquisition.rate)
    for columns in (slice(MOTOR_SPEED, MOTOR_SPEED + 1), PHASE_CURRENTS, REFERENCE_CURRENTS):
        block = samples[:, columns]
        block += rng.standard_normal(block.shape) * (scale * np.abs(block).max())
    return replace(turns, samples=samples)


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperSettings:
    """Size and seed of the experiment."""

    seed: int = 1
    train_angles: int = 3
    unseen_angles: int = 5
    train_draws: int = 8
    """Noise draws a row, angle and level above 0 in training."""
    test_draws: int = 20
    """Fresh noise draws a row, angle and level above 0 in the test."""
    unseen_draws: int = 4
    hidden_a: int = 6
    hidden_b: int = 6
    alpha: float = 1e-2
    n_restarts: int = 2
    columns: tuple[int, ...] = (2, 3)

    @property
    def steps(self) -> int:
        """Number of calls of the progress function."""
        angles = self.train_angles + self.unseen_angles
        return 2 * angles + 3 * len(FAULTS) + 1 + len(FAULTS) * len(self.columns)


@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureSet:
    """Features of many noise draws, with what was injected.

    Attributes
    ----------
    features : one a draw.
    rows : ndarray, shape (n,). Rows of the paper's table, 1 to 21.
    levels : ndarray, shape (n,). Noise level.
    """

    features: list[PaperFeatures]
    rows: np.ndarray
    levels: np.ndarray

    def matrix(self, names: tuple[str, ...]) -> np.ndarray:
        """Return the inputs of those names, shape (n, len(names))."""
        return np.array([f.vector(names) for f in self.features])


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperExperiment:
    """Trained networks and the features that they were trained and tested on."""

    settings: PaperSettings
    angles: tuple[float, ...]
    """Start angles trained on (rad)."""
    unseen: tuple[float, ...]
    clean: dict[FaultName, list[list[PaperFeatures]]]
    """[fault][start angle, trained and unseen][row]: free of noise."""
    test: dict[FaultName, FeatureSet]
    test_unseen: dict[FaultName, FeatureSet]
    ann_a: Network
    ann_b: dict[tuple[FaultName, int], Network]

    def cascade(self) -> PaperCascade:
        """Return the networks for the model file, ANN_B with three columns."""
        return PaperCascade(
            ann_a=self.ann_a, ann_b={fault: self.ann_b[fault, 3] for fault in FAULTS},
        )


def paper_window_of(fault: FaultName, extent: float, start_angle: float) -> Turns:
    """Simulate the paper's step with a fault, free of sensor noise; return its window."""
    settings = {
        "turn_short": [f"turn_short.fraction={extent!r}", "turn_short.mode=paper"],
        "rotor_eccentricity": [f"rotor_eccentricity.zeta={extent!r}",
                               "rotor_eccentricity.mode=paper"],
    }[fault]
    record = simulate(
        load_profile("step"), effects=parse_effects(settings), noise=0.0,
        start_angle=start_angle,
    )
    return paper_turns(record)


def draw(
    windows: list[list[Turns]], rows: np.ndarray, draws: int, rng: np.random.Generator
) -> FeatureSet:
    """Return the features of `draws` noise draws a window and level (one at level 0)."""
    features, at, levels = [], [], []
    for of_angle in windows:
        for row, turns in zip(rows, of_angle):
            for level in NOISE_LEVELS:
                for _ in range(draws if level else 1):
                    features.append(paper_features(add_noise(turns, level, rng)))
                    at.append(row)
                    levels.append(level)
    return FeatureSet(features=features, rows=np.array(at), levels=np.array(levels))


def run_experiment(
    settings: PaperSettings, progress: Progress = lambda _: None
) -> PaperExperiment:
    """Simulate, draw the noise, train both networks."""
    rng = np.random.default_rng(settings.seed)
    n = settings.train_angles + settings.unseen_angles
    angles = [float(a) for a in rng.uniform(0.0, 2.0 * np.pi, n)]
    windows: dict[FaultName, list[list[Turns]]] = {fault: [] for fault in FAULTS}
    for fault in FAULTS:
        for angle in angles:
            windows[fault].append(
                [paper_window_of(fault, float(x), angle) for x in EXTENTS[fault]]
            )
            progress(f"simulating {fault}")
    rows = np.arange(1, 22)
    train, test, unseen = {}, {}, {}
    for fault in FAULTS:
        seen = windows[fault][: settings.train_angles]
        train[fault] = draw(seen, rows, settings.train_draws, rng)
        progress(f"training set, {fault}")
        test[fault] = draw(seen, rows, settings.test_draws, rng)
        progress(f"test set, {fault}")
        unseen[fault] = draw(
            windows[fault][settings.train_angles:], rows, settings.unseen_draws, rng
        )
        progress(f"unseen start angles, {fault}")
    ann_a, ann_b = _train(settings, train, progress)
    return PaperExperiment(
        settings=settings,
        angles=tuple(angles[: settings.train_angles]),
        unseen=tuple(angles[settings.train_angles:]),
        clean={f: [[paper_features(t) for t in a] for a in windows[f]] for f in FAULTS},
        test=test, test_unseen=unseen, ann_a=ann_a, ann_b=ann_b,
    )


def _train(
    settings: PaperSettings, train: dict[FaultName, FeatureSet], progress: Progress
) -> tuple[Network, dict[tuple[FaultName, int], Network]]:
    def network(hidden: int, inputs: np.ndarray, target: np.ndarray) -> Network:
        return train_network(inputs, target, hidden=hidden, alpha=settings.alpha,
                             n_restarts=settings.n_restarts, seed=settings.seed)

    inputs = np.vstack([train[fault].matrix(ANN_A_INPUTS) for fault in FAULTS])
    labels = np.repeat(np.eye(2, dtype=int), [len(train[f].rows) for f in FAULTS], axis=0)
    ann_a = network(settings.hidden_a, inputs, labels)
    progress("training ANN_A")
    ann_b = {}
    for fault in FAULTS:
        inputs = train[fault].matrix(ANN_B_INPUTS[fault])
        for columns in settings.columns:
            target = level_target(train[fault].rows, columns)
            ann_b[fault, columns] = network(settings.hidden_b, inputs, target)
            progress(f"training ANN_B, {fault}, {columns} columns")
    return ann_a, ann_b
