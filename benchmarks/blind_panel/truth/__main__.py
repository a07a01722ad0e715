"""The truth program: ``python -m benchmarks.blind_panel.truth --out DIR [--part N/M]``.

Draws all cases and seals the answers at the first call, prints the commitment, then makes the
bags of a part. A second call goes on where the first one ended. ``--next`` makes the records
of the tests that the workflow proposed, on the same units.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from benchmarks.blind_panel.layout import RESULTS, SEALED, TESTS, add_common, part_of
from benchmarks.blind_panel.tasks import TASKS, Task, share, write_tasks
from benchmarks.blind_panel.truth.alike import SEED as ALIKE_SEED
from benchmarks.blind_panel.truth.alike import draw_alike
from benchmarks.blind_panel.truth.bags import make_bags, make_next_bag
from benchmarks.blind_panel.truth.cases import DEFAULT_SEED, Case, draw_cases
from benchmarks.blind_panel.truth.seal import COMMITMENT, commitment_of, seal, unseal
from ema_cli.console import track
from ema_record.profile import load_profile_dict

STRATA = {"all": (draw_cases, DEFAULT_SEED), "alike": (draw_alike, ALIKE_SEED)}
"""How the cases of a panel are drawn, and its default seed."""


def _make(case: Case, folder: Path) -> None:
    with threadpool_limits(limits=1):
        make_bags(case, folder)


def prepare(out: Path, seed: int | None = None, stratum: str = "all") -> str:
    """Seal the answers of a new panel; return the commitment of a new or an old one."""
    draw, default = STRATA[stratum]
    sealed = out / SEALED
    if not (sealed / COMMITMENT).exists():
        seal(draw(default if seed is None else seed), sealed)
    if not (out / TASKS).exists():
        write_tasks([Task(id=c.id, without=c.without) for c in unseal(sealed)], out)
    return commitment_of(sealed)


def make(
    out: Path, part: tuple[int, int], *, workers: int = 1, seed: int | None = None,
    stratum: str = "all",
) -> None:
    """Make the bags of a part."""
    print(f"answers sealed, SHA-256 {prepare(out, seed, stratum)}", flush=True)
    tests = out / TESTS
    tests.mkdir(parents=True, exist_ok=True)
    todo = [c for c in share(unseal(out / SEALED), part) if not (tests / c.id).exists()]
    done = Parallel(n_jobs=workers, return_as="generator")(delayed(_make)(c, tests) for c in todo)
    for _ in track(done, "bags", len(todo)):
        pass
    print(f"part {part[0]}/{part[1]}: {len(todo)} units made, bags in {tests}")


def make_next(out: Path, part: tuple[int, int]) -> None:
    """Make the records of the proposed tests."""
    made = 0
    for case in track(share(unseal(out / SEALED), part), "next tests", 1):
        result = out / RESULTS / f"{case.id}.json"
        if not result.exists():
            continue
        found = json.loads(result.read_text(encoding="utf-8"))
        if found["next_profile"]:
            profile = load_profile_dict(found["next_profile"], f"{case.id}: next test")
            make_next_bag(case, profile, out / TESTS)
            made += 1
    print(f"part {part[0]}/{part[1]}: {made} proposed tests recorded")


def main() -> None:
    """Read the command line and make the bags."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_common(parser)
    parser.add_argument("--seed", type=int, default=None, help="of a new panel")
    parser.add_argument("--stratum", choices=list(STRATA), default="all",
                        help="of a new panel: alike has look-alikes on the short test only")
    parser.add_argument("--next", action="store_true", help="record the proposed tests")
    given = parser.parse_args()
    if given.next:
        make_next(given.out, part_of(given.part))
        return
    make(given.out, part_of(given.part), workers=given.workers, seed=given.seed,
         stratum=given.stratum)


if __name__ == "__main__":
    main()
