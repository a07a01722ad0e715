"""Any actuator: the product judged on a second simulator.

    python -m benchmarks.any_actuator default --work WORK      # the shipped kit, its own actuator
    python -m benchmarks.any_actuator make --work WORK         # acceptance records of six machines
    python -m benchmarks.any_actuator commission --work WORK   # their kits
    python -m benchmarks.any_actuator judge --work WORK        # verdicts
    python -m benchmarks.any_actuator table --work WORK        # rates with bounds, peers

What is done is kept in ``--work`` and not done again.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.any_actuator.cases import TEST, Counts, draw_cases, sizes_of
from benchmarks.any_actuator.judging import folder_key, judge_cases
from benchmarks.any_actuator.table import markdown, outcomes, why_unknown
from benchmarks.ledger import Ledger
from ema_prognostics.verdict.judge import Judge
from ema_record.actuator import load_actuator
from ema_record.kit import CASCADE, kit_folder, using_kit
from ema_record.profile import load_profile
from ema_record.spread import load_spread

SEED = 880_017
DEFAULT = Counts(units=200, healthy=200, each_fault=20, strangers=24, sensor_faults=20)


def _progress(name: str, started: float, every: int = 50) -> Callable[[int, int], None]:
    def say(done: int, of: int) -> None:
        if done % every == 0 or done == of:
            print(f"  [{time.monotonic() - started:5.0f} s] {name}: {done} of {of}",
                  file=sys.stderr, flush=True)
    return say


def default(options: argparse.Namespace) -> None:
    """Judge the shipped kit, or `--kit`, on the second simulator's units of its actuator."""
    with using_kit(options.kit):
        a, spread, profile = load_actuator(), load_spread(), load_profile(options.profile)
        kit = kit_folder()
        counts = Counts(*(max(1, round(options.part * n)) for n in DEFAULT))
        cases = draw_cases(a, spread, counts, sizes_of(a, kit), seed=options.seed, fleet=TEST,
                           duration=profile.duration, own=options.own)
        if options.only:
            cases = [c for c in cases if c.group in options.only]
        name = f"{options.profile}/{options.seed}/{int(options.own)}/{options.part}"
        rows = judge_cases(
            cases, profile, Judge(),
            Ledger(options.work / f"default-{folder_key(kit / CASCADE)}.jsonl"), name,
            _progress("default", time.monotonic()))
    print(markdown({"default kit": rows}))
    print("\n" + outcomes(rows))
    print("\nwhy healthy records are not judged:\n" + why_unknown(rows))


def main() -> None:
    """Run one stage."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("stage", choices=["default"])
    parser.add_argument("--work", type=Path, default=Path("any-actuator-work"))
    parser.add_argument("--kit", type=Path, default=None, help="default: the shipped one")
    parser.add_argument("--profile", default="extended")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--part", type=float, default=1.0, help="of the fleet")
    parser.add_argument("--own", action="store_true",
                        help="default: units have the second simulator's own effects too")
    parser.add_argument("--only", nargs="*", default=(), help="groups, e.g. healthy")
    options = parser.parse_args()
    {"default": default}[options.stage](options)


if __name__ == "__main__":
    main()
