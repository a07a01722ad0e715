"""The model corrected by acceptance records: parameters that make its features theirs.

Units are drawn about the description as widely as a data sheet knows its parameters (`PRIORS`),
each is tested in the simulator, and the features are regressed on the parameters: their slopes.
The estimate is that of the greatest posterior density, with the prior at the description and the
scatter of the mean of so many units as error of a feature (Gelman et al., Bayesian Data Analysis,
2013, 14.8); the slopes are taken again about the estimate. A feature that no parameters explain is
not theirs: its error grows until it fits, and what stays is the discrepancy. Of the type is known
what is known of the mean of these units, and as far as that mean may be from the type.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ema_prognostics.commission.acceptance import Acceptance
from ema_prognostics.commission.estimate import estimate
from ema_prognostics.commission.quality import fleet_spread
from ema_prognostics.features.extract import extract
from ema_prognostics.features.profile_kind import ProfileKind
from ema_prognostics.features.vector import SWINGS, steady
from ema_prognostics.training.fleet import FleetFeatures
from ema_record.actuator import RELAY, TRAPEZOID, Actuator
from ema_record.errors import EmaError, UsageError
from ema_record.kit import with_present_kit
from ema_record.profile import Profile
from ema_record.spread import UnitTolerances, most_of
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate

PRIORS: dict[str, float] = {
    "motor.dynamic_friction": 0.4, "motor.viscous_friction": 0.7, "surface.dynamic_friction": 0.4,
    "shaft.stiffness": 0.3, "shaft.damping": 0.5, "shaft.backlash": 0.5, "motor.inertia": 0.15,
    "motor.back_emf_constant": 0.05, "motor.phase_resistance": 0.1,
    "motor.phase_inductance": 0.15, "control.position_gain": 0.1, "control.speed_limit": 0.01,
    "control.proportional_gain": 0.1, "control.integral_gain": 0.2, "inverter.hysteresis": 0.1,
    "motor.flat_top": 0.05, "acquisition.reference_latency": 0.5,
    "acquisition.command_latency": 0.5, "acquisition.commutation_latency": 1.0,
}
"""Standard deviation of what a description says: of the logarithm, of latencies in periods. A
data sheet gives motor constants within their tolerance; friction and stiffness are assumed; what
commutates in software is a control period late, or none where gates do it. Static
over dynamic friction stays as described: it acts only where the motor sticks, so no slope tells
it, and what other laws of friction leave was taken for it."""
UNTOLD = 0.75
"""Part of the prior that is left where the records tell next to nothing of a parameter."""
TOLERANCE_OF = {
    "resistance": ("motor.phase_resistance",), "inductance": ("motor.phase_inductance",),
    "back_emf": ("motor.back_emf_constant",), "flat_top": ("motor.flat_top",),
    "motor_friction": ("motor.dynamic_friction",),
    "surface_friction": ("surface.dynamic_friction",),
    "viscous_factor": ("motor.viscous_friction",), "inertia": ("motor.inertia",),
    "stiffness": ("shaft.stiffness",), "damping": ("shaft.damping",),
    "backlash": ("shaft.backlash",), "hysteresis": ("inverter.hysteresis",),
    "control_gain": ("control.position_gain", "control.proportional_gain",
                     "control.integral_gain"),
}
"""Parameters of each tolerance."""
LATENCIES = ("acquisition.reference_latency", "acquisition.command_latency",
             "acquisition.commutation_latency")
RELAY_ONLY = ("inverter.hysteresis", "motor.phase_resistance", "motor.phase_inductance")
"""Only a relay's currents show them: others hide them behind their current control."""
LOAD = "load"
"""The mean load of the records, in parts of the surface's friction, is estimated beside them."""
LOAD_SPREAD = 0.15
DRAWS = (150, 120, 120)
"""Simulated tests of each round."""
NARROWER = 2.0
"""Of what a round leaves open: the spread of the next."""
REACH = 2.0
"""Standard deviations within which parameters are drawn."""
CLIP = 4.0
"""Robust deviations beyond which features of a test are taken as those that far off."""
CONDITIONS = ("temperature", "bus_voltage")


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """A corrected model.

    Attributes
    ----------
    actuator : corrected.
    changes : of each parameter, new over old; of latencies the periods.
    covariance : ndarray, shape (p, p). What is not known of the parameters in `changes`, in
        their order and as `PRIORS`: error of the estimate, and of the mean of so many units.
    names : of the features, (d,).
    before, after : ndarray, shape (d,). Mean of the records less the model, over the spread.
    """

    actuator: Actuator
    changes: dict[str, float]
    covariance: np.ndarray
    names: tuple[str, ...]
    before: np.ndarray
    after: np.ndarray

    @property
    def open(self) -> dict[str, float]:
        """Standard deviation that is left of each parameter, as `PRIORS`."""
        return dict(zip(self.changes, np.sqrt(np.diag(self.covariance)).tolist()))

    def draw(self, rng: np.random.Generator) -> Actuator:
        """Return the type as it may be.

        The parameters are drawn together: what the records tell of several, such as dry and
        viscous friction, but of neither alone, is known in each draw. Those of which they tell
        next to nothing stay, and the others are as known beside these; all within the two
        deviations over which the slopes were measured.
        """
        names, total = list(self.changes), self.covariance
        told = np.array([self.open[n] < UNTOLD * PRIORS[n] for n in names])
        among, beside = total[np.ix_(told, told)], total[np.ix_(told, ~told)]
        known = among - beside @ np.linalg.solve(total[np.ix_(~told, ~told)], beside.T)
        steps = np.linalg.cholesky(known) @ np.clip(
            rng.standard_normal(len(known)), -REACH, REACH)
        return _candidate(self.actuator, [n for n, t in zip(names, told) if t], steps)


def changed(actuator: Actuator, name: str, step: float) -> Actuator:
    """Return the actuator with a parameter multiplied by exp `step`; latencies: with it added.

    Dynamic friction moves the static one with it, which never falls below.
    """
    section, _, field = name.partition(".")
    part = getattr(actuator, section)
    value, factor = getattr(part, field), float(np.exp(step))
    if name in LATENCIES:
        part = part._replace(**{field: max(0.0, value + step)})
    elif field == "flat_top":
        part = part._replace(flat_top=min(value * factor, 3.0))
    elif field == "dynamic_friction":
        part = part._replace(dynamic_friction=value * factor,
                             static_friction=part.static_friction * factor)
    else:
        part = part._replace(**{field: value * factor})
    return actuator._replace(**{section: part})


def parameters_of(actuator: Actuator) -> list[str]:
    """Return the parameters that are corrected: those that the drive shows and that are not 0."""
    found = []
    for name in PRIORS:
        if name in RELAY_ONLY and actuator.drive.kind != RELAY:
            continue
        if name == "motor.flat_top" and actuator.motor.back_emf != TRAPEZOID:
            continue
        if name in LATENCIES or _value(actuator, name) > 0.0:
            found.append(name)
    return found


def _settings(conditions: Sequence[str], actuator: Actuator, load: float) -> list[str]:
    torque = load * actuator.surface.dynamic_friction
    return [*conditions, f"surface_load.constant={torque!r}"]


def _candidate(actuator: Actuator, names: Sequence[str], steps: np.ndarray) -> Actuator:
    for name, step in zip(names, steps):
        actuator = changed(actuator, name, float(step))
    return actuator


def model_features(
    actuator: Actuator, nominal: Actuator, profile: Profile, kind: ProfileKind,
    names: Sequence[str], settings: Sequence[str], seeds: Sequence[int],
) -> np.ndarray:
    """Return the features of the model, one row a seed, shape (n, d).

    Parameters
    ----------
    actuator, nominal : simulated; what the features refer to.
    profile, kind : of the test.
    names : of the features.
    settings : effects: temperature, bus, load.
    seeds : of noise and start angle.
    """
    effects = parse_effects(settings)
    rows = []
    for seed in seeds:
        found = extract(simulate(profile, actuator=actuator, effects=effects, seed=seed),
                        kind, nominal)
        missing = sorted(set(found) ^ set(names))
        if missing:
            raise UsageError(f"the records and the model differ in their features "
                             f"({missing[0]}): does the description say which channels are "
                             "recorded?")
        rows.append([found[n] for n in names])
    return np.array(rows)


def _drawn(
    candidates: Sequence[tuple[Actuator, list[str], int]], nominal: Actuator, profile: Profile,
    kind: ProfileKind, names: Sequence[str],
) -> np.ndarray:
    """Return the features of candidates, shape (n, d); NaN where one does not do the test."""
    rows = np.full((len(candidates), len(names)), np.nan)
    for k, (actuator, settings, seed) in enumerate(candidates):
        try:
            rows[k] = model_features(actuator, nominal, profile, kind, names, settings, [seed])[0]
        except UsageError:
            raise
        except EmaError:
            continue
    return rows


def conditions_of(names: Sequence[str], mean: np.ndarray) -> list[str]:
    """Return the mean conditions of the records as settings of effects."""
    place = {n: float(mean[k]) for k, n in enumerate(names)}
    temperature = 20.0 + 50.0 * place["temperature"]
    return [f"winding_temperature.temperature={temperature!r}",
            f"bus_voltage_change.change={place['bus_voltage'] - 1.0!r}"]


def calibrate(
    acceptance: Acceptance, actuator: Actuator, fleet: FleetFeatures,
    tolerances: UnitTolerances, *, seed: int, jobs: int, progress: Callable[[float], None],
) -> Calibration:
    """Return the model corrected by the records.

    Parameters
    ----------
    acceptance : the records.
    actuator : as described, the recorder as measured.
    fleet, tolerances : healthy units of the described type, and how they differ.
    seed, jobs : of the draws; processes.
    progress : called with the part that is done.
    """
    from joblib import Parallel, delayed

    names, rows = acceptance.features(actuator)
    sigma = fleet_spread(names, fleet)
    rows = steady(names, rows, np.median(fleet.both(names), axis=0))
    units = acceptance.units
    mean = np.mean([rows[units == unit].mean(axis=0) for unit in np.unique(units)], axis=0)
    profile, kind = acceptance.records[0].profile, acceptance.kind
    conditions = conditions_of(names, mean)
    chosen = parameters_of(actuator)
    prior = np.array([*(PRIORS[name] for name in chosen), LOAD_SPREAD])
    x, wide = np.zeros(len(prior)), prior
    used = np.array([n not in (*CONDITIONS, *SWINGS.values()) for n in names])
    root = np.sqrt(len(np.unique(units)))
    usual = _usual(actuator, tolerances)
    least = np.array([-_value(usual, n) if n in LATENCIES else -np.inf for n in [*chosen, LOAD]])
    rng = np.random.default_rng([seed, 3])
    chunk = 8
    for turn, count in enumerate(DRAWS):
        steps = x + wide * np.clip(rng.standard_normal((count, len(x))), -REACH, REACH)
        runs = [(_candidate(usual, chosen, row[:-1]),
                 _settings(conditions, actuator, float(row[-1])), int(rng.integers(2**31)))
                for row in steps]
        work = Parallel(n_jobs=jobs, return_as="generator")(
            delayed(with_present_kit(_drawn))(runs[k:k + chunk], actuator, profile, kind, names)
            for k in range(0, count, chunk))
        parts = []
        for part in work:
            parts.append(part)
            progress((turn + len(parts) * chunk / count) / len(DRAWS))
        found = np.vstack(parts)
        done = np.isfinite(found).all(axis=1)
        if np.count_nonzero(done) < 0.5 * count:
            raise UsageError("the described actuator does not do its test in most simulations: "
                             "check torque, friction and control gains of the description")
        # Latencies are not below 0: what was simulated counts, not what was drawn.
        taken = np.maximum(steps, least)
        features = found[done][:, used]
        center, scale = np.median(features, axis=0), np.maximum(features.std(axis=0), 1e-9)
        features = center + scale * np.clip((features - center) / scale, -CLIP, CLIP)
        x, left = estimate(taken[done], features, mean[used], prior, sigma[used] / root,
                           len(np.unique(units)))
        wide = np.minimum(NARROWER * np.sqrt(np.diag(left)), prior)
    progress(1.0)
    corrected = _candidate(actuator, chosen, x[:-1])
    off = [(mean - model_features(_usual(of, tolerances), actuator, profile, kind, names,
                                  _settings(conditions, actuator, load), range(6)).mean(axis=0))
           / sigma for of, load in ((actuator, 0.0), (corrected, float(x[-1])))]
    units_own = _deviations(tolerances, actuator)
    own = np.array([units_own.get(name, 0.0) for name in chosen]) / root
    return Calibration(
        actuator=corrected, names=tuple(names),
        changes={n: _value(corrected, n) / (1.0 if n in LATENCIES else _value(actuator, n))
                 for n in chosen},
        covariance=left[:-1, :-1] + np.diag(own**2),
        before=np.where(used, off[0], 0.0), after=np.where(used, off[1], 0.0),
    )


def _usual(actuator: Actuator, tolerances: UnitTolerances) -> Actuator:
    """Return the unit in the middle of its type: latencies only grow from the type's."""
    acquisition, more = actuator.acquisition, 0.5 * tolerances.latency
    return actuator._replace(acquisition=acquisition._replace(
        command_latency=acquisition.command_latency + more,
        reference_latency=acquisition.reference_latency + more))


def _deviations(tolerances: UnitTolerances, actuator: Actuator) -> dict[str, float]:
    """Return the standard deviation of units by parameter, as `PRIORS`: they differ evenly."""
    half = {**tolerances._asdict(), "viscous_factor": np.log(tolerances.viscous_factor),
            "flat_top": tolerances.flat_top / (actuator.motor.flat_top or np.inf)}
    return {parameter: half[name] / np.sqrt(3.0)
            for name, of in TOLERANCE_OF.items() for parameter in of}


def wider(tolerances: UnitTolerances, nominal: Actuator, left: Mapping[str, float]
          ) -> UnitTolerances:
    """Return the tolerances about a model of which `left`, as `Calibration.open`, is not known.

    Half widths whose variance is that of the units and of what is not known of their type. A
    parameter of which the records tell next to nothing moves no feature, and its tolerance stays;
    of several parameters of one tolerance the best known counts.
    """
    found = {}
    for name, of in TOLERANCE_OF.items():
        told = [left[n] for n in of if n in left and left[n] < UNTOLD * PRIORS[n]]
        error = np.sqrt(3.0) * min(told, default=0.0)
        old = getattr(tolerances, name)
        if name == "viscous_factor":
            new = np.exp(np.hypot(np.log(old), error))
        else:
            new = np.hypot(old, error * (nominal.motor.flat_top if name == "flat_top" else 1.0))
        found[name] = float(f"{min(new, most_of(name)):.3g}") if error > 0.0 else old
    return tolerances._replace(**found)


def _value(actuator: Actuator, name: str) -> float:
    section, _, field = name.partition(".")
    return float(getattr(getattr(actuator, section), field))
