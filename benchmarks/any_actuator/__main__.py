"""Any actuator: the product judged on a second simulator.

    python -m benchmarks.any_actuator default      # a kit on units of its own actuator
    python -m benchmarks.any_actuator all          # six machines: the four stages below

    make        8 acceptance records of 4 units a machine
    commission  their kits
    judge       100 healthy tests, 20 of each fault at twice the kit's own a90, 20 strangers,
                20 sensor faults of 20 other units a machine
    table       rates with exact bounds, the peer beside them

What is done is kept in ``--work`` and not done again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.any_actuator import stages

SEED = 880_017
STAGES = ("make", "commission", "judge", "table")


def main() -> None:
    """Run one stage, or all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("stage", choices=["default", "all", *STAGES])
    parser.add_argument("--work", type=Path, default=Path("any-actuator-work"))
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--part", type=float, default=1.0, help="of the fleet")
    parser.add_argument("--jobs", type=int, default=2)
    one = parser.add_argument_group("default")
    one.add_argument("--kit", type=Path, default=None, help="default: the shipped one")
    one.add_argument("--profile", default="extended")
    one.add_argument("--own", action="store_true",
                     help="units have the second simulator's own effects too")
    one.add_argument("--only", nargs="*", default=(), help="groups, e.g. healthy")
    six = parser.add_argument_group("the six machines")
    six.add_argument("--machine", nargs="*", default=(), help="some of them")
    six.add_argument("--quick", action="store_true", help="kits of a small training")
    six.add_argument("--exact", action="store_true",
                     help="the machines are as described; default: off, as data sheets are")
    six.add_argument("--commutation-latency", type=float, default=0.0,
                     help="of the machines, in control periods; no description says so")
    six.add_argument("--times", type=float, default=2.0, help="severities, in the kit's own a90")
    six.add_argument("--no-peer", dest="peer", action="store_false")
    six.add_argument("--peer-units", type=int, default=400)
    options = parser.parse_args()
    for stage in STAGES if options.stage == "all" else (options.stage,):
        getattr(stages, stage)(options)


if __name__ == "__main__":
    main()
