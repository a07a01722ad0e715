"""The truth program: ``python -m benchmarks.blind_panel.truth --out DIR [--part N/M]``.

Draws all cases and seals the answers at the first call, prints the commitment, then makes the
bags of a part. A second call goes on where the first one ended.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from benchmarks.blind_panel.layout import SEALED, TESTS, add_common, part_of
from benchmarks.blind_panel.truth.bags import make_bags, shares
from benchmarks.blind_panel.truth.cases import DEFAULT_SEED, Case, draw_cases
from benchmarks.blind_panel.truth.seal import COMMITMENT, commitment_of, seal, unseal
from ema_cli.console import track


def _make(case: Case, folder: Path) -> None:
    with threadpool_limits(limits=1):
        make_bags(case, folder)


def prepare(out: Path, seed: int) -> str:
    """Seal the answers of a new panel; return the commitment of a new or an old one."""
    sealed = out / SEALED
    if (sealed / COMMITMENT).exists():
        return commitment_of(sealed)
    return seal(draw_cases(seed), sealed)


def make(out: Path, part: tuple[int, int], *, workers: int = 1, seed: int = DEFAULT_SEED) -> None:
    """Make the bags of a part."""
    print(f"answers sealed, SHA-256 {prepare(out, seed)}", flush=True)
    tests = out / TESTS
    tests.mkdir(parents=True, exist_ok=True)
    todo = [c for c in shares(unseal(out / SEALED), part) if not (tests / c.id).exists()]
    done = Parallel(n_jobs=workers, return_as="generator")(delayed(_make)(c, tests) for c in todo)
    for _ in track(done, "bags", len(todo)):
        pass
    print(f"part {part[0]}/{part[1]}: {len(todo)} units made, bags in {tests}")


def main() -> None:
    """Read the command line and make the bags."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_common(parser)
    parser.add_argument("--seed", type=int, default=DEFAULT_SEED, help="of a new panel")
    given = parser.parse_args()
    make(given.out, part_of(given.part), workers=given.workers, seed=given.seed)


if __name__ == "__main__":
    main()
