"""`ema commission`: a kit from a description and acceptance records."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ema_cli.console import check_new, given_bags, note, print_json, progress_of, say
from ema_cli.options import TrainingJobs

if TYPE_CHECKING:
    from ema_record.record import Record


def commission(
    records: Annotated[list[Path], typer.Argument(
        metavar="RECORD...", help="Bags of healthy units, from their acceptance.")],
    actuator: Annotated[Path, typer.Option(
        "--actuator", metavar="FILE.yaml", help="Description of the type.")],
    out: Annotated[Path, typer.Option(
        "--out", "-o", metavar="KIT", help="Folder of the new kit.")],
    quick: Annotated[bool, typer.Option(
        "--quick", help="A small training, to try the way.")] = False,
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1, help="Of the training.")] = 1,
    jobs: TrainingJobs = -1,
    library: Annotated[bool | None, typer.Option(
        "--library/--no-library", show_default="made, but not with --quick",
        help="Make the library for 'ema identify' too; else it is made at its first use.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The validation as JSON.")] = False,
) -> int:
    """Make the kit of an actuator type from its description and records of healthy units.

    The model is corrected by the records, the cascade trained around it and validated. A kit that
    is not good enough is not made: too many false alarms, or the records do not fit the
    description. Then the library for 'ema identify' is made. A run that was stopped goes on where
    it was.

    Example: `ema commission acceptance/* --actuator aileron/actuator.yaml --out aileron_kit`
    """
    from ema_prognostics.commission.commission import commission as make
    from ema_prognostics.commission.report import percent
    from ema_prognostics.words import size
    from ema_record.kit import REPORT

    check_new(out)

    def make_library(
        given: Sequence[Record], folder: Path, step: Callable[[str, float], None]
    ) -> bool:
        from ema_identification.identify import build_library

        build_library(given, folder, whole=with_library, workers=jobs or -1, progress=step)
        return with_library

    with_library = not quick if library is None else library
    with progress_of("commissioning") as advance:
        found = make(given_bags(records), actuator, out, quick=quick, seed=seed, jobs=jobs or -1,
                     progress=advance, library=make_library)
    if as_json:
        print_json({"kit": str(out), **found})
        return 0
    views = found["held_out"][found["profile"]]
    say(f"{out}: kit of {len(found['units'])} units, test {found['profile']}")
    found_sizes: list[float | None] = []
    for view, title in (("fleet", "without a baseline"), ("baseline", "with a baseline")):
        one = views[view]
        say(f"  {title}: false alarms {percent(one['false alarms'])}, unknown "
            f"{percent(one['healthy called unknown'])}")
        smallest = {name: part["a90"] for name, part in one.items()
                    if isinstance(part, dict) and "a90" in part}
        found_sizes += smallest.values()
        say("    found in nine of ten: " + ", ".join(
            f"{name.replace('_', ' ')} {size(name, a90)}" for name, a90 in smallest.items()))
    if all(a90 is None for a90 in found_sizes):
        note("this kit finds no fault of any size in nine of ten tests: one of the units may be "
             "faulty, or they are too few to tell; give records of more healthy units"
             + (", without --quick" if quick else ""))
    if not found["library"]:
        note("no library for 'ema identify': it is made at its first use, in some minutes")
    note(f"{out / REPORT} says more; next: ema check RECORD --kit {out}")
    return 0
