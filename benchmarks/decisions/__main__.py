"""The decision of `ema identify` in its own world and outside: ``python -m benchmarks.decisions``.

The panel is declared before it is run: `--seed`, `--each` and `--nothing`, the units of each of
`STRATA`. One line a unit is kept, nothing is done twice, and `--table` prints what there is: a
panel that is cut short has as many units of each stratum, in the order of their numbers. Strata of
accepted units ask what has changed since their acceptance (`--baseline`). Strata of another drive
are of a described machine with a carrier (`benchmarks.any_actuator`), whose kit is made once, with
the libraries of the tests, in `--out`. With `--next` the test that is proposed for a set of names
is recorded on the same unit, and both records are identified together. `--visible` says which of
the units with one effect, of the default kit, can be seen at all (`visible`).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from joblib import Parallel, delayed

from benchmarks.blind_panel.truth.visible import Floor
from benchmarks.decisions.judging import Row, answered, answered_again, is_set, make_kit
from benchmarks.decisions.table import markdown, numbers, seconds, sizes, table
from benchmarks.decisions.units import STRATA, kit_of
from benchmarks.decisions.visible import gap_of, make_floor, visible_table
from benchmarks.ledger import Ledger
from ema_record.errors import EmaError
from ema_record.profile import load_profile


def main() -> None:
    """Run what is missing, print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
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
                        help="which units with one effect can be seen, of the default kit")
    parser.add_argument("--table", action="store_true", help="run nothing")
    given = parser.parse_args()
    tests = tuple(given.tests.split(","))
    try:
        for test in tests:
            load_profile(test)
    except EmaError as error:
        parser.error(str(error))
    given.out.mkdir(parents=True, exist_ok=True)
    ledger = Ledger(given.out / "decisions.jsonl")
    counts = {stratum: given.each if given.nothing is None or not stratum.endswith("nothing")
              else given.nothing for stratum in STRATA if stratum.startswith(given.strata)}
    if not counts:
        parser.error(f"--strata {given.strata!r}: none begins so, there are {', '.join(STRATA)}")
    if not given.table:
        run(given.out, ledger, given.seed, counts, tests, given.workers)
    rows: dict[str, list[Row]] = {stratum: [] for stratum in counts}
    again: dict[str, list[tuple[Row, Row | None]]] = {stratum: [] for stratum in counts}
    for key, stratum, k in units_of(given.seed, counts, given.tests):
        if key not in ledger.keys:
            continue
        row = ledger.run(key, dict)
        rows[stratum].append(row)
        if "accepted" in stratum or not is_set(row):
            continue
        then = f"{key}/next"
        if given.next and not given.table and row["next"] and then not in ledger.keys:
            second = ledger.run(then, partial(
                answered_again, STRATA[stratum](given.seed, k, tests), given.out,
                row["next"]))
            print(then, row["next"], second["verdict"], second["named"], flush=True)
        again[stratum].append((row, ledger.run(then, dict) if then in ledger.keys else None))
    rows = {stratum: found for stratum, found in rows.items() if found}
    for part in (table(rows), numbers(rows, again), sizes(rows), seconds(rows)):
        print(f"\n{part}")
    if given.visible:
        print(f"\n{_visible(rows, ledger, given.out, given.seed, tests)}")


def units_of(seed: int, counts: Mapping[str, int], tests: str) -> Iterator[tuple[str, str, int]]:
    """Yield key, stratum and number of each unit, the first ones of all strata first."""
    for k in range(max(counts.values(), default=0)):
        for stratum, count in counts.items():
            if k < count:
                yield f"{seed}/{tests}/{stratum}/{k}/sizes", stratum, k


def run(out: Path, ledger: Ledger, seed: int, counts: Mapping[str, int], tests: tuple[str, ...],
        workers: int) -> None:
    """Judge what is missing, `workers` units at a time, each on one core."""
    todo = [unit for unit in units_of(seed, counts, ",".join(tests)) if unit[0] not in ledger.keys]
    with Parallel(n_jobs=workers, return_as="generator_unordered") as parallel:
        for _ in parallel(delayed(make_kit)(kit, out, tests) for kit in
                          {kit_of(stratum) for _, stratum, _ in todo} - {None}):
            pass
        for key, row in parallel(delayed(_judged)(*unit, seed, out, tests) for unit in todo):
            ledger.run(key, partial(dict, row))
            print(key, row["names"], row["verdict"], row["named"], flush=True)


def _judged(key: str, stratum: str, k: int, seed: int, out: Path, tests: tuple[str, ...]
            ) -> tuple[str, Row]:
    return key, answered(STRATA[stratum](seed, k, tests), out)


def _gap(stratum: str, seed: int, k: int, tests: tuple[str, ...], floor: Floor
         ) -> tuple[float, str]:
    return gap_of(STRATA[stratum](seed, k, tests), floor)


def _visible(rows: Mapping[str, Sequence[Row]], ledger: Ledger, out: Path, seed: int,
             tests: tuple[str, ...]) -> str:
    """Return the table of what is visible, by units that are made once more."""
    floor = make_floor(out / f"floor_{tests[0]}.npz", tests[0])
    found = []
    for stratum in rows:
        if not stratum.endswith(", one effect") or not stratum.startswith(("own", "second")):
            continue
        for k, row in enumerate(rows[stratum]):
            gap, _ = ledger.run(f"{seed}/{','.join(tests)}/{stratum}/{k}/visible", partial(
                _gap, stratum, seed, k, tests, floor))
            found.append((stratum, row, float(gap)))
    return markdown(("stratum", "units", "visible", "right of these", "not right, gap, outcome"),
                    visible_table(found))


if __name__ == "__main__":
    main()
