"""Training of a whole model: campaigns, both views of both tests, the paper's networks.

Views and the paper's networks are trained side by side by processes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from ema_prognostics.cascade.model_body import NetworkPart, View, ViewPart
from ema_prognostics.cascade.model_file import Body, PaperPart, TrainedModel, model_of
from ema_prognostics.features.profile_kind import ProfileKind
from ema_prognostics.paper.cascade import PaperCascade
from ema_prognostics.paper.experiment import PaperSettings, run_experiment
from ema_prognostics.training.evaluation import evaluated
from ema_prognostics.training.faults import draw_stranger
from ema_prognostics.training.fleet import (
    DrawFault,
    FleetFeatures,
    draw_of_mix,
    simulate_fleets,
)
from ema_prognostics.training.view_training import train_view
from ema_record.actuator import RELAY, TRAPEZOID, load_actuator
from ema_record.actuator_type import actuator_hash
from ema_record.kit import with_present_kit
from ema_record.profile import profile_names
from ema_record.version import VERSION
from ema_sim.model_file import Model

KINDS: tuple[ProfileKind, ...] = ("step", "extended")
VIEWS: tuple[View, ...] = ("fleet", "baseline")
PAPERS = "the paper's networks"
VALIDATION_SEED = 1_000_003
"""Added to the seed for the units that validate."""
PAPER = PaperSettings(unseen_angles=0, test_draws=0, columns=(3,))
"""The paper's networks for the model file, of an actuator such as the paper's: relay, trapezoid;
`ema paper` measures them."""
QUICK_PAPER = replace(PAPER, train_angles=1, train_draws=4, n_restarts=1)
Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingSettings:
    """Size of a training: units a test, and the networks."""

    units: int = 1200
    """Units with faults, three tests each."""
    healthy: int = 1200
    """Further units, healthy, for the thresholds."""
    strangers: int = 400
    """Further units, three tests each of what is no fault of a family."""
    validation: int = 200
    validation_healthy: int = 300
    validation_strangers: int = 60
    hidden: int = 16
    iterations: int = 200


QUICK = TrainingSettings(
    units=120, healthy=120, strangers=60, validation=30, validation_healthy=40,
    validation_strangers=10, hidden=12, iterations=120,
)


class TrainingFleets(NamedTuple):
    """The fleets of one kind of test: with faults, healthy, with what is no fault of a class."""

    faults: FleetFeatures
    healthy: FleetFeatures
    strangers: FleetFeatures


class Trained(NamedTuple):
    """What was trained."""

    views: dict[ProfileKind, dict[View, ViewPart]]
    paper: PaperCascade | None


def _view(kind: ProfileKind, view: View, fleets: TrainingFleets, **settings: Any
          ) -> tuple[str, ViewPart]:
    """Return what was trained, for the progress, and the view."""
    return f"{kind}, {view}", train_view(
        fleets.faults, fleets.healthy, kind, view, strangers=fleets.strangers, **settings)


def _paper(settings: PaperSettings) -> tuple[str, PaperCascade]:
    return PAPERS, run_experiment(settings, lambda _: None).cascade()


def train_views(
    campaigns: Mapping[ProfileKind, TrainingFleets], *, seed: int, hidden: int, iterations: int,
    jobs: int, progress: Progress, paper: PaperSettings | None,
) -> Trained:
    """Return both views of each kind of test, see `train_view`; the same on any number of jobs.

    Parameters
    ----------
    campaigns : by kind of test.
    seed, hidden, iterations : of the networks.
    jobs : processes.
    progress : called with what is done and how much of the whole, 0 to 1.
    paper : settings of the paper's networks, None for none.
    """
    from joblib import Parallel, delayed

    # What takes the longest begins: the paper's networks, then the kind with the most features.
    kinds = sorted(campaigns, key=lambda k: -len(campaigns[k].faults.names))
    todo = [delayed(with_present_kit(_paper))(paper)] if paper is not None else []
    todo += [delayed(with_present_kit(_view))(
        kind, view, campaigns[kind], seed=seed, hidden=hidden, iterations=iterations)
        for kind in kinds for view in VIEWS]
    progress("networks", 0.0)
    found: dict[str, Any] = {}
    work = Parallel(n_jobs=jobs, return_as="generator_unordered")(todo)
    for count, (what, part) in enumerate(work, start=1):
        progress(f"networks: {what}", count / len(todo))
        found[what] = part
    return Trained({kind: {view: found[f"{kind}, {view}"] for view in VIEWS}
                    for kind in campaigns}, found.get(PAPERS))


def train_model(
    seed: int = 1, *, quick: bool = False, jobs: int = 1,
    progress: Progress = lambda _what, _part: None, folder: Path | None = None,
    kinds: tuple[ProfileKind, ...] | None = None, actuator: Model | None = None,
) -> TrainedModel:
    """Return a model trained from `seed`; the same seed gives the same bytes.

    Parameters
    ----------
    seed : of units, conditions, noise and initial weights.
    quick : a small training, to try the way.
    jobs : processes that simulate and train; does not change the result.
    progress : called with what goes on and how much of the whole is done, 0 to 1.
    folder : keeps the features of the campaigns, so that a training that was stopped goes on.
    kinds : the tests to train for, default those that the kit has.
    actuator : the actuator around which the fleets spread, for example a model that
        `ema identify` has completed; default the nominal one.
    """
    size = QUICK if quick else TrainingSettings()
    kinds = kinds or tuple(kind for kind in KINDS if kind in profile_names())
    nominal = load_actuator()
    literal = nominal.drive.kind == RELAY and nominal.motor.back_emf == TRAPEZOID

    def simulated(
        what: str, units: int, seed: int, begin: float, end: float, *, healthy: bool = False,
        draw: DrawFault = draw_of_mix,
    ) -> dict[ProfileKind, FleetFeatures]:
        return simulate_fleets(
            kinds, units, seed, healthy=healthy, draw=draw, jobs=jobs, folder=folder,
            model=actuator, progress=lambda k, n: progress(
                f"{what}, {k} of {n} units", begin + (end - begin) * k / n))

    faults = simulated("fleet with faults", size.units, seed, 0.0, 0.36)
    healthy = simulated("healthy fleet", size.healthy, seed, 0.36, 0.54, healthy=True)
    strange = simulated("fleet of strangers", size.strangers, seed, 0.54, 0.64,
                        draw=draw_stranger)
    other = seed + VALIDATION_SEED
    held = simulated("fleet that validates", size.validation, other, 0.64, 0.69)
    sound = simulated("healthy fleet that validates", size.validation_healthy, other, 0.69, 0.73,
                      healthy=True)
    odd = simulated("strangers that validate", size.validation_strangers, other, 0.73, 0.75,
                    draw=draw_stranger)
    trained = train_views(
        {kind: TrainingFleets(faults[kind], healthy[kind], strange[kind]) for kind in kinds},
        seed=seed, hidden=size.hidden, iterations=size.iterations, jobs=jobs,
        paper=replace(QUICK_PAPER if quick else PAPER, seed=seed) if literal else None,
        progress=lambda what, part: progress(what, 0.75 + 0.20 * part))
    views = {f"{kind}/{view}": part for kind, parts in trained.views.items()
             for view, part in parts.items()}
    progress("validation", 0.95)
    held_out = {kind: evaluated(trained.views[kind], (held[kind], sound[kind], odd[kind]))
                for kind in kinds}
    paper = None if trained.paper is None else PaperPart(
        ann_a=NetworkPart.of(trained.paper.ann_a),
        ann_b={n: NetworkPart.of(b) for n, b in trained.paper.ann_b.items()})  # type: ignore[misc]
    body = Body(
        views=views, paper=paper, actuator=actuator_hash(),
        training={
            "seed": seed, "quick": quick, "software_version": VERSION,
            "settings": asdict(size), "held_out": held_out,
            **({} if actuator is None else {"actuator": repr(actuator)}),
        },
    )
    progress("done", 1.0)
    return model_of(body)
