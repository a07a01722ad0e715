"""The decision of `ema identify` on a blind panel: ``python -m benchmarks.blind_panel``.

The panel is declared before it is run: `--seed`, `--each` and `--nothing`, the units of each of
the strata. What is hidden is drawn and sealed, its SHA-256 printed; a process that cannot open the
answers identifies (`run`); then they are opened, checked and judged. One line a unit is kept,
nothing is done twice: the same command goes on after an interruption, and `--table` prints what
there is. With `--next` the test that is proposed for a set of names is recorded on the same unit,
and both records are identified together.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.blind_panel.score import score
from benchmarks.blind_panel.truth.answers import Panel
from benchmarks.blind_panel.truth.prepare import prepare, record_proposed
from benchmarks.blind_panel.truth.units import STRATA
from ema_record.errors import EmaError
from ema_record.profile import load_profile

ROOT = Path(__file__).resolve().parents[2]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run what is missing, print the tables."""
    parser = argparse.ArgumentParser(prog="benchmarks.blind_panel",
                                     description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--each", type=int, required=True, help="units of each stratum")
    parser.add_argument("--nothing", type=int, default=None,
                        help="units of each stratum with nothing hidden, default as --each")
    parser.add_argument("--tests", default="extended,step",
                        help="profile of the record, and of the held-out one if there is one")
    parser.add_argument("--strata", default="", help="only those that begin with this")
    parser.add_argument("--workers", type=int, default=1, help="units at a time")
    parser.add_argument("--next", action="store_true",
                        help="record the test that is proposed for a set, identify with both")
    parser.add_argument("--visible", action="store_true",
                        help="in which units with one effect, or two, each can be seen")
    parser.add_argument("--table", action="store_true", help="run nothing")
    given = parser.parse_args(arguments)
    counts = {stratum: given.each if given.nothing is None or not stratum.endswith("nothing")
              else given.nothing for stratum in STRATA if stratum.startswith(given.strata)}
    if not counts:
        parser.error(f"--strata {given.strata!r}: none begins so, there are {', '.join(STRATA)}")
    panel = Panel(given.seed, tuple(given.tests.split(",")), counts)
    try:
        for test in panel.tests:
            load_profile(test)
        if not given.table:
            run(given.out, panel, given.workers, proposed=given.next)
        score(given.out, panel, visible=given.visible)
    except EmaError as error:
        parser.exit(2, f"{parser.prog}: error: {error}\n")


def run(out: Path, panel: Panel, workers: int, *, proposed: bool = False) -> None:
    """Seal, record and identify what is missing.

    `proposed` : also with the test that is proposed for a set of names.
    """
    prepare(out, panel, workers)
    _identify(out, workers)
    if proposed:
        record_proposed(out, panel)
        _identify(out, workers, "--next")


def _identify(out: Path, workers: int, *more: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.blind_panel.run", "--out", str(out.resolve()),
         "--workers", str(workers), *more], check=False, cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"})
    if done.returncode != 0:
        raise SystemExit(done.returncode)


if __name__ == "__main__":
    main()
