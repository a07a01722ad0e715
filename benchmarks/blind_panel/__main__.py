"""The whole panel: ``python -m benchmarks.blind_panel [--out DIR] [--part N/M] [--workers N]``.

Truth, runs, proposed tests and scores, each a program of its own; what is done is not
done again, so the same command goes on after an interruption. See README.md here.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys

from benchmarks.blind_panel.layout import add_common


def _run(program: str, *arguments: str) -> None:
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", f"benchmarks.blind_panel.{program}", *arguments],
        check=False, env=environment)
    if done.returncode != 0:
        raise SystemExit(done.returncode)


def main() -> None:
    """Read the command line and run all programs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_common(parser)
    parser.add_argument("--seed", default=None, help="of a new panel that nobody has seen")
    parser.add_argument("--stratum", choices=["all", "alike"], default="all",
                        help="of a new panel: alike has look-alikes on the short test only")
    parser.add_argument("--records", nargs="*", default=[], help="only these units")
    given = parser.parse_args()
    common = ["--out", str(given.out), "--part", given.part]
    workers = ["--workers", str(given.workers)]
    chosen = ["--records", *given.records] if given.records else []
    new = ["--stratum", given.stratum, *(["--seed", given.seed] if given.seed else [])]
    _run("truth", *common, *workers, *new)
    _run("run", *common, *workers, *chosen)
    _run("truth", *common, "--next")
    _run("run", *common, *workers, "--next", *chosen)
    _run("score", *common, *workers, "--mistakes")


if __name__ == "__main__":
    main()
