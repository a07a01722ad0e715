"""`ema check`: the verdict on recorded bags, without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ema_cli.console import print_json, stdout
from ema_cli.judge import bag_judge
from ema_cli.views.flights import check_plot, check_sequence
from ema_cli.views.verdict import print_verdict


def check(
    bags: Annotated[list[Path], typer.Argument(
        metavar="BAG...", help="Bags: rosbag2 directories or single MCAP files; or a directory "
        "of them, one a flight.")],
    profile: Annotated[str | None, typer.Option(
        help="The test that was commanded (name or YAML file), in place of the bag's own."
    )] = None,
    model: Annotated[Path | None, typer.Option(
        help="Model file of 'ema train', in place of the shipped one.")] = None,
    mode: Annotated[str, typer.Option(
        help="robust: healthy class and guard; paper: the paper's two networks, which know "
        "no healthy actuator.")] = "robust",
    baseline: Annotated[Path | None, typer.Option(
        metavar="BAG", help="A healthy bag of the same actuator and test, from its acceptance: "
        "sharpens the verdict.")] = None,
    plot: Annotated[Path | None, typer.Option(
        metavar="FILE.png", help="Of a directory of flights: plot severities and announcements."
    )] = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON object a bag and line.")] = False,
) -> int:
    """Say what is wrong with the actuator that a bag was recorded from.

    A directory that holds bags is a sequence of flights: they are ordered by start time (equal
    or unknown times by name) and shown one a row, with the flight at which each fault was first
    announced and confirmed.

    Exit status: 0 all healthy, 1 a fault, 3 unknown or incomplete, 2 wrong use or a bag that
    cannot be read. Of several bags the worst counts: 2 before 1 before 3 before 0.

    With --baseline the records are compared with the actuator's own healthy one. It must be of
    the same serial number, and be called healthy itself.

    Example: ema check bags/sim_0000_step bags/sim_0001_extended --json
    """
    from ema_prognostics.trend.flights import is_sequence
    from ema_prognostics.verdict.diagnose import MODES
    from ema_prognostics.verdict.verdict import worst_status
    from ema_record.errors import unknown_name

    if mode not in MODES:
        raise unknown_name("mode", mode, MODES, f"give one of {', '.join(MODES)}")
    check_plot(plot, [bag for bag in bags if is_sequence(bag)])
    judge = bag_judge(profile=profile, model=model, mode=mode, baseline=baseline)
    statuses = []
    for bag in bags:
        if is_sequence(bag):
            statuses += check_sequence(bag, judge, json=json, plot=plot)
            continue
        verdict, _, _ = judge(bag)
        statuses.append(verdict.exit_status)
        if json:
            print_json(verdict.to_dict())
        else:
            print_verdict(verdict.to_dict(), stdout())
    return worst_status(statuses)
