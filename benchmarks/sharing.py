"""Runs of one record on several cores: ``python -m benchmarks.sharing`` (about a minute).

Runs of the extended profile with their features, as `ema identify` makes them: one after another,
in threads (`Runner`, what it uses) and on joblib's processes, which are warm. All three by turns
in one process; medians; every result must have the same bits.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from ema_identification.actuator.measure.features import feature_map
from ema_identification.actuator.measure.runs import Case, Runner, run_cases
from ema_identification.actuator.measure.tolerances import N_TOLERANCES, Conditions
from ema_record.profile import load_profile
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=2, help="threads and processes")
    parser.add_argument("--runs", type=int, default=48, help="runs shared at a time")
    parser.add_argument("--repeats", type=int, default=9)
    given = parser.parse_args()
    model, profile = load_model_file(), load_profile("extended")
    fmap = feature_map(profile, model.actuator, simulate(profile, actuator=model.actuator))
    rng = np.random.default_rng(0)
    cases = [Case(z=rng.uniform(-1.0, 1.0, N_TOLERANCES), conditions=Conditions(), seed=k)
             for k in range(given.runs)]
    threads = Runner(given.workers)
    ways: dict[str, Callable[[], np.ndarray]] = {
        "one after another": lambda: Runner().run(model, cases, fmap),
        f"{given.workers} threads": lambda: threads.run(model, cases, fmap),
        f"{given.workers} processes of joblib": lambda: run_cases(
            model, cases, fmap, workers=given.workers),
    }
    took: dict[str, list[float]] = {name: [] for name in ways}
    with threadpool_limits(limits=1):
        results = [way() for way in ways.values()]  # also warms up
        for _ in range(given.repeats):
            for name, way in ways.items():
                begin = time.perf_counter()
                way()
                took[name].append(time.perf_counter() - begin)
    table = Table("how", "ms a run", "times as fast",
                  title=f"{given.runs} runs, extended profile")
    alone = statistics.median(took["one after another"])
    for name, times in took.items():
        middle = statistics.median(times)
        table.add_row(name, f"{1e3 * middle / given.runs:.1f}", f"{alone / middle:.2f}")
    Console().print(table)
    if not all(np.array_equal(result, results[0]) for result in results):
        raise SystemExit("the results differ")


if __name__ == "__main__":
    main()
