"""The model corrected by acceptance records: parameters that make its features theirs.

Maximum a posteriori: the features of the simulated test less those of the records, over their
spread, and the parameters less those of the description, over how well a data sheet knows them
(`PRIORS`), by Gauss-Newton with slopes of finite differences on equal noise. What stays is not
the parameters': the discrepancy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ema_prognostics.commission.acceptance import Acceptance
from ema_prognostics.features.extract import extract
from ema_prognostics.features.profile_kind import ProfileKind
from ema_record.actuator import RELAY, Actuator
from ema_record.errors import EmaError, UsageError
from ema_record.profile import Profile
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate

PRIORS: dict[str, float] = {
    "motor.dynamic_friction": 0.5, "motor.static_friction": 0.5, "motor.viscous_friction": 1.0,
    "surface.dynamic_friction": 0.5, "surface.static_friction": 0.5, "shaft.stiffness": 0.5,
    "shaft.damping": 0.5, "shaft.backlash": 0.7, "motor.inertia": 0.2,
    "motor.back_emf_constant": 0.1, "motor.phase_resistance": 0.1, "motor.phase_inductance": 0.2,
    "control.position_gain": 0.2, "control.speed_limit": 0.02,
    "control.proportional_gain": 0.2, "control.integral_gain": 0.3,
    "inverter.hysteresis": 0.2, "motor.flat_top": 0.1,
    "acquisition.reference_latency": 1.0, "acquisition.command_latency": 1.0,
}
"""Standard deviation of what a description says: of the logarithm, of latencies in periods. A
data sheet gives motor constants within their tolerance; friction and stiffness are assumed."""
LATENCIES = ("acquisition.reference_latency", "acquisition.command_latency")
RELAY_ONLY = ("inverter.hysteresis", "motor.phase_resistance", "motor.phase_inductance")
"""Only a relay's currents show them: others hide them behind their current control."""
STEP = 0.05
"""Of the finite differences, of the logarithm; five times that for latencies (periods)."""
ROUNDS = 4
SEEDS = (11, 12, 13)
BOUND = 3.0
"""Residuals beyond it count linearly (Huber): a feature that the model lacks pulls less."""
CONDITIONS = ("temperature", "bus_voltage")


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """A corrected model.

    Attributes
    ----------
    actuator : corrected.
    changes : of each parameter, new over old; of latencies the periods.
    names : of the features, (d,).
    before, after : ndarray, shape (d,). Mean of the records less the model, over the spread.
    """

    actuator: Actuator
    changes: dict[str, float]
    names: tuple[str, ...]
    before: np.ndarray
    after: np.ndarray


def changed(actuator: Actuator, name: str, step: float) -> Actuator:
    """Return the actuator with a parameter multiplied by exp `step`; latencies: with it added."""
    section, _, field = name.partition(".")
    part = getattr(actuator, section)
    value = getattr(part, field)
    new = max(0.0, value + step) if name in LATENCIES else value * float(np.exp(step))
    if name == "motor.flat_top":
        new = min(new, 3.0)
    found = actuator._replace(**{section: part._replace(**{field: new})})
    if field in ("dynamic_friction", "static_friction"):  # static is never below dynamic
        body = getattr(found, section)
        if body.static_friction < body.dynamic_friction:
            other = "static_friction" if field == "dynamic_friction" else "dynamic_friction"
            found = found._replace(**{section: body._replace(**{other: new})})
    return found


def parameters_of(actuator: Actuator) -> list[str]:
    """Return the parameters that are corrected: those that the drive shows and that are not 0."""
    found = []
    for name in PRIORS:
        if name in RELAY_ONLY and actuator.drive.kind != RELAY:
            continue
        if name == "motor.flat_top" and actuator.motor.back_emf != 0:
            continue
        section, _, field = name.partition(".")
        if name in LATENCIES or getattr(getattr(actuator, section), field) > 0.0:
            found.append(name)
    return found


def model_features(
    actuator: Actuator, nominal: Actuator, profile: Profile, kind: ProfileKind,
    names: Sequence[str], settings: Sequence[str], seeds: Sequence[int] = SEEDS,
) -> np.ndarray:
    """Return the features of the model, the mean over `seeds`, shape (d,).

    Parameters
    ----------
    actuator, nominal : simulated; what the features refer to.
    profile, kind : of the test.
    names : of the features.
    settings : effects: temperature, bus, load.
    """
    effects = parse_effects(settings)
    rows = []
    for seed in seeds:
        found = extract(simulate(profile, actuator=actuator, effects=effects, seed=seed),
                        kind, nominal)
        if set(found) != set(names):
            raise UsageError("the model gives other features than the records: does the "
                             "description say which channels are recorded?")
        rows.append([found[n] for n in names])
    return np.asarray(np.mean(rows, axis=0))


def conditions_of(names: Sequence[str], mean: np.ndarray) -> list[str]:
    """Return the mean conditions of the records as settings of effects."""
    place = {n: float(mean[k]) for k, n in enumerate(names)}
    temperature = 20.0 + 50.0 * place["temperature"]
    return [f"winding_temperature.temperature={temperature!r}",
            f"bus_voltage_change.change={place['bus_voltage'] - 1.0!r}"]


def calibrate(
    acceptance: Acceptance, actuator: Actuator, spread: Callable[[list[str]], np.ndarray], *,
    progress: Callable[[float], None] = lambda _: None,
) -> Calibration:
    """Return the model corrected by the records.

    Parameters
    ----------
    acceptance : the records.
    actuator : as described, the recorder as measured.
    spread : gives the standard deviation of features, shape (d,), over healthy tests of the
        described type, conditions included, by their names.
    progress : called with the part that is done.
    """
    names, rows = acceptance.features(actuator)
    each = [rows[acceptance.units == unit].mean(axis=0) for unit in np.unique(acceptance.units)]
    mean = np.mean(each, axis=0)
    sigma = spread(names)
    profile = acceptance.records[0].profile
    settings = conditions_of(names, mean)
    used = np.array([n not in CONDITIONS for n in names])

    def residual(candidate: Actuator, load: float) -> np.ndarray:
        found = model_features(candidate, actuator, profile, acceptance.kind, names,
                               [*settings, f"surface_load.constant={load!r}"])
        return np.where(used, (mean - found) / sigma, 0.0)

    chosen = parameters_of(actuator)
    scale = np.array([PRIORS[name] for name in chosen] + [1.0])
    load_unit = 0.2 * actuator.surface.dynamic_friction
    x = np.zeros(len(chosen) + 1)

    def candidate_of(x: np.ndarray) -> Actuator:
        found = actuator
        for name, step in zip(chosen, x):
            found = changed(found, name, float(step))
        return found

    def cost(r: np.ndarray, x: np.ndarray) -> float:
        size = np.abs(r)
        each = np.where(size <= BOUND, 0.5 * r**2, BOUND * (size - 0.5 * BOUND))
        return float(each.sum() + 0.5 * ((x / scale) ** 2).sum())

    first = residual(actuator, 0.0)
    best, best_r = cost(first, x), first
    for turn in range(ROUNDS):
        slopes = np.empty((len(names), len(x)))
        for k in range(len(x)):
            step = np.zeros(len(x))
            step[k] = 5.0 * STEP if k < len(chosen) and chosen[k] in LATENCIES else STEP
            if k == len(chosen):
                step[k] = 0.5
            try:
                moved = residual(candidate_of(x + step), load_unit * float((x + step)[-1]))
                slopes[:, k] = (moved - best_r) / step[k]
            except EmaError:  # the model does not do the test there: that way is closed
                slopes[:, k] = 0.0
            progress((turn + (k + 1) / (len(x) + 1)) / ROUNDS)
        weight = np.minimum(1.0, BOUND / np.maximum(np.abs(best_r), 1e-9))
        normal = (slopes * weight[:, None]).T @ slopes + np.diag(1.0 / scale**2)
        step = -np.linalg.solve(normal, slopes.T @ (weight * best_r) + x / scale**2)
        for part in (1.0, 0.5, 0.25):
            tried = x + np.clip(part * step, -2.0 * scale, 2.0 * scale)
            try:
                r = residual(candidate_of(tried), load_unit * float(tried[-1]))
            except EmaError:
                continue
            if cost(r, tried) < best:
                gain, best, best_r, x = best - cost(r, tried), cost(r, tried), r, tried
                break
        else:
            break
        if gain < 0.01 * best:
            break
    progress(1.0)
    corrected = candidate_of(x)
    return Calibration(
        actuator=corrected, changes=_changes(actuator, corrected, chosen), names=tuple(names),
        before=first, after=best_r,
    )


def _changes(old: Actuator, new: Actuator, names: Sequence[str]) -> dict[str, float]:
    found = {}
    for name in names:
        section, _, field = name.partition(".")
        was, now = (getattr(getattr(a, section), field) for a in (old, new))
        found[name] = float(now) if name in LATENCIES else float(now / was)
    return found
