"""`ema recover`: a readable bag from a recording that was cut or damaged."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ema_cli.console import check_new, error_line, given_bags, note, print_json, say
from ema_cli.options import Bags, ObjectABag
from ema_record.errors import EmaError, counted

if TYPE_CHECKING:
    from ema_record.bag.recover import Recovery


def recover(
    bags: Bags,
    out: Annotated[Path | None, typer.Option(
        "--out", "-o", metavar="DIR", show_default="BAG_recovered beside it",
        help="Bag to make; of several: the new directory for them.")] = None,
    as_json: ObjectABag = False,
) -> int:
    """Rebuild a readable bag from a recording that was cut or damaged.

    The original is not changed. The new bag is marked as interrupted: 'ema check' calls it
    incomplete, never healthy. Exit status 0 where a bag was made, 2 or 3 where nothing can
    be recovered; of several bags the worst, 2 before 3.

    Example: `ema recover SN-1_20260101T120000Z_extended --out recovered`
    """
    from ema_prognostics.verdict.verdict import worst_status
    from ema_record.bag.recover import recover_bag

    found = given_bags(bags)
    several = len(found) > 1
    if several:
        check_new(out)
    statuses = []
    for bag in found:
        target = out / bag.resolve().name.partition(".mcap")[0] if several and out else out
        try:
            report = recover_bag(bag, target)
        except EmaError as error:
            error_line(str(error))
            statuses.append(error.exit_status)
            continue
        statuses.append(0)
        if as_json:
            print_json(report.to_dict())
        elif several:
            say(f"{bag}: {report.samples} of {report.expected_samples} samples, {report.status}: "
                f"{report.bag}")
        else:
            _explain(report)
    return worst_status(statuses)


def _explain(report: Recovery) -> None:
    note(f"recovered {report.bag} ({report.status})")
    say(
        f"{report.samples} of {report.expected_samples} samples of the test, up to "
        f"{report.end:.4f} s"
    )
    say(f"missing: {report.missing_samples} samples ({report.missing_ms:.1f} ms)")
    for gap in report.gaps:
        say(f"gap: {counted(gap.samples, 'sample')} at {gap.time:.5f} s")
    if report.unread_bytes:
        say(f"unreadable: {report.unread_bytes} bytes")
    for damage in report.damages:
        say(f"cause: {damage}")
    for topic, count in report.left_out.items():
        say(f"left out: {counted(count, 'message')} of {topic}")
