"""Speed and truth of the kernel, one table: ``python -m benchmarks.kernel`` (about 3 minutes).

Speed: simulated seconds a wall second on one core, extended profile, 20 kHz, all effects
compiled in and neutral, warm. Truth: the 2 f_e line of the speed (turn short of 10 %, step
profile, mean over start angles) against the fixed-step reference at 0.1 µs.
"""

from __future__ import annotations

import argparse
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import numpy as np
from rich.console import Console
from rich.table import Table

from ema_record.profile import load_profile, step_profile
from ema_record.record import Record
from ema_sim.effects import parse_effects
from ema_sim.plant.kernel import MAX_STEP
from ema_sim.simulate import simulate_traced
from support.reference import STEP, simulate_reference

STEPS = (MAX_STEP, 10e-6, 5e-6, 2e-6)
SHORT = ["turn_short.fraction=0.1"]
WINDOW = (0.082, 0.382)

START = """
import time
begin = time.perf_counter()
from ema_record.profile import step_profile
from ema_sim.simulate import simulate
imported, used = time.perf_counter(), time.process_time()
simulate(step_profile(0.01, start=0.0, duration=0.03))
print(imported - begin, time.perf_counter() - imported, time.process_time() - used)
"""

PYTHON_LOOP = """
import time
from ema_record.profile import Profile
from support.reference import simulate_reference
profile = Profile(name="piece", points=((0.0, 0.0), (0.005, 0.01)), inverter_off=0.0)
begin = time.perf_counter()
simulate_reference(profile, step=1e-6)
print(0.005 / (time.perf_counter() - begin))
"""


def two_fe(record: Record) -> complex:
    """Return the complex line of the speed at twice the electrical frequency (rad/s)."""
    keep = (record.time > WINDOW[0]) & (record.time < WINDOW[1])
    theta = np.unwrap(record.channel("rotor_angle")[keep])
    drift = np.linspace(-1.0, 1.0, len(theta))
    columns = [np.ones_like(theta), drift, drift**2]
    for h in range(1, 7):
        columns += [np.cos(h * theta), np.sin(h * theta)]
    fit = np.linalg.lstsq(np.stack(columns, axis=1), record.channel("motor_speed")[keep],
                          rcond=None)[0]
    return complex(fit[5], -fit[6])


def speed(run: Callable[[], object], simulated: float, repeats: int) -> tuple[str, str]:
    """Return simulated seconds a second of wall and of processor time, medians, as text."""
    run()
    wall, processor = [], []
    for _ in range(repeats):
        begin, used = time.perf_counter(), time.process_time()
        run()
        wall.append(time.perf_counter() - begin)
        processor.append(time.process_time() - used)
    return (f"{simulated / statistics.median(wall):.2f}",
            f"{simulated / statistics.median(processor):.2f}")


def lines(max_step: float | None, angles: int, step: float = STEP) -> np.ndarray:
    """Return 2 f_e lines over start angles; `max_step` None is the fixed-step loop."""
    profile, effects = load_profile("step"), parse_effects(SHORT)
    found = []
    for seed in range(angles):
        angle = seed * math.pi * (3.0 - math.sqrt(5.0))
        if max_step is None:
            record = simulate_reference(
                profile, effects=effects, seed=seed if step == STEP else seed + 20_000,
                start_angle=angle, step=step,
            )
        else:
            record = simulate_traced(
                profile, effects=effects, seed=seed + 10_000, start_angle=angle, trace=False,
                max_step=max_step,
            ).record
        found.append(two_fe(record))
    return np.array(found)


def error(found: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """Return the error of the mean line, and its standard error, both relative.

    Along the reference's direction, so that scatter does not read as error.
    """
    mean = reference.mean()
    part, whole = (found / mean).real, (reference / mean).real
    deviation = math.hypot(
        part.std(ddof=1) / math.sqrt(len(part)), whole.std(ddof=1) / math.sqrt(len(whole))
    )
    return float(part.mean() - 1.0), deviation


def child(code: str, **environment: str) -> list[float]:
    """Return the numbers that a fresh process prints."""
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)} | environment
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, check=True, capture_output=True, text=True
    )
    return [float(x) for x in done.stdout.split()]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--angles", type=int, default=200, help="start angles of the kernel")
    parser.add_argument("--reference-angles", type=int, default=24, help="of the reference")
    parser.add_argument("--repeats", type=int, default=5, help="timed runs, the median counts")
    options = parser.parse_args()
    console = Console()

    reference = lines(None, options.reference_angles)
    table = Table(title="Kernel: simulated s a wall and CPU s (extended, 20 kHz); error of 2 f_e")
    for title in ("integration", "x wall", "x CPU", "2 f_e", "± s.e."):
        table.add_column(title, justify="left" if title == "integration" else "right",
                         no_wrap=True)
    extended = load_profile("extended")
    for max_step in STEPS:
        relative, deviation = error(lines(max_step, options.angles), reference)
        name = f"events, {max_step * 1e6:g} µs"
        table.add_row(
            name + (" (default)" if max_step == MAX_STEP else ""),
            *speed(
                lambda h=max_step: simulate_traced(extended, trace=False, max_step=h),
                extended.duration, options.repeats,
            ),
            f"{relative:+.2%}", f"{deviation:.2%}",
        )
    profile = step_profile(0.4)
    for step in (STEP, 1e-6):
        relative, deviation = error(lines(None, options.reference_angles, step), reference)
        table.add_row(
            f"fixed step, {step * 1e6:g} µs",
            *speed(lambda h=step: simulate_reference(profile, step=h), profile.duration, 3),
            *(("reference", "") if step == STEP else (f"{relative:+.2%}", f"{deviation:.2%}")),
        )
    (ratio,) = child(PYTHON_LOOP, NUMBA_DISABLE_JIT="1")
    table.add_row("plain Python, 1 µs", f"{ratio:.4f}", "", "", "")
    console.print(table)
    console.print(
        f"2 f_e line of the reference: {abs(reference.mean()):.4f} rad/s; "
        f"{options.angles} start angles, reference {options.reference_angles}"
    )
    with tempfile.TemporaryDirectory() as cache:
        cold = child(START, NUMBA_CACHE_DIR=cache)
        warm = [child(START, NUMBA_CACHE_DIR=cache) for _ in range(3)]
    imports, start, cpu = (statistics.median(column) for column in zip(*warm))
    console.print(
        f"first simulation of a fresh process: cold {cold[1]:.1f} s (CPU {cold[2]:.1f} s), "
        f"warm {start:.2f} s (CPU {cpu:.2f} s); imports {imports:.2f} s before it"
    )


if __name__ == "__main__":
    main()
