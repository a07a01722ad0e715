"""Our kernel and its fixed-step reference on the whole actuator with a sinusoidal back-EMF."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.simulators.drive import standard_error
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_sim.campaign.reductions import summary
from ema_sim.effects import parse_effects
from ema_sim.reference import simulate_reference
from ema_sim.simulate import simulate, simulate_traced

EFFECTS = ("back_emf_shape.sine_share=1", "turn_short.fraction=0.1", "turn_short.phase=b")
"""Sine-wave motor; a short, so that there is a line of speed at 2 f_e to be right about."""
FEATURES = {"torque current": "torque_current_mean", "current rms": "current_rms",
            "2 f_e line": "speed_line_2"}
STARTS = 8
"""Rotor angles at the start; features are means over these, without noise."""


def rows(quick: bool) -> list[dict]:
    """Return the rows of the whole actuator; `quick` leaves the finest settings out."""
    profile, effects = load_profile("step"), parse_effects(EFFECTS)
    options = {"effects": effects, "noise": 0.0}

    def kernel(step: float, angle: float) -> Record:
        return simulate_traced(
            profile, start_angle=angle, max_step=step, trace=False, **options
        ).record

    cases: list[tuple[str, str, Callable[[float], Record]]] = [
        ("our kernel", "default, steps <= 10 µs",
         lambda angle: simulate(profile, start_angle=angle, **options)),
        ("our kernel", "steps <= 2.5 µs", partial(kernel, 2.5e-6)),
        ("our kernel", "steps <= 0.5 µs", partial(kernel, 0.5e-6)),
    ]
    for step in (1e-6, 0.5e-6, 1e-7) if not quick else (1e-6, 2.5e-7):
        cases.append((
            "its fixed-step reference", f"step {step * 1e6:g} µs",
            lambda angle, step=step: simulate_reference(
                profile, start_angle=angle, step=step, **options),
        ))
    found = [row(*case, profile.duration) for case in cases]
    found[-1]["reference"] = True
    return found


def row(
    name: str, setting: str, run: Callable[[float], Record], duration: float
) -> dict:
    """Return features and times of one setting."""
    angles = [2.0 * np.pi * (n + 0.5) / STARTS for n in range(STARTS)]
    run(angles[0])
    walls, cpus, summaries = [], [], []
    for angle in angles:
        wall, cpu = time.perf_counter(), time.process_time()
        record = run(angle)
        walls.append((time.perf_counter() - wall) / duration)
        cpus.append((time.process_time() - cpu) / duration)
        summaries.append(summary(record))
    return {
        "group": "actuator", "name": name, "setting": setting, "reference": False,
        "wall": statistics.median(walls), "cpu": statistics.median(cpus),
        "values": {k: float(np.mean([s[n] for s in summaries])) for k, n in FEATURES.items()},
        "spread": {k: standard_error([s[n] for s in summaries]) for k, n in FEATURES.items()},
    }
