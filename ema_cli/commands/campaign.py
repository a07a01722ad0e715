"""`ema simulate --campaign FILE`: many runs of the emulated actuator into one folder."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

from ema_cli.console import check_new, note, print_json, progress, say
from ema_record.errors import UsageError

if TYPE_CHECKING:
    from ema_sim.campaign.runs import Campaign


def simulate_campaign(
    file: Path,
    out: Path,
    *,
    jobs: int | None = None,
    dask: str | None = None,
    run: int | None = None,
    as_json: bool = False,
) -> int:
    """Make the runs of a campaign file, or one of them alone, and return the exit status.

    Parameters
    ----------
    file : campaign file.
    out : folder of the campaign; with `run` the bag to make.
    jobs : worker processes, default one a core.
    dask : address of a dask scheduler, instead of `jobs`.
    run : number of the one run to make.
    as_json : print one object instead of lines for people.

    """
    from ema_sim.campaign.plan import load_plan
    from ema_sim.campaign.runs import prepare

    if jobs is not None and dask is not None:
        raise UsageError(f"--jobs {jobs} and --dask {dask} exclude each other: give one")
    campaign = prepare(load_plan(file))
    if run is not None:
        return _one_run(campaign, run, out, as_json)
    return _all_runs(campaign, file, out, jobs=jobs, dask=dask, as_json=as_json)


def _one_run(campaign: Campaign, index: int, out: Path, as_json: bool) -> int:
    from ema_record.bag.read import write_bag

    if not 0 <= index < campaign.runs:
        raise UsageError(f"--run {index}: the campaign has runs 0 to {campaign.runs - 1}")
    check_new(out)
    run = campaign.run(index)
    written = write_bag(run.simulate(), out)
    if as_json:
        print_json({"bag": str(written), "run": index, "seed": run.seed,
                    "profile": run.profile.name, "parameters": dict(run.drawn)})
        return 0
    drawn = ", ".join(f"{name} {value}" for name, value in run.drawn.items())
    say(f"{written}: run {index}, {run.profile.name}, seed {run.seed}")
    if drawn:
        note(drawn)
    return 0


def _all_runs(
    campaign: Campaign, file: Path, out: Path, *, jobs: int | None, dask: str | None, as_json: bool
) -> int:
    from ema_sim.campaign.run import run_campaign
    from ema_sim.campaign.store import BAGS, TABLE

    counts: list[int] = []
    begin = time.perf_counter()
    try:
        with progress(f"{campaign.runs} runs", campaign.runs) as advance:
            def count(done: int) -> None:
                counts.append(done)
                advance(done)

            columns = run_campaign(campaign.plan, jobs=jobs, dask=dask, out=out, progress=count)
    except KeyboardInterrupt:
        done = counts[-1] if counts else 0
        note(f"{done} of {campaign.runs} runs are kept: the same command makes the others")
        raise
    wall = time.perf_counter() - begin
    made, failed = campaign.runs - counts[0], int(columns["failed"].sum())
    bags = out / BAGS if campaign.plan.keep == "bags" else None
    if as_json:
        print_json({"folder": str(out), "table": str(out / TABLE),
                    "bags": None if bags is None else str(bags), "runs": campaign.runs,
                    "made": made, "failed": failed, "wall_time": wall})
        return 0
    say(f"{out / TABLE}: {campaign.runs} runs, {made} made now in {wall:.1f} s")
    if bags is not None:
        say(str(bags))
    if failed:
        note(f"{failed} runs left the domain of the model: column 'failed'")
    note(f"one alone: ema simulate --campaign {file} --run {campaign.runs - 1} --out BAG")
    return 0
