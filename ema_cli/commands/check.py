"""`ema check`: the verdict on recorded bags, without ROS."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ema_cli.console import check_new_file, drawing, error_line, note, say, speech, stdout
from ema_cli.options import Baseline, Cascade, Commanded, Format
from ema_cli.views.flights import draw_sequence, judged_flights, print_sequence
from ema_cli.views.machine import Machine, check_format
from ema_cli.views.pictures import picture_format, save_picture
from ema_cli.views.verdict import print_verdict
from ema_record.errors import InvalidRecordError, UsageError, unknown_name

if TYPE_CHECKING:
    from ema_prognostics.verdict.examination import Examination
    from ema_prognostics.verdict.judge import Judge


def check(
    bags: Annotated[list[Path], typer.Argument(
        metavar="BAG...", help="Bags: rosbag2 directories or single MCAP files; or a directory "
        "of them, one a flight.")],
    profile: Commanded = None,
    model: Cascade = None,
    mode: Annotated[str, typer.Option(
        metavar="robust|paper",
        help="robust: healthy class and guard; paper: the paper's two networks, which know "
        "no healthy actuator and no other than the default one.")] = "robust",
    baseline: Baseline = None,
    plot: Annotated[Path | None, typer.Option(
        metavar="FILE.png|.svg|.pdf", help="Draw the evidence of a bag, or the flights of a "
        "directory, with what is ahead."
    )] = None,
    json: Annotated[bool, typer.Option("--json", help="As --format json.")] = False,
    form: Format = "text",
) -> int:
    """Say what is wrong with the actuator that a bag was recorded from.

    A directory that holds bags is a sequence of flights: they are ordered by start time (equal
    or unknown times by name) and shown one a row, with the flight at which each fault was first
    announced and confirmed. Of several copies of a flight the whole one counts.

    Exit status: 0 all healthy, 1 a fault, 3 unknown or incomplete, 2 wrong use or a bag that
    cannot be read. Of several bags the worst counts: 2 before 1 before 3 before 0.

    With --baseline the records are compared with the actuator's own healthy one. It must be of
    the same serial number, and be called healthy itself.

    Example: `ema check bags/sim_0001_extended`
    """
    from ema_prognostics.verdict.diagnose import MODES
    from ema_prognostics.verdict.examination import examine
    from ema_prognostics.verdict.judge import Judge
    from ema_prognostics.verdict.report import verdict_of_error
    from ema_prognostics.verdict.verdict import Judged, worst_status
    from ema_record.bag.find import is_sequence, what_else

    if mode not in MODES:
        raise unknown_name("mode", mode, MODES, f"give one of {', '.join(MODES)}")
    form = check_format(form, json=json)
    sequences = [bag for bag in bags if is_sequence(bag)]
    if plot is not None:
        if len(bags) != 1:
            raise UsageError(f"--plot {plot}: {len(bags)} bags given, a picture shows one: give "
                             "one bag, or one directory of flights")
        picture_format(plot)
        check_new_file(plot)
    judge = Judge(model, baseline, profile=profile, mode=mode)
    given = "".join(f" --{name} {shlex.quote(str(value))}" for name, value in (
        ("baseline", baseline), ("model", model), ("profile", profile)) if value is not None)
    out = Machine(form, judge) if form != "text" else None
    statuses, trends, shown = [], [], False
    for bag in bags:
        if bag in sequences:
            from ema_prognostics.trend.unit_trend import trend_of

            trends = [trend_of(*unit) for unit in judged_flights([bag], judge).items()]
            print_sequence(trends, out)
            statuses += [f.verdict.exit_status for trend in trends for f in trend.flights
                         if f.repeat_of is None]
            continue
        other = what_else(bag)
        if other is None:
            found = examine(judge, bag) if out is None or plot is not None else None
            judged = judge.of_bag(bag) if found is None else found.judged
        else:
            error = InvalidRecordError(
                f"{bag}: {other}: give a rosbag2 directory, an .mcap file or a directory of bags")
            found, judged = None, Judged(verdict_of_error(error, str(bag)))
        verdict = judged.verdict
        heading = {} if found is None else found.heading() | {"given": given}
        statuses.append(verdict.exit_status)
        if out is not None:
            out.print(out.object_of(judged))
        elif other is not None:
            error_line(verdict.reasons[0])
        else:
            if shown and not speech().quiet:
                say("")
            shown = True
            print_verdict(verdict.to_dict(), heading, stdout(), **speech()._asdict())
        if plot is not None:
            _draw(found, judge, plot)
    if plot is not None and sequences:
        draw_sequence(trends, plot)
    return worst_status(statuses)


def _draw(found: Examination | None, judge: Judge, plot: Path) -> None:
    """Draw the evidence of a verdict; UsageError where there is no record."""
    if found is None or found.record is None:
        raise UsageError(f"--plot {plot}: there is no record to draw")
    with drawing():
        from ema_cli.views.evidence_plot import evidence_figure
        from ema_prognostics.features.profile_kind import profile_kind

        kind = profile_kind(found.record.profile)
        cascade = None if kind is None else judge.fleet_cascade(kind)
        save_picture(evidence_figure(found, cascade), plot)
    note(f"plot: {plot}")
