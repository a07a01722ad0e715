"""`ema lint`: defects of recordings, with time, size and remedy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ema_cli.console import error_line, given_bags, print_json, progress, say
from ema_cli.options import Bags, ObjectABag

if TYPE_CHECKING:
    from ema_record.checks.run import LintReport


def lint(
    bags: Bags,
    model: Annotated[Path | None, typer.Option(
        "--model", metavar="FILE.yaml",
        help="The actuator that was tested: changes over the kit's.")] = None,
    as_json: ObjectABag = False,
) -> int:
    """Look for defects of a recording: gaps, swapped phases, wrong units.

    Gaps, clock jumps, duplicate or reordered blocks, saturation, stuck channels, swapped
    phases, wrong units, sign flips, missing topics, wrong profile or rate, aborted tests,
    foreign software; each with time, size and remedy. Exit status: 0 clean, 1 findings, 2 a
    bag cannot be read.

    Example: `ema lint bags/sim_0001_extended --json`
    """
    from ema_record.actuator import load_actuator
    from ema_record.checks.run import lint_bag

    actuator = load_actuator(model)
    status = 0
    found = given_bags(bags)
    with progress("reading", len(found)) as advance:
        for done, bag in enumerate(found, start=1):
            report = lint_bag(bag, actuator)
            status = max(status, report.exit_status)
            if as_json:
                print_json(report.to_dict())
            else:
                _print(report)
            advance(done)
    return status


def _print(report: LintReport) -> None:
    from ema_record.checks.guard import plain

    if report.unreadable is not None:
        error_line(report.unreadable)
    elif not report.findings:
        say(f"{report.bag}: clean")
    for finding in report.findings:
        at = plain(f" at {finding.time:.4f} s") if finding.time is not None else ""
        say(f"{report.bag}: {finding.level}: {finding.rule}{at}: {finding.message}; "
            f"{finding.remedy}")
