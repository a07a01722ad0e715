"""The statements of the paper's section V, each checked on our simulations with a number.

A curve over the 21 extents is the mean over all start angles, free of noise. It counts as
monotone where its rank correlation with the extent is at least 0.98 in magnitude.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import spearmanr

from ema_prognostics.paper.cascade import FAULTS, FaultName
from ema_prognostics.paper.experiment import PaperExperiment, paper_window_of
from ema_prognostics.paper.features import PaperFeatures, paper_features

MONOTONE = 0.98
SHORT_SIGNS = np.array([-1, 1, -1])
FIGURE_EXTENTS: dict[FaultName, float] = {"turn_short": 0.25, "rotor_eccentricity": 0.05}
"""Extents of the paper's Figs 9 and 10."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Statement:
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
    return Statement(
        section=section, text=text,
        reproduced=(rank if rising else abs(rank)) >= MONOTONE,
        evidence=f"rank correlation {rank:+.3f}; {curve[0]:.4g} to {curve[-1]:.4g} {unit}",
    )


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
            section="V.B", text="SC 25 %: two negative and one positive concavity in the "
            "positive portion", reproduced=bool(positive >= 0.95),
            evidence=f"signs (-,+,-) for a, b, c in {positive:.0%} of the portions",
        ),
        Statement(
            section="V.B", text="SC 25 %: the opposite in the negative portion",
            reproduced=bool(negative >= 0.95),
            evidence=f"signs (+,-,+) in {negative:.0%} of the portions",
        ),
        Statement(
            section="V.B", text="RE 5 %: concavity of the positive portion always positive",
            reproduced=bool(up >= 0.95),
            evidence=f"positive in {up:.0%}; mean {_list(size[0])} A",
        ),
        Statement(
            section="V.B", text="RE 5 %: concavity of the negative portion always positive",
            reproduced=bool(down >= 0.95),
            evidence=f"positive in {down:.0%}; mean {_list(size[1])} A",
        ),
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
        Statement(
            section="V.B", text="SC: positive and negative portions symmetric to the axis",
            reproduced=symmetric <= -0.9,
            evidence=f"correlation {symmetric:+.3f} (symmetric -1, shifted +1)",
        ),
        Statement(
            section="V.B", text="RE: positive and negative portions only shifted",
            reproduced=shifted >= 0.9, evidence=f"correlation {shifted:+.3f} at 5 %",
        ),
        _monotone("V.B", "SC: maximum of the envelope grows monotonously",
                  _curve(short, "envelope_maximum"), "A", rising=True),
        Statement(
            section="V.B", text="RE: maximum of the envelope constant, then rapid growth",
            reproduced=late > 3.0 * early,
            evidence=f"varies by {early:.3f} A over rows 1-14, changes by {late:+.3f} A "
            "over rows 14-21",
        ),
        _monotone("V.B", "SC: mean of the envelope grows monotonously",
                  _curve(short, "envelope_mean"), "A", rising=True),
        Statement(
            section="V.B", text="RE: mean of the envelope oscillates around a mean value",
            reproduced=abs(rank) < 0.5 and swing < 0.01,
            evidence=f"rank correlation {rank:+.3f}, swing {swing:.2%} of the mean: "
            + ("a slow monotone fall" if rank < -0.5 else "no trend"),
        ),
    ]


def _lines(experiment: PaperExperiment) -> list[Statement]:
    short, eccentric = (experiment.clean[fault] for fault in FAULTS)
    found = []
    frequency = float(np.mean([f.frequency for a in short for f in a]))
    for multiple, hertz in ((0, 0), (2, 251), (4, 503), (6, 755)):
        found.append(_monotone(
            "V.C", f"SC: line at {hertz} Hz monotone (ours {multiple} f_e = "
            f"{multiple * frequency:.0f} Hz)", _curve(short, "speed_lines", multiple), "rad/s",
        ))
    for multiple, hertz in ((0, 0), (1, 122), (3, 375)):
        found.append(_monotone(
            "V.C", f"RE: line at {hertz} Hz monotone (ours {multiple} f_e = "
            f"{multiple * frequency:.0f} Hz)", _curve(eccentric, "speed_lines", multiple),
            "rad/s",
        ))
    return found
