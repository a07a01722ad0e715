"""`ema identify`: what a model lacks, with evidence, and the model with it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ema_cli.console import (
    check_new,
    given_bags,
    note,
    print_json,
    progress_of,
    say,
    stdout,
    styled,
)
from ema_record.errors import IncompleteRecordError, InvalidRecordError, UsageError

if TYPE_CHECKING:
    from ema_identification.result import Identification, Parameter


@contextlib.contextmanager
def _usable() -> Iterator[None]:
    """Make a record that is too short to answer unusable data: status 3 is for an answer."""
    try:
        yield
    except IncompleteRecordError as error:
        raise InvalidRecordError(str(error)) from error


@_usable()
def identify(
    measured: Annotated[list[Path], typer.Argument(
        metavar="MEASURED...", help="Records of one unit: bags, directories of them, or what "
        "'ema import' made of a rig's data.")],
    out: Annotated[Path | None, typer.Option(
        "--out", "-o", metavar="DIR",
        help="Directory to make: report.html, plots, JSON, model. Needed, but for "
        "--check.")] = None,
    validate: Annotated[list[Path] | None, typer.Option(
        metavar="BAG", help="A record of the same unit that takes no part in the fit, of another "
        "command; repeatable.")] = None,
    baseline: Annotated[list[Path] | None, typer.Option(
        metavar="BAG", help="A record of the same unit and test from when it was accepted; "
        "repeatable. What has changed since is said too.")] = None,
    model: Annotated[Path | None, typer.Option(
        metavar="FILE.yaml", help="The model: changes over the kit's actuator; of a rig the whole."
    )] = None,
    without: Annotated[list[str] | None, typer.Option(
        metavar="NAME", help="An effect of the catalogue to leave out; repeatable.")] = None,
    profile: Annotated[str | None, typer.Option(
        "--profile", "-p", metavar="NAME|FILE.yaml",
        help="The test that was commanded, in place of the bags' own.")] = None,
    workers: Annotated[int, typer.Option(
        min=1, max=256,
        help="Simulations that run at a time; their number does not change the answer."
    )] = 2,
    seed: Annotated[int, typer.Option(
        min=0, max=2**31 - 1, help="Of all simulations; the same seed, the same answer.")] = 0,
    check: Annotated[bool, typer.Option(
        "--check", help="Of a rig: only say what the records can show, and which motion would "
        "show the rest; nothing is fitted.")] = False,
    json: Annotated[bool, typer.Option("--json", help="The result as one JSON object.")] = False,
) -> int:
    """Say what a model lacks to explain records, and add it.

    Known parameters are recalibrated within their tolerances first; only what is left can be a
    missing effect. The report says where the records disagree, what was tried, what cannot be
    told apart and which test would, and shows the gap before and after: on held-out data where
    --validate gives them. These take no part in any choice; a gap that grows there contradicts it.

    The first run with a model and a profile simulates their library (some minutes); it is kept in
    the user's cache directory. The default kit has those of step and extended.

    Exit status: 0 no disagreement or explained, 3 partly explained, unknown or contradicted by the
    held-out records, 2 wrong use or data that cannot be used.

    Example: `ema identify bags/sim_0004_extended --out report`
    """
    from ema_identification.identify import identify as run
    from ema_identification.report.write import write_answer, write_page
    from ema_record.kit import kit_name
    from ema_record.record import Record
    from ema_rig.bag import read_any

    measured = given_bags(measured)
    if check:
        given = {"--out": out, "--validate": validate, "--baseline": baseline,
                 "--without": without, "--profile": profile}
        if unused := next((name for name, value in given.items() if value), ""):
            raise UsageError(f"{unused} with --check, which fits nothing: leave one of them out")
        return _check([read_any(path) for path in measured], model, json)
    if out is None:
        raise UsageError("no --out: give the directory to make, as --out report")
    check_new(out)
    records = [read_any(path, profile) for path in measured]
    if profile is not None and not isinstance(records[0], Record):
        raise UsageError(f"--profile {profile}: of the actuator's own test: a rig has none, leave "
                         "it out")
    held = [read_any(path) for path in (given_bags(validate) if validate else ())]
    accepted = [read_any(path) for path in (given_bags(baseline) if baseline else ())]
    with progress_of("identify") as advance:
        shown: list[str] = []

        def step(what: str, share: float) -> None:
            if what not in shown:
                shown.append(what)
                if what.startswith("library of"):
                    note(f"simulating the {what}; kept in the cache directory for the next time")
            advance(what, share)

        found = run(records, model, validate=held, baseline=accepted, without=without or (),
                    progress=step, workers=workers, seed=seed)
    inputs = {
        "measured": [str(p) for p in measured],
        "model": [kit_name() if model is None else str(model)],
        **{name: list(map(str, given)) for name, given in (
            ("validate", validate), ("baseline", baseline), ("without", without)) if given},
    }
    if profile:
        inputs["profile"] = [profile]
    found = write_answer(found, out)
    if json:
        print_json(found.to_dict())
    else:
        _print(found)
    page = write_page(found, out, title=_title(records[0], measured[0]), inputs=inputs)
    for name, why in page.not_drawn.items():
        note(f"the picture {name} could not be drawn ({why}); the numbers are complete")
    if not json:
        stdout().print(f"report: {page.path}")
    return found.exit_status


def _check(records: list[Any], model: Path | None, json: bool) -> int:
    """Print what records of a rig can show."""
    from ema_identification.rig.workflow import check_rig
    from ema_rig.record import RigRecord

    if not all(isinstance(record, RigRecord) for record in records):
        raise UsageError("--check is for records of a rig; those of the actuator are checked by "
                         "'ema check'")
    found = check_rig(records, model)
    if json:
        print_json(found.to_dict())
    else:
        for line in found.lines:
            say(line)
    return 0


def _title(record: Any, path: Path) -> str:
    provenance = getattr(record, "provenance", None)
    serial = getattr(provenance, "known_serial", "")
    return f"{serial}: {path.name}" if serial else path.name


def _value(p: Parameter) -> str:
    """Return a parameter with its unit and interval."""
    unit = "" if p.unit == "1" else f" {p.unit}"
    return f"{p.name} = {p.value:.4g}{unit}  (90 %: {p.low:.4g} to {p.high:.4g})"


def _print(found: Identification) -> None:
    """Print the answer for people."""
    from ema_identification.report.words import probability

    console = stdout()
    console.print(styled((found.verdict, "bold")))
    grew = found.verdict == "contradicted" and found.gap_after > found.gap_before
    gap = f"grew from {found.gap_before:.3g} to {found.gap_after:.3g}" if grew else (
        f"{found.gap_before:.3g} before, {found.gap_after:.3g} after")
    console.print(f"gap {gap}, floor {found.noise_floor:.3g}: {found.gap_unit}")
    if found.unexplained is not None:
        left = min(100.0 * found.unexplained, 100.0)
        console.print(f"{100.0 - left:.1f} % of the input is explained, {left:.1f} % left (rms)")
        for p in found.recalibrated:
            console.print(f"  {_value(p)}")
    for finding in found.findings:
        names = " or ".join((finding.effect, *finding.equivalent))
        console.print(styled("  ", (names, "bold"), f"  (p {probability(finding.p_value)})"))
        for name, choice in finding.choices.items():
            console.print(f"    {name} = {choice}")
        for p in finding.parameters:
            console.print(f"    {_value(p)}")
        console.print(f"    where: {finding.where.text}")
    if found.unknown is not None:
        console.print(f"  unknown: {found.unknown.text}")
    for reason in found.reasons:
        console.print(f"  {reason}")
    if found.next_test is not None:
        console.print(f"  next test: {found.next_test}")
    if found.since is not None:
        console.print(styled(("since the baseline", "bold")))
        _print(found.since)
