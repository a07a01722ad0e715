"""Speed and truth of the kernel, two tables: ``python -m benchmarks.kernel`` (about 4 minutes).

Drives: seconds of processor time a simulated second (extended profile, 20 kHz, all effects
compiled in and neutral, warm, medians) against their limits; errors of the lines of a turn short
of 10 % (step profile, mean over start angles), of the relays against the fixed-step reference at
0.1 µs, of drives with a carrier against switching edges and steps of 2 µs. Steps: the relays
with other steps, and the reference itself.
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
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from rich.console import Console
from rich.table import Table

from ema_record.actuator import DRIVES, FOC, PWM, RELAY, Actuator, load_actuator
from ema_record.profile import load_profile, step_profile
from ema_record.record import Record
from ema_sim.effects import parse_effects
from ema_sim.plant.kernel import MAX_STEP
from ema_sim.simulate import simulate_traced
from support.reference import STEP, simulate_reference

STEPS = (MAX_STEP, 20e-6, 5e-6, 2e-6)
FINE_STEP = 2e-6
LIMITS = {RELAY: 0.012, PWM: 0.004, FOC: 0.004}
"""Processor seconds a simulated second, of the default actuator with each drive."""
MOST_ERROR = 0.02
"""Of the lines."""
SHORT = ["turn_short.fraction=0.1"]
WINDOW = (0.082, 0.382)
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))

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


def fundamental(record: Record) -> complex:
    """Return the complex line of phase a's current at the electrical frequency (A)."""
    keep = (record.time > WINDOW[0]) & (record.time < WINDOW[1])
    theta = np.unwrap(record.channel("rotor_angle")[keep])
    return complex(2.0 * np.mean(record.channel("phase_current_a")[keep] * np.exp(-1j * theta)))


def speeds(
    runs: Sequence[Callable[[], object]], simulated: float, repeats: int
) -> list[float]:
    """Return the median processor time a simulated second of each (s).

    All in turn, so that what else the machine does falls on all alike.
    """
    used = []
    for _ in range(repeats + 1):  # the first compiles
        for run in runs:
            begin = time.process_time()
            run()
            used.append(time.process_time() - begin)
    return [statistics.median(used[k + len(runs)::len(runs)]) / simulated
            for k in range(len(runs))]


def drive_of(kind: int) -> Actuator:
    """Return the default actuator with that drive, its current control tuned to the winding."""
    a = load_actuator()
    gain = 0.3 * a.motor.phase_inductance * a.drive.pwm_frequency
    return a._replace(drive=a.drive._replace(
        kind=kind, proportional_gain=gain, integral_gain=300.0 * gain))


def of_carrier(kind: int, angles: int) -> tuple[float, float]:
    """Return the errors of 2 f_e of the speed and of the current's fundamental, averaged."""
    profile, effects = load_profile("step"), parse_effects(SHORT)
    found: dict[bool, list[list[complex]]] = {False: [], True: []}
    for seed in range(angles):
        for switching, step in ((False, MAX_STEP), (True, FINE_STEP)):
            record = simulate_traced(
                profile, actuator=drive_of(kind), effects=effects, seed=seed, noise=0.0,
                start_angle=seed * GOLDEN_ANGLE, trace=False, max_step=step, switching=switching,
            ).record
            found[switching].append([two_fe(record), fundamental(record)])
    mean, fine = (np.mean(found[switching], axis=0) for switching in (False, True))
    errors = np.abs(mean - fine) / np.abs(fine)
    return float(errors[0]), float(errors[1])


def lines(max_step: float | None, angles: int, step: float = STEP) -> np.ndarray:
    """Return 2 f_e lines over start angles; `max_step` None is the fixed-step loop."""
    profile, effects = load_profile("step"), parse_effects(SHORT)
    found = []
    for seed in range(angles):
        angle = seed * GOLDEN_ANGLE
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


def print_drives(console: Console, angles: int, repeats: int, reference: np.ndarray) -> None:
    """Print the table of the drives; `reference` are lines of the relays."""
    table = Table(title="Default actuator by drive: CPU s a simulated s, errors of lines")
    for title in ("drive", "CPU s", "limit", "2 f_e of speed", "f_e of current", "limit", ""):
        table.add_column(title, justify="left" if title in {"drive", ""} else "right")
    extended = load_profile("extended")
    drives = ((RELAY, True), (PWM, False), (FOC, False), (PWM, True), (FOC, True))
    times = speeds([partial(simulate_traced, extended, actuator=drive_of(kind), trace=False,
                            switching=switching) for kind, switching in drives],
                   extended.duration, repeats)
    for (kind, switching), used in zip(drives, times):
        row = [DRIVES[kind] + ("" if kind == RELAY else ", edges" if switching else ", means"),
               f"{used:.4f}"]
        if kind == RELAY:
            relative, deviation = error(lines(MAX_STEP, angles), reference)
            kept = used <= LIMITS[kind] and abs(relative) - 2.0 * deviation <= MOST_ERROR
            row += [f"{LIMITS[kind]:g}", f"{relative:+.2%} ± {deviation:.2%}", "",
                    f"{MOST_ERROR:.0%}", "kept" if kept else "NOT KEPT"]
        elif not switching:
            two, one = of_carrier(kind, min(angles, 20))
            kept = used <= LIMITS[kind] and max(two, one) <= MOST_ERROR
            row += [f"{LIMITS[kind]:g}", f"{two:.2%}", f"{one:.2%}", f"{MOST_ERROR:.0%}",
                    "kept" if kept else "NOT KEPT"]
        table.add_row(*row)
    console.print(table)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--angles", type=int, default=200, help="start angles of the kernel")
    parser.add_argument("--reference-angles", type=int, default=24, help="of the reference")
    parser.add_argument("--repeats", type=int, default=5, help="timed runs, the median counts")
    options = parser.parse_args()
    console = Console()

    reference = lines(None, options.reference_angles)
    extended = load_profile("extended")
    print_drives(console, options.angles, options.repeats, reference)
    table = Table(title="Relays: CPU s a simulated s (extended, 20 kHz); error of 2 f_e")
    for title in ("integration", "CPU s", "2 f_e", "± s.e."):
        table.add_column(title, justify="left" if title == "integration" else "right",
                         no_wrap=True)
    times = speeds([partial(simulate_traced, extended, trace=False, max_step=max_step)
                    for max_step in STEPS], extended.duration, options.repeats)
    for max_step, used in zip(STEPS, times):
        relative, deviation = error(lines(max_step, options.angles), reference)
        name = f"events, {max_step * 1e6:g} µs"
        table.add_row(name + (" (default)" if max_step == MAX_STEP else ""), f"{used:.4f}",
                      f"{relative:+.2%}", f"{deviation:.2%}")
    profile = step_profile(0.4)
    for step in (STEP, 1e-6):
        relative, deviation = error(lines(None, options.reference_angles, step), reference)
        (used,) = speeds([partial(simulate_reference, profile, step=step)], profile.duration, 3)
        table.add_row(
            f"fixed step, {step * 1e6:g} µs", f"{used:.4f}",
            *(("reference", "") if step == STEP else (f"{relative:+.2%}", f"{deviation:.2%}")),
        )
    (ratio,) = child(PYTHON_LOOP, NUMBA_DISABLE_JIT="1")
    table.add_row("plain Python, 1 µs", f"{1.0 / ratio:.0f}", "", "")
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
