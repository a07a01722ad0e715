"""Training of a whole model: campaigns, both views of both tests, the paper's networks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from ema_prognostics.cascade.find import Cascade
from ema_prognostics.cascade.model_body import Body, NetworkPart, PaperPart, View, ViewPart
from ema_prognostics.cascade.model_file import TrainedModel, model_of
from ema_prognostics.features.profile_kind import ProfileKind
from ema_prognostics.paper.experiment import PaperSettings, run_experiment
from ema_prognostics.training.evaluation import evaluate
from ema_prognostics.training.fleet import FleetFeatures, simulate_fleet
from ema_prognostics.training.view_training import train_view
from ema_record.version import VERSION
from ema_sim.model_file import Model

KINDS: tuple[ProfileKind, ...] = ("step", "extended")
VIEWS: tuple[View, ...] = ("fleet", "baseline")
VALIDATION_SEED = 1_000_003
"""Added to the seed for the units that validate."""
PAPER = PaperSettings(unseen_angles=0, test_draws=0, columns=(3,))
"""The paper's networks for the model file; `ema paper` measures them."""
QUICK_PAPER = replace(PAPER, train_angles=1, train_draws=4, n_restarts=1)
Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingSettings:
    """Size of a training: units a test, and the networks."""

    units: int = 1200
    """Units with faults, three tests each."""
    healthy: int = 1200
    """Further units, healthy, for the thresholds."""
    validation: int = 200
    validation_healthy: int = 300
    hidden: int = 16
    iterations: int = 200


QUICK = TrainingSettings(
    units=120, healthy=120, validation=30, validation_healthy=40, hidden=12,
    iterations=120,
)


def _nothing(_what: str, _part: float) -> None:
    pass


def train_model(
    seed: int = 1, *, quick: bool = False, jobs: int = 1, progress: Progress = _nothing,
    folder: Path | None = None, settings: TrainingSettings | None = None,
    kinds: tuple[ProfileKind, ...] = KINDS, actuator: Model | None = None,
) -> TrainedModel:
    """Return a model trained from `seed`; the same seed gives the same bytes.

    Parameters
    ----------
    seed : of units, conditions, noise and initial weights.
    quick : a small training, to try the way.
    jobs : processes that simulate; does not change the result.
    progress : called with what goes on and how much of the whole is done, 0 to 1.
    folder : keeps the features of the campaigns, so that a training that was stopped goes on.
    settings : other sizes than those of `quick` or the default.
    kinds : the tests to train for.
    actuator : the actuator around which the fleets spread, for example a model that
        `ema identify` has completed; default the nominal one.
    """
    size = settings or (QUICK if quick else TrainingSettings())
    views: dict[str, ViewPart] = {}
    held_out: dict[str, Any] = {}
    share = 0.97 / len(kinds)
    for n, kind in enumerate(kinds):
        found, result = _train_kind(
            kind, seed, size, jobs, folder, actuator,
            lambda what, part, at=n: progress(what, share * (at + part)),  # type: ignore[misc]
        )
        views |= found
        held_out[kind] = result
    progress("the paper's networks", 0.97)
    experiment = run_experiment(replace(QUICK_PAPER if quick else PAPER, seed=seed),
                                lambda _: None)
    paper = experiment.cascade()
    body = Body(
        views=views,
        paper=PaperPart(
            ann_a=NetworkPart.of(paper.ann_a),
            ann_b={name: NetworkPart.of(b)  # type: ignore[misc]
                   for name, b in paper.ann_b.items()},
        ),
        training={
            "seed": seed, "quick": quick, "software_version": VERSION,
            "settings": asdict(size), "held_out": held_out,
            **({} if actuator is None else {"actuator": repr(actuator)}),
        },
    )
    progress("done", 1.0)
    return model_of(body)


def _train_kind(
    kind: ProfileKind, seed: int, size: TrainingSettings, jobs: int, folder: Path | None,
    actuator: Model | None, progress: Progress,
) -> tuple[dict[str, ViewPart], dict[str, Any]]:
    """Return the views of one test and their validation."""
    def simulated(what: str, begin: float, end: float) -> Callable[[int, int], None]:
        return lambda k, n: progress(
            f"{kind}: {what}, {k} of {n} units", begin + (end - begin) * k / n)

    def fleet_of(what: str, units: int, start: int, healthy: bool, begin: float, end: float
                 ) -> FleetFeatures:
        return simulate_fleet(kind, units, start, healthy=healthy, jobs=jobs, folder=folder,
                              model=actuator, progress=simulated(what, begin, end))

    other = seed + VALIDATION_SEED
    faults = fleet_of("fleet with faults", size.units, seed, False, 0.0, 0.50)
    healthy_units = fleet_of("healthy fleet", size.healthy, seed, True, 0.50, 0.68)
    held = fleet_of("fleet that validates", size.validation, other, False, 0.68, 0.75)
    held_healthy = fleet_of("healthy fleet that validates", size.validation_healthy, other, True,
                            0.75, 0.80)
    parts: dict[View, ViewPart] = {}
    for at, view in enumerate(VIEWS):
        parts[view] = train_view(
            faults, healthy_units, kind, view, seed=seed, hidden=size.hidden,
            iterations=size.iterations,
            progress=lambda what, a=at, v=view: progress(  # type: ignore[misc]
                f"{kind}: network {what}, {v}", 0.80 + 0.1 * a),
        )
    fleet, own = Cascade(parts["fleet"]), Cascade(parts["baseline"])
    result = {"fleet": evaluate(fleet, None, held, held_healthy),
              "baseline": evaluate(fleet, own, held, held_healthy)}
    return {f"{kind}/{view}": part for view, part in parts.items()}, result
