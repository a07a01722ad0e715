"""`run_campaign`: many runs of the emulated actuator, on all cores or on a cluster.

Every run is made from the plan and its own number alone, so that the results do not depend
on how many workers there are, on which of them makes a run, or on interruptions.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import shutil
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ema_record.bag.read import write_bag
from ema_record.errors import SimulationError, UsageError
from ema_record.files import cannot_write
from ema_record.profile import Profile
from ema_record.sources import source_hash
from ema_sim.campaign.plan import CampaignPlan, load_plan
from ema_sim.campaign.reductions import Reduction, as_columns, reduction_name, summary
from ema_sim.campaign.runs import Campaign, prepare
from ema_sim.campaign.store import (
    BAGS,
    PARAMETERS,
    RESULTS,
    CampaignFolder,
    Columns,
    manifest_of,
    merge,
)
from ema_sim.campaign.workers import check_jobs, done_by_workers
from ema_sim.simulate import simulate

MODULE = "ema_sim.campaign.run"
"""This module: its sources and those of all that it imports decide what a run gives."""
CHUNK = 25
"""Runs a task: some 0.2 s of work, against 1 ms to send it."""
MAX_CHUNKS = 2000


class Task(NamedTuple):
    """Some consecutive runs, and what to keep of them; goes to a worker."""

    campaign: Campaign
    number: int
    runs: range
    reduction: Reduction
    bags: str
    """Folder of the campaign if bags are kept, else empty."""


class Done(NamedTuple):
    """What comes back from a worker."""

    number: int
    columns: Columns
    sources: str


def run_campaign(
    plan: CampaignPlan | str | Path,
    *,
    reduce: Reduction | None = None,
    jobs: int | None = None,
    dask: str | None = None,
    out: str | Path | None = None,
    progress: Callable[[int], object] | None = None,
) -> Columns:
    """Make all runs of a plan and return what was kept of them.

    Parameters
    ----------
    plan : a plan, or the path of a campaign file.
    reduce : from a `Record` to numbers, arrays of one shape, or a mapping of names to these;
        default what the plan says. It must be a function that a worker can import, or a
        closure over values that can be sent.
    jobs : worker processes on this machine, default one a core; 1 runs in this process.
    dask : address of a dask scheduler, for example ``tcp://host:8786``, instead of `jobs`.
        Whoever answers there runs code in this process: only an address that you trust.
    out : folder for the results. What it already holds of the same plan is not made again.
    progress : called with the number of runs that are done, after every chunk.

    Returns
    -------
    dict of str to ndarray, shape (runs, ...)
        ``run``, ``seed``, ``failed``, ``profile``, ``parameters.<name>``, ``results.<name>``;
        results of a run that left the model's domain (``failed``) are NaN.

    Raises
    ------
    UsageError, OutputError.
    """
    campaign = prepare(plan if isinstance(plan, CampaignPlan) else load_plan(plan))
    keep = campaign.plan.keep
    bags = reduce is None and keep == "bags"
    if bags and out is None:
        raise UsageError("keep bags: say where to: give a folder (out, --out)")
    check_jobs(jobs)
    if reduce is None and keep not in ("summary", "bags"):
        raise UsageError(f"keep {keep[:80]!r}: give summary or bags; a function of your own needs "
                         "the Python call run_campaign")
    reduction = summary if reduce is None else reduce
    size = max(CHUNK, -(-campaign.runs // MAX_CHUNKS))
    tasks = [
        Task(campaign, number, range(first, min(first + size, campaign.runs)), reduction,
             str(Path(out).resolve()) if bags and out is not None else "")
        for number, first in enumerate(range(0, campaign.runs, size))
    ]
    with ExitStack() as stack:
        folder, kept, finished = None, {}, {}
        if out is not None:
            folder = CampaignFolder(out, _manifest(campaign, reduction, bags, size))
            stack.enter_context(folder.locked())
            kept = {n: folder.load(n) for n in sorted(folder.done()) if n < len(tasks)}
            finished = {n: c for n, c in kept.items() if _has_bags(tasks[n], c)}
        count = sum(len(c["run"]) for c in finished.values())
        if progress is not None:
            progress(count)
        left = [task for task in tasks if task.number not in finished]
        if dask is None and min(jobs or os.cpu_count() or 1, len(left)) > 1:
            # Compile the kernel into the cache before several workers want it at once.
            simulate(Profile(name="warm", points=((0.0, 0.0), (0.001, 0.0)), inverter_off=0.0))
        for done in done_by_workers(make_runs, left, jobs=jobs, dask=dask):
            if done.sources != source_hash(MODULE):
                raise UsageError(
                    f"a worker{f' of dask {dask}' if dask else ''} has other sources of this "
                    "software than this process: install the same version everywhere, do not "
                    "edit it meanwhile"
                )
            if folder is not None and done.number not in kept:
                folder.save(done.number, done.columns)
            finished[done.number] = done.columns
            count += len(done.columns["run"])
            if progress is not None:
                progress(count)
        columns = merge([finished[t.number] for t in tasks])
        if folder is not None:
            folder.finish(columns)
    return columns


def make_runs(task: Task) -> Done:
    """Make the runs of one task (in a worker)."""
    made: list[dict[str, np.ndarray] | None] = []
    runs = [task.campaign.run(index) for index in task.runs]
    for run in runs:
        try:
            record = run.simulate()
        except (SimulationError, UsageError):  # the plan is checked: it is what was drawn
            made.append(None)
            continue
        if task.bags:
            _keep_bag(task, run.index, record)
        made.append(as_columns(task.reduction(record)))
    columns: Columns = {
        "run": np.array([r.index for r in runs]),
        "seed": np.array([r.seed for r in runs]),
        "failed": np.array([m is None for m in made]),
        "profile": np.array([r.profile.name for r in runs]),
    }
    for name in task.campaign.plan.parameters:
        columns[f"{PARAMETERS}{name}"] = np.array([r.drawn[name] for r in runs])
    columns.update(_stack(made))
    return Done(task.number, columns, source_hash(MODULE))


def _stack(made: list[dict[str, np.ndarray] | None]) -> Columns:
    """Return results as columns; NaN where a run failed."""
    good = [m for m in made if m is not None]
    columns: Columns = {}
    if any(m.keys() != good[0].keys() for m in good):
        raise UsageError("the reduction gives other names in some runs: let it give NaN for what "
                         "a run does not have")
    for name in good[0] if good else ():
        shape = good[0][name].shape
        if any(m[name].shape != shape for m in good):
            raise UsageError(
                f"the reduction's {name!r} has another shape in some runs: let it pad the array"
            )
        missing = np.full(shape, np.nan)
        columns[f"{RESULTS}{name}"] = np.array([missing if m is None else m[name] for m in made])
    return columns


def _bag_of(task: Task, index: int) -> Path:
    return Path(task.bags) / BAGS / f"run_{index:06d}"


def _has_bags(task: Task, columns: Columns) -> bool:
    """Whether the bags of the runs of a task that did not fail are there, if any are kept."""
    made = columns["run"][~columns["failed"]].tolist() if task.bags else []
    return all(_bag_of(task, index).exists() for index in made)


def _keep_bag(task: Task, index: int, record: object) -> None:
    """Write the bag of a run under its final name, unless it is there from before."""
    path = _bag_of(task, index)
    if path.exists():
        return
    path.parent.mkdir(exist_ok=True)
    draft = path.with_name(f".{path.name}.tmp")  # a bag's file is named after its folder
    shutil.rmtree(draft, ignore_errors=True)
    try:
        draft.mkdir()
        write_bag(record, draft / path.name).rename(path)  # type: ignore[arg-type]
    except OSError as error:
        if not path.exists():
            raise cannot_write(path, error) from None
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _manifest(campaign: Campaign, reduction: Reduction, bags: bool, size: int) -> dict:
    name = reduction_name(reduction)
    try:
        sources = source_hash(MODULE, name.partition(":")[0])
    except ModuleNotFoundError:  # a function of the user's own
        try:
            text = inspect.getsource(reduction)
        except (OSError, TypeError):
            text = ""
        sources = hashlib.sha256((source_hash(MODULE) + text).encode()).hexdigest()
    return manifest_of(
        campaign.digest(), campaign.plan.model_dump(mode="json", exclude_defaults=True),
        f"bags and {name}" if bags else name, sources, campaign.runs, size,
    )
