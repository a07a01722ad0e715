"""The statements of the paper's section V, each checked on our simulations with a number.

A curve over the 21 extents is the mean over all start angles, free of noise. It counts as
monotone where its rank correlation with the extent is at least 0.98 in magnitude.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.stats import spearmanr

from ema_prognostics.paper.cascade import FAULTS, FaultName
from ema_prognostics.paper.experiment import PaperExperiment, paper_window_of
from ema_prognostics.paper.features import PaperFeatures, paper_features

MONOTONE = 0.98
SHORT_SIGNS = np.array([-1, 1, -1])
FIGURE_EXTENTS: dict[FaultName, float] = {"turn_short": 0.25, "rotor_eccentricity": 0.05}
"""Extents of the paper's Figs 9 and 10."""


class Statement(NamedTuple):
    """One statement of the paper and what we found."""

    section: str
    text: str
    reproduced: bool
    evidence: str


def _curve(of_angles: list[list[PaperFeatures]], what: str, index: int | None = None
           ) -> np.ndarray:
    """Return the mean over start angles, shape (21,)."""
    values = np.array([[getattr(f, what) for f in angle] for angle in of_angles])
    return values.mean(axis=0) if index is None else values[:, :, index].mean(axis=0)


def _rank(curve: np.ndarray) -> float:
    return float(spearmanr(np.arange(len(curve)), curve)[0])


def _monotone(section: str, text: str, curve: np.ndarray, unit: str, *, rising: bool = False
              ) -> Statement:
    rank = _rank(curve)
    return Statement(section, text, (rank if rising else abs(rank)) >= MONOTONE,
                     f"rank correlation {rank:+.3f}; {curve[0]:.4g} to {curve[-1]:.4g} {unit}")


def check_statements(experiment: PaperExperiment) -> list[Statement]:
    """Return the statements of section V in the paper's order."""
    angles = (*experiment.angles, *experiment.unseen)
    figure = {
        fault: [paper_features(paper_window_of(fault, FIGURE_EXTENTS[fault], a)) for a in angles]
        for fault in FAULTS
    }
    return [*_portions(figure), *_envelope(experiment, figure), *_lines(experiment)]


def _portions(figure: dict[FaultName, list[PaperFeatures]]) -> list[Statement]:
    short = np.sign([f.concavity for f in figure["turn_short"]])
    eccentric = np.sign([f.concavity for f in figure["rotor_eccentricity"]])
    positive = (short[:, 0] == SHORT_SIGNS).mean()
    negative = (short[:, 1] == -SHORT_SIGNS).mean()
    up, down = (eccentric[:, 0] > 0).mean(), (eccentric[:, 1] > 0).mean()
    size = np.array([f.concavity for f in figure["rotor_eccentricity"]]).mean(axis=0)
    return [
        Statement(
            "V.B", "SC 25 %: two negative and one positive concavity in the positive portion",
            bool(positive >= 0.95),
            f"signs (-,+,-) for a, b, c in {positive:.0%} of the portions"),
        Statement("V.B", "SC 25 %: the opposite in the negative portion", bool(negative >= 0.95),
                  f"signs (+,-,+) in {negative:.0%} of the portions"),
        Statement("V.B", "RE 5 %: concavity of the positive portion always positive",
                  bool(up >= 0.95), f"positive in {up:.0%}; mean {_list(size[0])} A"),
        Statement("V.B", "RE 5 %: concavity of the negative portion always positive",
                  bool(down >= 0.95), f"positive in {down:.0%}; mean {_list(size[1])} A"),
    ]


def _list(values: np.ndarray) -> str:
    return ", ".join(f"{v:+.3f}" for v in values)


def _envelope(
    experiment: PaperExperiment, figure: dict[FaultName, list[PaperFeatures]]
) -> list[Statement]:
    symmetric = float(np.mean([f.symmetry for f in figure["turn_short"]]))
    shifted = float(np.mean([f.symmetry for f in figure["rotor_eccentricity"]]))
    short, eccentric = (experiment.clean[fault] for fault in FAULTS)
    top = _curve(eccentric, "envelope_maximum")
    early, late = float(np.ptp(top[:14])), float(top[-1] - top[13])
    mean = _curve(eccentric, "envelope_mean")
    rank, swing = _rank(mean), float(np.ptp(mean) / mean.mean())
    return [
        Statement("V.B", "SC: positive and negative portions symmetric to the axis",
                  symmetric <= -0.9, f"correlation {symmetric:+.3f} (symmetric -1, shifted +1)"),
        Statement("V.B", "RE: positive and negative portions only shifted", shifted >= 0.9,
                  f"correlation {shifted:+.3f} at 5 %"),
        _monotone("V.B", "SC: maximum of the envelope grows monotonously",
                  _curve(short, "envelope_maximum"), "A", rising=True),
        Statement("V.B", "RE: maximum of the envelope constant, then rapid growth",
                  late > 3.0 * early, f"varies by {early:.3f} A over rows 1-14, changes by "
                  f"{late:+.3f} A over rows 14-21"),
        _monotone("V.B", "SC: mean of the envelope grows monotonously",
                  _curve(short, "envelope_mean"), "A", rising=True),
        Statement("V.B", "RE: mean of the envelope oscillates around a mean value",
                  abs(rank) < 0.5 and swing < 0.01,
                  f"rank correlation {rank:+.3f}, swing {swing:.2%} of the mean: "
                  + ("a slow monotone fall" if rank < -0.5 else "no trend")),
    ]


def _lines(experiment: PaperExperiment) -> list[Statement]:
    short, eccentric = (experiment.clean[fault] for fault in FAULTS)
    frequency = float(np.mean([f.frequency for a in short for f in a]))
    return [
        _monotone("V.C", f"{fault}: line at {hertz} Hz monotone (ours {multiple} f_e = "
                  f"{multiple * frequency:.0f} Hz)", _curve(curves, "speed_lines", multiple),
                  "rad/s")
        for fault, curves, lines in (
            ("SC", short, ((0, 0), (2, 251), (4, 503), (6, 755))),
            ("RE", eccentric, ((0, 0), (1, 122), (3, 375))))
        for multiple, hertz in lines]
