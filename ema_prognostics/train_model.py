"""Training of a whole model: both kinds of test, the paper's networks, the held-out measure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace

from ema_prognostics.cascade import Cascade
from ema_prognostics.evaluation import evaluate
from ema_prognostics.fleet import LARGE, SEVERITY, SPREAD, plant_of
from ema_prognostics.model_file import Model
from ema_prognostics.paper_experiment import PaperSettings, run_experiment
from ema_prognostics.segments import PROFILE_KINDS
from ema_prognostics.training import QUICK, TrainingSettings, train_cascade
from ema_record.version import VERSION
from ema_sim.actuator import load_actuator

PAPER = PaperSettings(unseen_angles=0, test_draws=0, columns=(3,))
"""The paper's networks for the model file; `ema paper` measures them."""
QUICK_PAPER = replace(PAPER, train_angles=1, train_draws=4, n_restarts=1)


def settings_of(seed: int, *, quick: bool) -> tuple[TrainingSettings, PaperSettings]:
    """Return the settings of a training."""
    fleet, paper = (QUICK, QUICK_PAPER) if quick else (TrainingSettings(), PAPER)
    return replace(fleet, seed=seed), replace(paper, seed=seed)


def total_steps(seed: int, *, quick: bool) -> int:
    """Return the number of calls of the progress function of `train_model`."""
    fleet, paper = settings_of(seed, quick=quick)
    return fleet.steps(len(PROFILE_KINDS)) + paper.steps


def train_model(
    seed: int = 1, *, quick: bool = False, jobs: int = 1,
    progress: Callable[[str], None] = lambda _: None,
) -> Model:
    """Return a model trained from `seed`; the same seed gives the same bytes.

    Parameters
    ----------
    seed : of fleets, noise and initial weights.
    quick : a small training, to try the way.
    jobs : processes that simulate; does not change the result.
    progress : called once a step with its name.
    """
    fleet, paper = settings_of(seed, quick=quick)
    cascades: dict[str, Cascade] = {}
    held_out = {}
    for kind in PROFILE_KINDS:
        cascades[kind], test = train_cascade(kind, fleet, jobs, progress)
        held_out[kind] = evaluate(cascades[kind], test)
    experiment = run_experiment(paper, progress)
    return Model(
        cascades=cascades, paper=experiment.cascade(), plant=plant_of(load_actuator()),
        training={
            "seed": seed, "quick": quick, "software_version": VERSION,
            "fleet": asdict(fleet), "paper": asdict(paper), "spread": SPREAD,
            "severity": {k: list(v) for k, v in SEVERITY.items()},
            "wear": {k: list(v) for k, v in LARGE.items()}, "held_out": held_out,
        },
    )
