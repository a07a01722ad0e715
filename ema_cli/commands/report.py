"""`ema report`: the page of one test for the maintenance record."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ema_cli.console import check_new_file, given_bags, note, print_json, progress, say
from ema_cli.options import Baseline, Cascade, Commanded, one_line
from ema_record.errors import IncompleteRecordError, UsageError
from ema_record.files import check_apart

if TYPE_CHECKING:
    from ema_prognostics.verdict.examination import Examination


def report(
    bags: Annotated[list[Path], typer.Argument(
        metavar="BAG...", help="The record, or several of one unit: the last one is reported, the "
        "others are its trend.")],
    out: Annotated[list[Path] | None, typer.Option(
        "--out", "-o", metavar="FILE.html|.xml|.json", show_default="BAG.html beside the bag",
        help="Report to write; repeatable.")] = None,
    ata: Annotated[str, typer.Option(metavar="TEXT", help="ATA chapter.", callback=one_line)] = "",
    aircraft: Annotated[str, typer.Option(
        metavar="TEXT", help="Registration.", callback=one_line)] = "",
    work_order: Annotated[str, typer.Option(
        metavar="TEXT", help="Its number.", callback=one_line)] = "",
    operator: Annotated[str, typer.Option(
        metavar="TEXT", help="Operator, station.", callback=one_line)] = "",
    profile: Commanded = None,
    model: Cascade = None,
    baseline: Baseline = None,
    as_json: Annotated[bool, typer.Option(
        "--json", help="Print the report's content as one JSON object.")] = False,
) -> int:
    """Write the report of a test: one page of A4 to print, sign and file.

    Unit, verdict, evidence, trend, checks with values and limits, and the SHA-256 of record, kit
    and software. The ending of FILE chooses: .html (prints on one page), .xml (in the manner of
    IEEE 1636.1), .json; all hold the same. What is not given (work order ...) is a line to write
    on. Exit status: that of the verdict, as of 'ema check'.

    Example: `ema report bags/sim_0001_extended --out SIM-0001.html`
    """
    from ema_cli.pages.report_files import form_of, write_report_file
    from ema_prognostics.trend.flights import possible_time
    from ema_prognostics.verdict.examination import examine
    from ema_prognostics.verdict.judge import Judge

    found = given_bags(bags)
    for file in out or ():
        form_of(file)
    check_apart(*(out or ()))
    check_new_file(*(out or ()))
    judge = Judge(model, baseline, profile=profile)
    with progress(f"judging {len(found)} bags", len(found)) as advance:
        tests = []
        for done, bag in enumerate(found, start=1):
            tests.append(examine(judge, bag))
            advance(done)
    last = newest(tests)
    for test in tests:
        if test.record is None:  # nothing says when it was made: it may be the newest
            kind = IncompleteRecordError if test.verdict.outcome == "incomplete" else UsageError
            other = "" if len(tests) == 1 else "; leave it out, or 'ema recover' it first"
            raise kind(f"no report: {test.verdict.reasons[0]}{other}")
        if len(tests) > 1 and not possible_time(test.record.provenance.start_time):
            raise UsageError(f"no report: {test.verdict.bag}: its date cannot be (of a clock that "
                             "was not set, or runs ahead): it may be the newest, give it alone or "
                             "leave it out")
    assert last.record is not None
    files = out or [Path(f"{last.verdict.bag}.html")]
    check_new_file(*files)
    data = content(tests, {"ata": ata, "aircraft": aircraft, "work_order": work_order,
                           "operator": operator})
    for file in files:
        write_report_file(file, data, last.record)
    if as_json:
        print_json(data)
    else:
        for file in files:
            say(str(file))
    if any(file.suffix == ".html" for file in files):
        note("print it from a browser: one page of A4")
    return last.verdict.exit_status


def newest(tests: Sequence[Examination]) -> Examination:
    """Return the test that is reported: the last in time, of equal times the last given."""
    return max(enumerate(tests), key=lambda one: (
        one[1].time.timestamp() if one[1].time else 0.0, one[0]))[1]


def content(tests: Sequence[Examination], fields: dict[str, str]) -> dict[str, Any]:
    """Return the content of the report; UsageError where the tests are of several units."""
    from ema_cli.pages.report_data import report_data

    last = newest(tests)
    units = sorted({t.serial_number for t in tests if t.serial_number})
    if len(units) > 1:
        raise UsageError(f"records of {len(units)} actuators ({', '.join(units[:5])}): a report "
                         "is of one, give the records of one unit")
    assert last.record is not None
    ordered = sorted(tests, key=lambda t: t.time.timestamp() if t.time else 0.0)
    trend = [
        {"record": Path(t.verdict.bag).name, "verdict": t.verdict.outcome,
         "start_time": t.heading()["start_time"],
         "faults": [fault.to_dict() for fault in t.verdict.faults]}
        for t in ordered
    ] if len(tests) > 1 else []
    return report_data(last.verdict.to_dict(), last.record, last.checks, heading=last.heading(),
                       fields=fields, trend=trend)
