"""Peers on the panel of `benchmarks.blind_panel`: ``python -m benchmarks.peers``.

The same units, records, columns and judgement; a panel is declared by `--seed` and `--each`
before it is run. Runs in an environment that has `requirements.txt` too; a peer whose package is
absent is skipped. Peers read the first record of a unit. One line a unit is kept, nothing is
done twice.
"""

from __future__ import annotations

import argparse
import time
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from benchmarks.blind_panel.table import table
from benchmarks.blind_panel.truth.units import STRATA, HiddenUnit, own_unit, second_unit
from benchmarks.ledger import Ledger
from benchmarks.peers.methods import METHODS, Method, Scores, limits
from benchmarks.peers.ports import Problem, problems_of

HEALTHY_SEED = 550_018
"""Of the units on which limits are found: not a seed of a panel."""
NOT_RUN = "nullbic: skipped, version 0.1.0 on PyPI is one wheel, for Windows only"


@lru_cache(maxsize=1)
def healthy(k: int, test: str) -> list[Problem]:
    """Return the `k`-th unit without effect: ours and the second simulator's in turn."""
    return problems_of((own_unit, second_unit)[k % 2](HEALTHY_SEED, k, (test,)).records[0])


def healthy_scores(k: int, method: Method, test: str) -> Scores:
    """Return a peer's scores of the `k`-th unit without effect."""
    found: Scores = {}
    for problem in healthy(k, test):
        found |= method.scores(problem)
    return found


def sets_of(columns: list[str]) -> list[list[str]]:
    """Return one set of names an effect: sets of columns with a name in common are one."""
    found: list[set[str]] = []
    for column in columns:
        names = {law.partition(".")[0] for law in column.split("|")}
        for known in found:
            if known & names:
                known.intersection_update(names)
                break
        else:
            found.append(names)
    return [sorted(names) for names in found]


def answered(unit: HiddenUnit, problems: list[Problem], prepared: float, method: Method,
             limit: Scores) -> dict[str, Any]:
    """Return what a peer says of a unit, in the form of `benchmarks.blind_panel`."""
    started = time.process_time()
    columns, other = method.answer(problems, limit)
    verdict = "explained" if columns else "unknown effect" if other else "no disagreement"
    return {"names": unit.names, "strange": bool(unit.without), "verdict": verdict,
            "named": sets_of(columns), "columns": columns,
            "seconds": time.process_time() - started + prepared}


def main() -> None:
    """Run what is missing, print a table a peer."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--each", type=int, required=True, help="units of each stratum")
    parser.add_argument("--tests", default="extended,step", help="as of benchmarks.blind_panel")
    parser.add_argument("--strata", default="", help="only those that begin with this")
    parser.add_argument("--peers", default="", help="only those that begin with one of these")
    parser.add_argument("--healthy", type=int, default=500,
                        help="units on which limits are found: one in as many goes beyond each")
    parser.add_argument("--table", action="store_true", help="run nothing")
    given = parser.parse_args()
    tests = tuple(given.tests.split(","))
    ledger = Ledger(given.out / "peers.jsonl")
    strata = [s for s in STRATA if s.startswith(given.strata) and "accepted" not in s]
    print(NOT_RUN)
    present = {}
    for name, method in METHODS.items():
        if method.absent and not given.table:
            print(f"{name}: skipped, {method.package} is not installed "
                  "(benchmarks/peers/requirements.txt)")
        else:
            present[name] = method
    running = {name: method for name, method in present.items()
               if name.startswith(tuple(given.peers.split(",")))}

    @lru_cache(maxsize=1)
    def prepared(stratum: str, k: int) -> tuple[HiddenUnit, list[Problem], float]:
        unit = STRATA[stratum](given.seed, k, tests)
        started = time.process_time()
        return (unit, problems_of(unit.records[0], unit.without), time.process_time() - started)

    scores: dict[str, list[Scores]] = {name: [] for name in present}
    for k in range(0 if given.table else given.healthy):
        for name, method in present.items():
            scores[name].append(ledger.run(f"healthy/{tests[0]}/{name}/{k}",
                                           partial(healthy_scores, k, method, tests[0])))
    limit = {name: limits(found) for name, found in scores.items() if found}
    rows: dict[str, dict[str, list[dict[str, Any]]]] = {
        name: {stratum: [] for stratum in strata} for name in running}
    for k in range(given.each):
        for stratum in strata:
            for name, method in running.items():
                key = f"{given.seed}/{given.tests}/{given.healthy}/{stratum}/{k}/{name}"
                if key not in ledger.keys:
                    if given.table:
                        continue
                    unit, problems, seconds = prepared(stratum, k)
                    row = ledger.run(key, partial(
                        answered, unit, problems, seconds, method, limit[name]))
                    print(key, row["names"], row["verdict"], row["named"], flush=True)
                rows[name][stratum].append(ledger.run(key, dict))
    for name, found in rows.items():
        print(f"\n{name}\n\n{table({key: some for key, some in found.items() if some})}")


if __name__ == "__main__":
    main()
