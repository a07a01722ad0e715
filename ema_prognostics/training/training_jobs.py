"""The views of a cascade trained side by side, each by a process of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from ema_prognostics.cascade.model_body import View, ViewPart
from ema_prognostics.features.profile_kind import ProfileKind
from ema_prognostics.training.fleet import FleetFeatures
from ema_prognostics.training.view_training import train_view
from ema_record.kit import kit_folder, using_kit

VIEWS: tuple[View, ...] = ("fleet", "baseline")


class Campaign(NamedTuple):
    """The fleets that train the views of one kind of test."""

    faults: FleetFeatures
    healthy: FleetFeatures


class TrainedView(NamedTuple):
    """One view, trained."""

    kind: ProfileKind
    view: View
    part: ViewPart


def _train(kit: Path, kind: ProfileKind, view: View, campaign: Campaign, seed: int, hidden: int,
           iterations: int) -> TrainedView:
    with using_kit(kit):
        return TrainedView(kind, view, train_view(
            campaign.faults, campaign.healthy, kind, view, seed=seed, hidden=hidden,
            iterations=iterations))


def train_views(
    campaigns: Mapping[ProfileKind, Campaign], *, seed: int, hidden: int, iterations: int,
    jobs: int = 1, progress: Callable[[str, float], None] = lambda _what, _part: None,
) -> dict[ProfileKind, dict[View, ViewPart]]:
    """Return both views of each kind of test, see `train_view`; the same on any number of jobs.

    Parameters
    ----------
    campaigns : by kind of test.
    seed, hidden, iterations : of the networks.
    jobs : processes.
    progress : called with what is done and how much of the whole, 0 to 1.
    """
    from joblib import Parallel, delayed

    # The kind with the most features takes the longest: it begins.
    kinds = sorted(campaigns, key=lambda k: -len(campaigns[k].faults.names))
    todo = [(kind, view) for kind in kinds for view in VIEWS]
    progress("networks", 0.0)
    work = Parallel(n_jobs=jobs, return_as="generator_unordered")(
        delayed(_train)(kit_folder(), kind, view, campaigns[kind], seed, hidden, iterations)
        for kind, view in todo)
    found: dict[ProfileKind, dict[View, ViewPart]] = {kind: {} for kind in campaigns}
    for count, done in enumerate(work, start=1):
        found[done.kind][done.view] = done.part
        progress(f"networks, {done.kind}, {done.view}", count / len(todo))
    return {kind: {view: parts[view] for view in VIEWS} for kind, parts in found.items()}
