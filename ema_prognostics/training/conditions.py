"""Units and conditions of their tests for training: drawn from one seed, as plain data.

Their bands are those of the kit's `tolerances` and `conditions` (`ema_record.spread`), in each of
which a value is uniform; of a factor, its logarithm. The benchmark of detection has a generator
of its own (that of `step` alone draws as here, with other seeds).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from ema_prognostics.training.faults import InjectedFault
from ema_record.actuator import INSTANT, MEAN, Actuator, Converters
from ema_record.profile import Profile
from ema_record.spread import Conditions, UnitTolerances, harmonic_spread
from ema_sim.effects import Effects, parse_effects
from ema_sim.effects.control_delay import ControlDelay
from ema_sim.simulate import start_of

RecorderKind = Literal["declared", "exact", "coarse", "sampled", "truncating"]
OTHER_RECORDERS: tuple[RecorderKind, ...] = ("exact", "coarse", "sampled", "truncating")
"""How a recorder may differ from the declared one: it does not round; some of its channels round
to `COARSE_BITS`; its samples are instants where means are declared, or means for instants; its
converter of the speed rounds down."""
RECORDER_SHARE = 0.1
"""The one rule: a tenth of the units have each of `OTHER_RECORDERS`, and a tenth of the tests are
recorded by another recorder than the unit's own. A tenth is enough to set the bounds of the guard
(hundred units of a thousand), and leaves most units as declared."""
COMPUTING = 1.0
"""Control periods that a control takes at most from what it reads to its references: it is done
when the next one begins (Åström and Wittenmark, Computer-Controlled Systems)."""
COARSE_BITS, EXACT_BITS = 12, 32
"""Of a channel; 32 bits are finer than the noise of any sensor by five orders."""
CHANNELS = ("position_bits", "speed_bits", "current_bits", "angle_bits")


class Recorder(NamedTuple):
    """What turns readings into samples."""

    kind: RecorderKind = "declared"
    coarse: tuple[str, ...] = ()
    """Of `CHANNELS`: those that a coarse one rounds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """How an actuator differs from nominal: relative deviations where nothing else is said."""

    resistance: float
    inductance: float
    back_emf: float
    back_emf_phase: tuple[float, float, float]
    flat_top: float
    """Of the trapezoid (rad)."""
    harmonics: tuple[float, float, float]
    """Third, fifth, seventh, of a back-EMF that is described by these (of the first)."""
    motor_friction: float
    surface_friction: float
    static_ratio: tuple[float, float]
    """Static over dynamic friction, of motor and surface."""
    viscous: tuple[float, float]
    """Factors on the viscous friction of motor and surface."""
    inertia: tuple[float, float]
    """Of motor and surface."""
    stiffness: float
    damping: float
    gains: tuple[float, float, float]
    """Of the position control; proportional and integral, of the speed control."""
    current_gains: tuple[float, float]
    """Proportional and integral, of a current control by pulse width."""
    hysteresis: float
    backlash: float
    latency: tuple[float, float]
    """Of command and reference, added (control periods)."""
    computing: float
    """Of the control, from what it reads to its references (control periods)."""
    recorder: Recorder


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConditions:
    """Conditions of one test."""

    temperature: float
    """Winding (degC)."""
    bus: float
    """Relative change of the bus voltage."""
    load: float
    """Torque on the surface (N m)."""
    noise: tuple[float, float, float]
    """Factors on the noise of speed, current and position."""
    gain: tuple[float, float, float]
    """Relative gain errors of the current sensors."""
    offset: tuple[float, float, float]
    """Offsets of the current sensors (A)."""
    recorder: Recorder | None
    """None: the unit's own."""
    seed: int

    @property
    def start(self) -> tuple[float, float]:
        """How surface and shaft stand when the test begins, for `ema_sim.simulate.start_of`."""
        return _two(np.random.default_rng([self.seed, 1]), -1.0, 1.0)


def _two(rng: np.random.Generator, low: float, high: float) -> tuple[float, float]:
    a, b = rng.uniform(low, high, 2)
    return float(a), float(b)


def _three(rng: np.random.Generator, bound: float) -> tuple[float, float, float]:
    a, b, c = rng.uniform(-bound, bound, 3)
    return float(a), float(b), float(c)


def _recorder(rng: np.random.Generator, share: float) -> Recorder:
    """Return a recorder that is each of `OTHER_RECORDERS` with probability `share`."""
    place, chosen = float(rng.uniform()) / share, int(rng.integers(1, 2**len(CHANNELS)))
    kind = OTHER_RECORDERS[int(place)] if place < len(OTHER_RECORDERS) else "declared"
    return Recorder(kind, tuple(n for k, n in enumerate(CHANNELS) if chosen >> k & 1))


def draw_unit(rng: np.random.Generator, spread: UnitTolerances) -> Unit:
    """Return a unit of the fleet."""
    def one(bound: float) -> float:
        return float(rng.uniform(-bound, bound))

    more = rng.spawn(1)[0]
    third, fifth, seventh = more.uniform(-1.0, 1.0, 3).tolist()
    log_viscous = math.log(spread.viscous_factor)
    first, second = _two(rng, -log_viscous, log_viscous)
    return Unit(
        resistance=one(spread.resistance), inductance=one(spread.inductance),
        back_emf=one(spread.back_emf), back_emf_phase=_three(rng, spread.back_emf_phase),
        flat_top=one(spread.flat_top), motor_friction=one(spread.motor_friction),
        surface_friction=one(spread.surface_friction),
        static_ratio=_two(rng, -spread.static_ratio, spread.static_ratio),
        viscous=(math.exp(first), math.exp(second)),
        inertia=_two(rng, -spread.inertia, spread.inertia),
        stiffness=one(spread.stiffness), damping=one(spread.damping),
        gains=_three(rng, spread.control_gain),
        current_gains=_two(rng, -spread.control_gain, spread.control_gain),
        hysteresis=one(spread.hysteresis), backlash=one(spread.backlash),
        latency=_two(rng, 0.0, spread.latency),
        computing=float(more.uniform(0.0, min(COMPUTING, spread.latency))),
        recorder=_recorder(rng, RECORDER_SHARE),
        harmonics=(third * harmonic_spread(3, spread.flat_top),
                   fifth * harmonic_spread(5, spread.flat_top),
                   seventh * harmonic_spread(7, spread.flat_top)),
    )


def noise_range(spread: Conditions) -> tuple[float, float]:
    """Return least and most of the factor on the noise; the least is 1 % of the most at least."""
    most = max(spread.noise_most, 1e-9)
    return max(spread.noise_least, 0.01 * most), most


def draw_conditions(rng: np.random.Generator, spread: Conditions) -> RunConditions:
    """Return conditions of one test; the noise evenly in its logarithm, see `noise_range`."""
    least, most = noise_range(spread)
    speed, current, position = np.exp(rng.uniform(math.log(least), math.log(most), 3))
    return RunConditions(
        temperature=float(rng.uniform(spread.temperature_least, spread.temperature_most)),
        bus=float(rng.uniform(-spread.bus, spread.bus)),
        load=float(rng.uniform(-spread.load, spread.load)),
        noise=(float(speed), float(current), float(position)),
        gain=_three(rng, spread.current_gain), offset=_three(rng, spread.current_offset),
        recorder=_recorder(rng, 1.0 / (1 + len(OTHER_RECORDERS)))
        if rng.uniform() < RECORDER_SHARE else None,
        seed=int(rng.integers(2**31)),
    )


def actuator_of(nominal: Actuator, unit: Unit, conditions: RunConditions) -> Actuator:
    """Return the actuator of a unit, its sensors and recorder as in one test."""
    speed, current, position = conditions.noise
    recorder = conditions.recorder or unit.recorder
    motor, surface, acquisition = nominal.motor, nominal.surface, nominal.acquisition
    dry_m = motor.dynamic_friction * (1.0 + unit.motor_friction)
    dry_s = surface.dynamic_friction * (1.0 + unit.surface_friction)
    over_m, over_s = (
        max(1.0, (1.0 + part) * (static / dynamic if dynamic > 0.0 else 1.0))
        for part, static, dynamic in zip(
            unit.static_ratio, (motor.static_friction, surface.static_friction),
            (motor.dynamic_friction, surface.dynamic_friction)))
    return nominal._replace(
        drive=_times(nominal.drive, proportional_gain=1.0 + unit.current_gains[0],
                     integral_gain=1.0 + unit.current_gains[1]),
        inverter=_times(nominal.inverter, hysteresis=1.0 + unit.hysteresis),
        motor=_times(
            motor, back_emf_constant=1.0 + unit.back_emf, phase_resistance=1.0 + unit.resistance,
            phase_inductance=1.0 + unit.inductance, inertia=1.0 + unit.inertia[0],
            viscous_friction=unit.viscous[0],
        )._replace(
            back_emf_deviation_a=unit.back_emf_phase[0],
            back_emf_deviation_b=unit.back_emf_phase[1],
            back_emf_deviation_c=unit.back_emf_phase[2],
            flat_top=float(np.clip(motor.flat_top + unit.flat_top, 0.0, math.pi)),
            harmonic_3=motor.harmonic_3 + unit.harmonics[0],
            harmonic_5=motor.harmonic_5 + unit.harmonics[1],
            harmonic_7=motor.harmonic_7 + unit.harmonics[2],
            dynamic_friction=dry_m, static_friction=dry_m * over_m,
        ),
        surface=_times(
            surface, inertia=1.0 + unit.inertia[1], viscous_friction=unit.viscous[1],
        )._replace(dynamic_friction=dry_s, static_friction=dry_s * over_s),
        shaft=_times(nominal.shaft, stiffness=1.0 + unit.stiffness, damping=1.0 + unit.damping,
                     backlash=1.0 + unit.backlash),
        control=_times(nominal.control, position_gain=1.0 + unit.gains[0],
                       proportional_gain=1.0 + unit.gains[1], integral_gain=1.0 + unit.gains[2]),
        converters=_converters(nominal.converters, recorder),
        noise=_times(nominal.noise, speed=speed, current=current, position=position),
        acquisition=acquisition._replace(
            command_latency=acquisition.command_latency + unit.latency[0],
            reference_latency=acquisition.reference_latency + unit.latency[1],
            sampling=acquisition.sampling if recorder.kind != "sampled"
            else MEAN if acquisition.sampling == INSTANT else INSTANT,
        ),
    )


def _times(section: Any, **factors: float) -> Any:
    """Return a section of a description with some of its values multiplied."""
    return section._replace(**{n: getattr(section, n) * by for n, by in factors.items()})


def _converters(declared: Converters, recorder: Recorder) -> Converters:
    """Return the converters of a recorder."""
    if recorder.kind == "exact":
        return declared._replace(**dict.fromkeys(CHANNELS, EXACT_BITS))
    if recorder.kind == "truncating":
        return declared._replace(speed_offset=-0.5)
    if recorder.kind == "coarse":
        return declared._replace(**{
            n: min(getattr(declared, n), COARSE_BITS) for n in recorder.coarse})
    return declared


def effects_of(
    nominal: Actuator, unit: Unit, conditions: RunConditions, fault: InjectedFault,
    own: Effects | None = None,
) -> Effects:
    """Return the effects of one test: of the model, if it has any, of unit, conditions, fault."""
    c = conditions
    settings = [
        f"winding_temperature.temperature={c.temperature!r}",
        f"bus_voltage_change.change={c.bus!r}", f"surface_load.constant={c.load!r}",
        *(f"current_sensor_gain.phase_{p}={v!r}" for p, v in zip("abc", c.gain)),
        *(f"current_sensor_offset.phase_{p}={v!r}" for p, v in zip("abc", c.offset)),
        *fault.settings,
    ]
    effects = parse_effects(settings, own)
    return effects._replace(control_delay=ControlDelay(
        effects.control_delay.delay + unit.computing * nominal.control.period))


def start_left_by(
    actuator: Actuator, effects: Effects, profile: Profile, shares: Sequence[float]
) -> tuple[float, float]:
    """Return how the last move leaves surface and shaft, with the friction and play of effects."""
    surface, shaft = actuator.surface, actuator.shaft
    return start_of(actuator._replace(
        surface=surface._replace(static_friction=surface.static_friction * (
            1.0 + effects.surface_friction.increase)),
        shaft=shaft._replace(backlash=shaft.backlash + effects.backlash.increase)),
        profile, shares)
