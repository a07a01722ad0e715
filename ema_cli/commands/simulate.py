"""`ema simulate`: a test on the emulated actuator, without ROS, into a bag."""

from __future__ import annotations

import shlex
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ema_cli.console import check_new, check_new_file, drawing, note, print_json, progress, say
from ema_cli.options import Changes, Effect, Noise, Seed, SerialNumber, given_once
from ema_record.errors import UsageError
from ema_record.files import check_apart
from ema_record.kit import CASCADE, kit_folder, kit_option

if TYPE_CHECKING:
    import numpy as np

    from ema_record.profile import Profile
    from ema_record.record import Record
    from ema_sim.campaign.runs import Campaign

DEFAULT_PROFILE = "extended"
STEP = "step"


def simulate(
    context: typer.Context,
    out: Annotated[Path, typer.Option(
        "--out", "-o", metavar="BAG", help="Directory to make.")],
    campaign: Annotated[Path | None, typer.Option(
        "--campaign", metavar="FILE.yaml",
        help="Make all runs of a campaign; --out is the folder of its results.")] = None,
    jobs: Annotated[int | None, typer.Option(
        "--jobs", help="Campaign: worker processes, default one a core.")] = None,
    dask: Annotated[str | None, typer.Option(
        "--dask", metavar="ADDRESS", help="Campaign: scheduler of a dask cluster; whoever answers "
        "there runs code here.")] = None,
    run: Annotated[int | None, typer.Option(
        "--run", metavar="NUMBER", help="Campaign: this run alone, into a bag.")] = None,
    profile: Annotated[str | None, typer.Option(
        "--profile", "-p", metavar="NAME|FILE.yaml", show_default=DEFAULT_PROFILE,
        help="Test profile: one of the kit's ('ema profile' lists them), or a file.")] = None,
    effect: Effect = None,
    model: Changes = None,
    seed: Seed = 0,
    noise: Noise = 1.0,
    rate: Annotated[float | None, typer.Option(
        "--rate", help="Samples a second, default those of the actuator.")] = None,
    switching: Annotated[bool, typer.Option(
        "--switching", help="Simulate each edge of a carrier (drives pwm and foc), not the means "
        "of its periods; a relay's always are.")] = False,
    step: Annotated[float | None, typer.Option(
        "--step", metavar="AMPLITUDE", help="Instead of a profile: one step of this size (rad) "
        "from where the kit's profile step begins.")] = None,
    start_angle: Annotated[float | None, typer.Option(
        "--start-angle", metavar="RAD",
        help="Electrical rotor angle at the start, default drawn from the seed.")] = None,
    serial_number: SerialNumber = "SIM-0000",
    trace: Annotated[Path | None, typer.Option(
        "--trace", metavar="FILE.csv",
        help="Also write what no sensor sees: motor and shaft torque, surface speed.")] = None,
    plot: Annotated[Path | None, typer.Option(
        "--plot", metavar="DIR", help="Also plot the test, as PNG into DIR.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print a summary as JSON.")] = False,
) -> int:
    """Run a test on the emulated actuator, without ROS, into a bag.

    What was hidden in the actuator is not told by the bag, which names the kit's actuator.
    Outputs that exist are never overwritten.

    Example: `ema simulate --profile step --effect turn_short.fraction=0.1 --out short`
    """
    from ema_record.bag.read import write_bag
    from ema_sim.effects import parse_effects
    from ema_sim.model_file import load_model_file
    from ema_sim.simulate import simulate_traced

    if campaign is not None:
        from ema_sim.campaign.plan import load_plan
        from ema_sim.campaign.runs import prepare

        _refuse_own_options(context, campaign)
        if jobs is not None and dask is not None:
            raise UsageError(f"--jobs {jobs} and --dask {dask} exclude each other: give one")
        all_runs = prepare(load_plan(campaign))
        if run is not None:
            return _one_run(all_runs, run, out, as_json)
        return _all_runs(all_runs, campaign, out, jobs=jobs, dask=dask, as_json=as_json)
    if jobs is not None or dask is not None or run is not None:
        raise UsageError("--jobs, --dask and --run belong to a campaign: give --campaign FILE")
    check_new(out, bag=True)
    check_new_file(trace)
    check_apart(out, trace, plot)
    loaded = load_model_file(model)
    chosen = choose_profile(profile, step, loaded.actuator.surface.end_stop)
    given_once("--effect", effect)
    effects = parse_effects(effect or [], loaded.effects)
    if plot is not None:
        from ema_cli.views.record_plots import check_plot_folder

        check_plot_folder(plot)
    begin = time.perf_counter()
    with progress(f"simulating {chosen.name}, {chosen.duration:g} s"):
        result = simulate_traced(
            chosen, actuator=loaded.actuator, effects=effects, seed=seed, noise=noise, rate=rate,
            start_angle=start_angle, serial_number=serial_number, start_time=time.time_ns(),
            trace=trace is not None or plot is not None, switching=switching,
        )
    wall = time.perf_counter() - begin
    written = write_bag(_named(result.record), out)
    if trace is not None:
        write_trace(trace, result.record.time, result.trace)
    if not as_json:
        say(f"{written}: {chosen.name}, {chosen.duration:g} s, {len(result.record)} samples")
    plots: list[Path] = []
    try:
        if plot is not None:
            with drawing():
                from ema_cli.views.record_plots import plot_record

                plots = plot_record(result.record, plot, trace=result.trace)
    finally:  # a picture that fails takes nothing else with it
        if as_json:
            print_json({
                "bag": str(written), "profile": chosen.name, "samples": len(result.record),
                "rate": rate or loaded.actuator.acquisition.rate, "duration": chosen.duration,
                "serial_number": serial_number,
                "wall_time": wall, "trace": None if trace is None else str(trace),
                "plots": [str(path) for path in plots],
            })
    if as_json:
        return 0
    for path in plots:
        say(str(path))
    check = f"next: ema check {shlex.quote(str(written))}{kit_option()}"
    if not (kit_folder() / CASCADE).is_file():
        check = "no verdict with this kit until 'ema commission' or 'ema train' has completed it"
    note(f"simulated {chosen.duration:g} s in {wall:.2f} s; {check}")
    return 0


def _named(record: Record) -> Record:
    """Return a record that names the kit's actuator."""
    from dataclasses import replace

    from ema_record.actuator_type import actuator_hash

    named = replace(record.provenance, actuator=actuator_hash())
    return replace(record, provenance=named)


def _refuse_own_options(context: typer.Context, file: Path) -> None:
    """Raise UsageError for an option of a single run: the campaign's file gives them."""
    for name in ("profile", "effect", "model", "seed", "noise", "rate", "switching", "step",
                 "start_angle", "serial_number", "trace", "plot"):
        source = context.get_parameter_source(name)
        if source is not None and source.name != "DEFAULT":
            raise UsageError(
                f"--{name.replace('_', '-')} and --campaign exclude each other: write it into "
                f"{file}"
            )


def choose_profile(name: str | None, step: float | None, end_stop: float) -> Profile:
    """Return the profile of that name or file, or a step; UsageError if both are given.

    The step begins where the kit's own begins, is as long, and stays within the end stops (rad).
    """
    from ema_record.profile import load_profile, profile_names, step_profile

    if step is None:
        return load_profile(name or DEFAULT_PROFILE)
    if name is not None:
        raise UsageError(f"--profile {name} and --step {step:g} exclude each other: give one")
    names = sorted(profile_names(), key=lambda known: (known != STEP, known))
    if not names:
        raise UsageError(f"--step {step:g}: the kit has no test that says where it begins: give "
                         "--profile FILE.yaml")
    own = load_profile(names[0])
    lower, upper = -end_stop - own.start, end_stop - own.start
    if not lower <= step <= upper:
        raise UsageError(f"--step {step:g}: not within the end stops: give a finite number, "
                         f"{lower:g} to {upper:g} rad")
    return step_profile(step, start=own.start, duration=own.duration)


def write_trace(path: Path, time: np.ndarray, trace: np.ndarray) -> None:
    """Write time, shape (n,) (s), and the trace, shape (n, 3), as CSV with units."""
    import numpy as np

    from ema_record.files import new_file
    from ema_sim.plant.kernel import TRACE_NAMES

    with new_file(path) as temporary:
        np.savetxt(
            temporary, np.column_stack([time, trace]), fmt="%.9g", delimiter=",", comments="",
            header=",".join(["time[s]", *TRACE_NAMES]),
        )


def _one_run(campaign: Campaign, index: int, out: Path, as_json: bool) -> int:
    from ema_record.bag.read import write_bag

    if not 0 <= index < campaign.runs:
        raise UsageError(f"--run {index}: the campaign has runs 0 to {campaign.runs - 1}")
    check_new(out, bag=True)
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
