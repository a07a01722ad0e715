"""The views of a cascade, and the paper's networks, trained side by side by processes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from ema_prognostics.cascade.model_body import View, ViewPart
from ema_prognostics.features.profile_kind import ProfileKind
from ema_prognostics.paper.cascade import PaperCascade
from ema_prognostics.paper.experiment import PaperSettings, run_experiment
from ema_prognostics.training.fleet import FleetFeatures
from ema_prognostics.training.view_training import train_view
from ema_record.kit import kit_folder, using_kit

VIEWS: tuple[View, ...] = ("fleet", "baseline")


class TrainingFleets(NamedTuple):
    """The fleets of one kind of test: with faults, healthy, with what is no fault of a class."""

    faults: FleetFeatures
    healthy: FleetFeatures
    strangers: FleetFeatures


class Trained(NamedTuple):
    """What was trained."""

    views: dict[ProfileKind, dict[View, ViewPart]]
    paper: PaperCascade | None


class _Job(NamedTuple):
    """One view, or the paper's networks."""

    kit: Path
    kind: ProfileKind | None
    view: View
    campaign: TrainingFleets | None
    seed: int
    hidden: int
    iterations: int
    paper: PaperSettings | None


def _run(job: _Job) -> tuple[_Job, ViewPart | None, PaperCascade | None]:
    with using_kit(job.kit):
        if job.kind is None or job.campaign is None:
            assert job.paper is not None
            found = run_experiment(job.paper, lambda _: None).cascade()
            return job._replace(campaign=None), None, found
        part = train_view(
            job.campaign.faults, job.campaign.healthy, job.kind, job.view, seed=job.seed,
            strangers=job.campaign.strangers, hidden=job.hidden, iterations=job.iterations)
        return job._replace(campaign=None), part, None


def train_views(
    campaigns: Mapping[ProfileKind, TrainingFleets], *, seed: int, hidden: int, iterations: int,
    jobs: int, progress: Callable[[str, float], None], paper: PaperSettings | None,
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

    def job(kind: ProfileKind | None, view: View) -> _Job:
        return _Job(kit_folder(), kind, view, None if kind is None else campaigns[kind], seed,
                    hidden, iterations, paper)

    # What takes the longest begins: the paper's networks, then the kind with the most features.
    kinds = sorted(campaigns, key=lambda k: -len(campaigns[k].faults.names))
    todo = [job(None, "fleet")] if paper is not None else []
    todo += [job(kind, view) for kind in kinds for view in VIEWS]
    progress("networks", 0.0)
    work = Parallel(n_jobs=jobs, return_as="generator_unordered")(
        delayed(_run)(one) for one in todo)
    found: dict[ProfileKind, dict[View, ViewPart]] = {kind: {} for kind in campaigns}
    literal = None
    for count, (done, part, networks) in enumerate(work, start=1):
        what = "the paper's networks" if done.kind is None else f"{done.kind}, {done.view}"
        progress(f"networks: {what}", count / len(todo))
        if done.kind is not None and part is not None:
            found[done.kind][done.view] = part
        else:
            literal = networks
    return Trained({kind: {view: parts[view] for view in VIEWS} for kind, parts in found.items()},
                   literal)
