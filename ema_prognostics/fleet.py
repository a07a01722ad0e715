"""Runs for training and test: units of a fleet, faults hidden in them, as plain data.

Everything is drawn from one seed before anything is simulated, so the runs do not depend on
the number of processes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from ema_prognostics.cascade_features import CascadeFeatures, cascade_features
from ema_prognostics.segments import ProfileKind
from ema_prognostics.torque_lines import Plant
from ema_record.errors import RecordError
from ema_record.profile import Profile, load_profile, load_profile_dict
from ema_record.record import Record
from ema_sim.actuator import load_actuator
from ema_sim.effects import parse_effects
from ema_sim.parameters import Actuator
from ema_sim.session import ActuatorSession

SPREAD = {
    "resistance": 0.10, "motor_friction": 0.10, "surface_friction": 0.10, "viscous": 0.10,
    "back_emf_constant": 0.01, "stiffness": 0.03, "backlash": 0.30,
}
"""Half width of the spread of healthy units, relative, uniform."""
SEVERITY: dict[str, tuple[float, float]] = {
    "turn_short": (0.004, 0.40), "rotor_eccentricity": (0.004, 0.15),
}
"""Least and largest severity trained on, drawn evenly in its logarithm."""
LARGE: dict[str, tuple[float, float]] = {
    "motor_friction.increase": (0.5, 1.5), "surface_friction.increase": (0.5, 3.0),
    "backlash.increase": (1e-3, 5e-3),
}
"""Wear that must never be called healthy."""
BLIND_ANGLE = np.deg2rad(20.0)
"""A static eccentricity closer than this to a phase's short cannot be told from it (rad)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One test of one unit."""

    label: str
    """healthy, turn_short, rotor_eccentricity, or the effect of `LARGE`."""
    severity: float
    effects: tuple[str, ...]
    factors: tuple[float, ...]
    """Relative deviations of the unit, in the order of `SPREAD`."""
    seed: int
    noise: float
    approach: float
    """Where the surface came from before the test, less its start (rad); 0: shaft relaxed."""
    mirrored: bool
    """The command with its sign turned (step only)."""


def draw_runs(labels: Iterable[str], seed: int) -> list[Run]:
    """Return one run a label, drawn from `seed`."""
    rng = np.random.default_rng(seed)
    runs = []
    for label in labels:
        severity, effects = _effects(label, rng)
        runs.append(Run(
            label=label, severity=severity, effects=effects,
            factors=tuple(float(f) for f in rng.uniform(-1, 1, len(SPREAD)) * [*SPREAD.values()]),
            seed=int(rng.integers(2**31)), noise=float(rng.uniform(0.5, 1.5)),
            approach=float(rng.choice([0.0, 1.0, -1.0]) * rng.uniform(0.01, 0.05)),
            mirrored=bool(rng.uniform() < 0.3),
        ))
    return runs


def _effects(label: str, rng: np.random.Generator) -> tuple[float, tuple[str, ...]]:
    if label == "healthy":
        return 0.0, ()
    if label in LARGE:
        low, high = LARGE[label]
        value = float(rng.uniform(low, high))
        return value, (f"{label}={value!r}",)
    low, high = SEVERITY[label]
    severity = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    phase = "abc"[rng.integers(3)]
    if label == "turn_short":
        mode = ("paper", "physical")[rng.integers(2)]
        return severity, (
            f"turn_short.fraction={severity!r}", f"turn_short.phase={phase}",
            f"turn_short.mode={mode}",
        )
    mode = ("paper", "paper", "common", "shifted", "static")[rng.integers(5)]
    sign = float(rng.choice([-1.0, 1.0]))
    angle = float(rng.uniform(-np.pi, np.pi))
    if mode == "static":
        # A short of phase k looks like a negative ζ at its axis: stay away from the three.
        part = rng.uniform(BLIND_ANGLE, 2.0 * np.pi / 3.0 - BLIND_ANGLE)
        angle = float(part + 2.0 * np.pi / 3.0 * rng.integers(3)) - (np.pi if sign > 0 else 0.0)
    return severity, (
        f"rotor_eccentricity.zeta={sign * severity!r}", f"rotor_eccentricity.mode={mode}",
        f"rotor_eccentricity.angle={angle!r}", f"rotor_eccentricity.phase={phase}",
    )


def unit(nominal: Actuator, factors: tuple[float, ...]) -> Actuator:
    """Return a unit of the fleet, `factors` in the order of `SPREAD`."""
    f = {name: 1.0 + value for name, value in zip(SPREAD, factors)}
    motor, surface, shaft = nominal.motor, nominal.surface, nominal.shaft
    return nominal._replace(
        motor=motor._replace(
            phase_resistance=motor.phase_resistance * f["resistance"],
            back_emf_constant=motor.back_emf_constant * f["back_emf_constant"],
            dynamic_friction=motor.dynamic_friction * f["motor_friction"],
            static_friction=motor.static_friction * f["motor_friction"],
            viscous_friction=motor.viscous_friction * f["viscous"],
        ),
        surface=surface._replace(
            dynamic_friction=surface.dynamic_friction * f["surface_friction"],
            static_friction=surface.static_friction * f["surface_friction"],
            viscous_friction=surface.viscous_friction * f["viscous"],
        ),
        shaft=shaft._replace(
            stiffness=shaft.stiffness * f["stiffness"], backlash=shaft.backlash * f["backlash"]
        ),
    )


def run_profile(kind: ProfileKind, mirrored: bool) -> Profile:
    """Return the profile of a kind, a step with its sign turned if `mirrored`."""
    profile = load_profile(kind)
    if not (mirrored and kind == "step"):
        return profile
    data = profile.model_dump()
    data["points"] = [(t, -x) for t, x in data["points"]]
    return load_profile_dict({**data, "name": f"{kind}_mirrored"}, kind)


def simulate_run(run: Run, kind: ProfileKind, nominal: Actuator) -> Record:
    """Simulate a run: approach of the start position, then the test."""
    profile = run_profile(kind, run.mirrored)
    session = ActuatorSession(
        unit(nominal, run.factors), parse_effects(run.effects), seed=run.seed, noise=run.noise,
        position=profile.start + run.approach,
    )
    if run.approach:
        session.command(Profile(name="approach", inverter_off=0.0, points=(
            (0.0, profile.start), (0.01, profile.start),
        )))
        while session.active:
            session.advance(1000)
    session.command(profile)
    blocks = []
    total = round(profile.duration * session.rate) - 1  # the last sample would also settle
    while total > 0:
        blocks.append(session.advance(total))
        total -= len(blocks[-1])
    return Record(samples=np.concatenate(blocks), profile=profile)


def plant_of(nominal: Actuator) -> Plant:
    """Return the constants that the features need."""
    motor, surface, shaft = nominal.motor, nominal.surface, nominal.shaft
    return Plant(
        back_emf_constant=motor.back_emf_constant, flat_top=motor.flat_top,
        torque_limit=motor.torque_limit, motor_inertia=motor.inertia,
        gear_ratio=nominal.gear.ratio,
        surface_inertia=surface.inertia, surface_viscous_friction=surface.viscous_friction,
        shaft_stiffness=shaft.stiffness, shaft_damping=shaft.damping,
    )


def run_features(runs: list[Run], kind: ProfileKind) -> list[CascadeFeatures | None]:
    """Simulate runs and return their features; None where a record gives none."""
    nominal = load_actuator()
    plant = plant_of(nominal)
    found: list[CascadeFeatures | None] = []
    for run in runs:
        try:
            found.append(cascade_features(simulate_run(run, kind, nominal), kind, plant))
        except RecordError:
            found.append(None)
    return found


def fleet_features(
    runs: list[Run], kind: ProfileKind, *, jobs: int = 1,
    progress: Callable[[str], None] = lambda _: None, chunk: int = 25,
) -> list[CascadeFeatures | None]:
    """Return the features of all runs, on `jobs` processes, in order."""
    from joblib import Parallel, delayed

    parts = [runs[i:i + chunk] for i in range(0, len(runs), chunk)]
    found: list[CascadeFeatures | None] = []
    work = Parallel(n_jobs=jobs, return_as="generator")(
        delayed(run_features)(part, kind) for part in parts
    )
    for part in work:
        found += part
        progress(f"simulating, {kind}")
    return found
