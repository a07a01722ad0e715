"""All in which healthy units and days differ, by the kit's `tolerances` and `conditions`; runs.

Beside what recalibration fits, that is everything a record cannot be expected to measure: grease,
static friction, gains, relay band, latencies. One vector in half widths, uniform from -1 to 1,
describes a unit on one day; conditions that the record measures stand beside it. These are read
off the simulated records as they are off measured ones, so that both are judged alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.measure.features import FeatureMap
from ema_identification.actuator.measure.recorder import whole
from ema_identification.actuator.measure.runs import Progress, silent, spread_out
from ema_identification.actuator.measure.tolerances import (
    CONDITIONS,
    N_TOLERANCES,
    TOLERANCES,
    NoiseFactors,
    RecordConditions,
    align,
    realise,
)
from ema_record.actuator import RELAY, TRAPEZOID, Actuator
from ema_record.errors import InvalidRecordError, SimulationError
from ema_record.record import Record
from ema_record.spread import Conditions, TypeSpread, harmonic_spread
from ema_sim.drives import shows_carrier
from ema_sim.effects import EFFECTS, Effects
from ema_sim.machine import TURN
from ema_sim.model_file import Model
from ema_sim.simulate import simulate, start_of

_RELAY, _CARRIER = ("inverter.hysteresis",), ("drive.proportional_gain", "drive.integral_gain")
_TRAPEZOID, _HARMONICS = ("motor.flat_top",), ("motor.harmonic_5", "motor.harmonic_7")
"""No current answers to a third harmonic: it is the same in all phases of a star."""
_OF_DAY = [t.name.startswith(("current_sensor", "surface_load")) for t in TOLERANCES]
_START = "start.position", "start.twist"
"""How surface and shaft stand when a test begins, the last numbers of a unit: friction holds the
surface where it came to rest, and its shaft wound by the last move."""
_TODAY = "noise.position", *_START
"""The noise of a position at rest is below its converter's step: no record shows it."""
DAYS = sum(_OF_DAY) + len(_TODAY)
"""How many numbers differ from test to test."""
STRIBECK = 5e-3
"""Share of the speed limit within which static friction has gone, at most: a seal of 5 mm radius
at 0.02 m/s, between boundary and full lubrication (Armstrong-Helouvry et al. 1994)."""


def unlisted(a: Actuator) -> tuple[str, ...]:
    """Return the names of what differs beside `TOLERANCES`, by back-EMF and kind of drive."""
    return (
        "motor.static_ratio", "surface.static_ratio", "motor.stribeck_speed",
        "motor.viscous_friction", "surface.viscous_friction",
        *(_TRAPEZOID if a.motor.back_emf == TRAPEZOID else _HARMONICS), "shaft.damping",
        "control.position_gain", "control.proportional_gain", "control.integral_gain",
        *(_RELAY if a.drive.kind == RELAY else _CARRIER), "acquisition.command_latency",
        "acquisition.reference_latency", "shaft.backlash", "converters.speed_offset", *_TODAY)


def unit_numbers(a: Actuator) -> tuple[str, ...]:
    """Return the names of all numbers of a unit of a type on some day, shape (width,)."""
    return *(t.name for t in TOLERANCES), *unlisted(a)


def of_day(width: int) -> np.ndarray:
    """Return which of so many numbers of a unit differ from test to test, shape (width,), bool."""
    own = width - N_TOLERANCES - len(_TODAY)
    return np.array([*_OF_DAY, *[False] * own, *[True] * len(_TODAY)])


def half_widths(spread: TypeSpread) -> np.ndarray:
    """Return the half widths of the bands of `TOLERANCES`, in their units, shape (18,)."""
    t, c = spread.tolerances, spread.conditions
    return np.array([
        t.resistance, t.inductance, t.motor_friction, t.surface_friction, t.back_emf,
        *[t.back_emf_phase] * 3, t.inertia, t.inertia, t.stiffness, *[c.current_gain] * 3,
        *[c.current_offset] * 3, c.load])


def deviations(
    a: Actuator, spread: TypeSpread, z: np.ndarray
) -> dict[str, tuple[float, str]]:
    """Return how far a unit and its day are from the type, and the unit of that, by name.

    Relative (unit 1) but for sensors, load, angles and latencies. `z` : half widths, shape
    (width,) or longer.
    """
    t = spread.tolerances
    found = {known.name: (float(half * x), known.unit)
             for known, half, x in zip(TOLERANCES, half_widths(spread), z)}
    bands = {"static_ratio": t.static_ratio, "damping": t.damping, "hysteresis": t.hysteresis,
             "backlash": t.backlash}
    for name, x in zip(unlisted(a), map(float, z[N_TOLERANCES:])):
        kind = name.split(".")[1]
        if kind == "viscous_friction":
            found[name] = t.viscous_factor**x - 1.0, "1"
        elif kind == "flat_top":
            found[name] = t.flat_top * x, "rad"
        elif name == _CARRIER[0]:
            found[name] = _proportional(a, t.control_gain, x) - 1.0, "1"
        elif kind.startswith("harmonic"):
            found[name] = harmonic_spread(int(kind[-1]), t.flat_top) * x, "1"
        elif name in _START:
            found[name] = a.wind_up / a.gear.ratio * x, "rad"
        elif name in _TODAY:
            found[name] = _noise(spread.conditions, x) - 1.0, "1"
        elif kind == "speed_offset":
            found[name] = 0.5 * x, "steps"
        elif kind == "stribeck_speed":
            found[name] = _stribeck(a, x), "rad/s"
        elif kind.endswith("latency"):
            found[name] = 0.5 * t.latency * (1.0 + x), "periods"
        else:
            found[name] = bands.get(kind, t.control_gain) * x, "1"
    return found


def _proportional(a: Actuator, band: float, x: float) -> float:
    """Return by what factor a unit's current control is stiffer than described, `x` half widths.

    Whether the integral holds the error that has just been read (as here: backward Euler) or that
    a period later (forward) no description says. The latter is as if K_p were less by K_i T.
    """
    d = a.drive
    share = d.integral_gain / (d.pwm_frequency * d.proportional_gain)
    return (1.0 + band * x) * (1.0 + share) ** (0.5 * x - 0.5)


def _stribeck(a: Actuator, x: float) -> float:
    """Return the speed within which a motor's static friction has gone (rad/s)."""
    return 0.5 * STRIBECK * a.control.speed_limit * max(0.0, 1.0 + x)


def _noise(c: Conditions, x: float) -> float:
    """Return a factor on the noise of a sensor, even in its logarithm."""
    low, high = (math.log(max(level, 1e-2)) for level in (c.noise_least, c.noise_most))
    return math.exp(0.5 * (low + high + (high - low) * x))


def draw_fleet_unit(rng: np.random.Generator, a: Actuator) -> np.ndarray:
    """Return a healthy unit of a type on some day, shape (width,), in half widths."""
    return rng.uniform(-1.0, 1.0, len(unit_numbers(a)))


def draw_fleet_conditions(rng: np.random.Generator, spread: TypeSpread) -> RecordConditions:
    """Return conditions of a test within the kit's."""
    c = spread.conditions
    warm, bus, speed, angle, current = map(float, rng.uniform(-1.0, 1.0, 5))
    middle = 0.5 * (c.temperature_least + c.temperature_most)
    return RecordConditions(
        temperature=middle + warm * (c.temperature_most - middle), bus=bus * c.bus,
        noise=NoiseFactors(_noise(c, speed), _noise(c, current)),
        start_angle=0.5 * TURN * (1.0 + angle), measured=frozenset({"temperature", "bus"}))


def fleet_unit(
    model: Model, spread: TypeSpread, z: np.ndarray, conditions: RecordConditions,
    effects: Effects | None = None,
) -> tuple[Actuator, Effects]:
    """Return the actuator and effects of a unit.

    Parameters
    ----------
    model, spread : the type.
    z : ndarray, shape (width,), in half widths.
    conditions : of the test.
    effects : in place of those of the model.
    """
    t = spread.tolerances
    a, e = realise(model, z[:N_TOLERANCES] * half_widths(spread), conditions, effects)
    x = dict(zip(unlisted(a), map(float, z[N_TOLERANCES:])))
    m, s, c, q = a.motor, a.surface, a.control, a.acquisition

    def near(name: str, half: float) -> float:
        return 1.0 + half * x.get(name, 0.0)

    def late(what: str) -> float:
        """Return periods; no rounding of a bound makes it act before its time."""
        return max(0.0, 0.5 * t.latency * (1.0 + x[f"acquisition.{what}_latency"]))

    m = m._replace(
        static_friction=max(m.static_friction * near("motor.static_ratio", t.static_ratio),
                            m.dynamic_friction),
        viscous_friction=m.viscous_friction * t.viscous_factor**x["motor.viscous_friction"],
        flat_top=float(np.clip(m.flat_top + t.flat_top * x.get(_TRAPEZOID[0], 0.0), 0.0, math.pi)),
        **{f"harmonic_{h}": getattr(m, f"harmonic_{h}") + harmonic_spread(h, t.flat_top) * x.get(
            f"motor.harmonic_{h}", 0.0) for h in (5, 7)})
    s = s._replace(
        static_friction=max(s.static_friction * near("surface.static_ratio", t.static_ratio),
                            s.dynamic_friction),
        viscous_friction=s.viscous_friction * t.viscous_factor**x["surface.viscous_friction"])
    c = c._replace(
        position_gain=c.position_gain * near("control.position_gain", t.control_gain),
        proportional_gain=c.proportional_gain * near("control.proportional_gain", t.control_gain),
        integral_gain=c.integral_gain * near("control.integral_gain", t.control_gain))
    shaft = a.shaft._replace(
        damping=a.shaft.damping * near("shaft.damping", t.damping),
        backlash=a.shaft.backlash * near("shaft.backlash", t.backlash))
    q = q._replace(
        command_latency=q.command_latency + late("command"),
        reference_latency=q.reference_latency + late("reference"))
    converters = a.converters._replace(  # of one that rounds up or down, or to the nearest
        speed_offset=a.converters.speed_offset + 0.5 * x["converters.speed_offset"])
    inverter = a.inverter._replace(
        hysteresis=a.inverter.hysteresis * near("inverter.hysteresis", t.hysteresis))
    noise = a.noise._replace(
        position=a.noise.position * _noise(spread.conditions, x["noise.position"]))
    within, falls = _stribeck(a, x["motor.stribeck_speed"]), e.stribeck_friction
    if within * m.dynamic_friction > 0.0 and EFFECTS["stribeck_friction"].is_neutral(falls):
        e = e._replace(stribeck_friction=falls._replace(
            increase=m.static_friction / m.dynamic_friction - 1.0, speed=within))
    drive = a.drive
    if drive.kind != RELAY:
        drive = drive._replace(
            proportional_gain=drive.proportional_gain * _proportional(
                a, t.control_gain, x[_CARRIER[0]]),
            integral_gain=drive.integral_gain * near(_CARRIER[1], t.control_gain))
    return a._replace(motor=m, surface=s, control=c, shaft=shaft, acquisition=q,
                      inverter=inverter, drive=drive, noise=noise, converters=converters), e


def fleet_record(
    model: Model, spread: TypeSpread, fmap: FeatureMap, z: np.ndarray,
    conditions: RecordConditions, seed: int, effects: Effects | None = None,
) -> Record:
    """Return a test of a unit, all channels; `fleet_unit` says what the parameters are."""
    actuator, effects = fleet_unit(model, spread, z, conditions, effects)
    # The conditions hold what the sensor of the rotor angle reads.
    angle = conditions.start_angle - effects.hall_misalignment.angle
    return whole(simulate(
        fmap.profile, actuator=actuator, effects=effects, seed=seed, rate=fmap.rate,
        start_angle=angle, start=start_of(model.actuator, fmap.profile, z[-len(_START):]),
        switching=shows_carrier(actuator, fmap.rate)), model.actuator)


def fleet_features(
    model: Model, spread: TypeSpread, fmap: FeatureMap, z: np.ndarray,
    conditions: RecordConditions, seed: int, effects: Effects | None = None,
) -> np.ndarray:
    """Return the features of `fleet_record`, shape (d,); NaN outside the simulator's domain."""
    try:
        return fmap.extract(fleet_record(model, spread, fmap, z, conditions, seed, effects))
    except (SimulationError, InvalidRecordError):
        return np.full(len(fmap.features), np.nan)


class LibrarySizes(NamedTuple):
    """How many healthy units a library is made of."""

    units: int = 2000
    """With 3000 a record says 1 % more (of the deviations of an effect beside all tolerances)."""
    repeated: int = 300
    scaled: int = 40
    """Units that set the scale of the likelihood, on the quadratic and on runs."""
    set_aside: int = 480
    """Units that are only ranked; the second of so many still proves a level of 0.01."""

    @property
    def ranked(self) -> int:
        """Return the place of the first unit that is only ranked."""
        return self.units + self.scaled

    @property
    def total(self) -> int:
        """Return the number of units."""
        return self.ranked + self.set_aside


FULL = LibrarySizes()
CHUNK = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetRuns:
    """Runs of healthy units.

    Attributes
    ----------
    z : ndarray, shape (n, width).
    conditions : ndarray, shape (n, 5). Rows of `RecordConditions`, as the records tell.
    features : ndarray, shape (n, d).
    again : ndarray, shape (m, d). Second runs of the first m units.
    """

    z: np.ndarray
    conditions: np.ndarray
    features: np.ndarray
    again: np.ndarray


def _chunk(model: Model, spread: TypeSpread, fmap: FeatureMap, seed: int, first: int, last: int,
           repeated: int) -> np.ndarray:
    rows = []
    for k in range(first, last):
        rng = np.random.default_rng([seed, 7, k])  # the same unit in every test
        z, given = draw_fleet_unit(rng, model.actuator), draw_fleet_conditions(rng, spread)
        seeds, n = rng.integers(2**31, size=2), len(z) + CONDITIONS
        row = np.full(n + 2 * len(fmap.features), np.nan)
        row[:len(z)] = z
        try:
            record = fleet_record(model, spread, fmap, z, given, int(seeds[0]))
            row[len(z):n] = align(record, model).row()
            row[n:n + len(fmap.features)] = fmap.extract(record)
        except (SimulationError, InvalidRecordError):  # left out
            pass
        if k < repeated:
            row[-len(fmap.features):] = fleet_features(
                model, spread, fmap, z, given, int(seeds[1]))
        rows.append(row)
    return np.array(rows)


def fleet_runs(
    model: Model, spread: TypeSpread, fmap: FeatureMap, sizes: LibrarySizes, *, seed: int = 0,
    workers: int = 1, progress: Progress = silent, keep: str = "",
) -> FleetRuns:
    """Simulate the healthy units; the first build, then some set the scale, the last are ranked.

    `keep` : name under which parts are kept, so that a run that was stopped goes on.
    """
    n, width = sizes.total, len(unit_numbers(model.actuator))
    rows = np.concatenate(spread_out(
        partial(_chunk, model, spread, fmap, seed),
        [(k, min(k + CHUNK, n), sizes.repeated) for k in range(0, n, CHUNK)],
        workers=workers, progress=progress, what="healthy runs", keep=keep))
    z, conditions, features, again = np.split(
        rows, np.cumsum([width, CONDITIONS, len(fmap.features)]), axis=1)
    return FleetRuns(z=z, conditions=conditions, features=features, again=again[:sizes.repeated])
