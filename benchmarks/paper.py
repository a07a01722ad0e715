"""The paper's experiment: accuracies with the targets beside them, one command.

python -m benchmarks.paper
"""

from __future__ import annotations

import sys
import time

from ema_prognostics.paper.experiment import PaperSettings, run_experiment
from ema_prognostics.paper.report import paper_report


def main() -> int:
    """Print the table; exit status 1 if a target is missed."""
    begin = time.perf_counter()
    report = paper_report(run_experiment(PaperSettings()))
    print(f"{'network':28} {'columns':>7} {'start angles':>12} {'draws':>6} {'accuracy':>9} "
          f"{'worst level':>11} {'target':>7}  met")
    for a in report["accuracies"]:
        worst = min(v["accuracy"] for v in a["by_noise_level"].values())
        print(f"{a['network']:28} {a['columns'] or 2:7d} {a['start_angles']:>12} "
              f"{a['draws']:6d} {a['accuracy']:9.4f} {worst:11.4f} {a['target']:7.3f}  "
              f"{'yes' if a['met'] else 'no'}")
    statements = report["statements"]
    yes = sum(s["reproduced"] for s in statements)
    print(f"statements of section V reproduced: {yes} of {len(statements)}")
    print(f"{time.perf_counter() - begin:.0f} s")
    return 0 if report["met"] else 1


if __name__ == "__main__":
    sys.exit(main())
