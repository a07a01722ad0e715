"""What differs between two healthy units and two days, and what a record tells of it.

A tolerance is estimated from the records within its band (recalibration); those of several records
of one unit stand in one vector, shared ones once. A condition is measured in the record
(temperature, bus voltage, rotor angle at the start, noise) and simply used, so that the simulator
starts alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ema_record.actuator import Actuator
from ema_record.channels import MOTOR_SPEED, PHASE_CURRENTS, measured
from ema_record.record import Record
from ema_sim.effects import EFFECTS, Effects
from ema_sim.machine import TURN
from ema_sim.model_file import Model


class Tolerance(NamedTuple):
    """A parameter of the unit, or of the day, that is not known exactly."""

    name: str
    unit: str
    """Of its deviation, 1 if that is relative."""


TOLERANCES: tuple[Tolerance, ...] = (
    Tolerance("motor.phase_resistance", "1"),
    Tolerance("motor.phase_inductance", "1"),
    Tolerance("motor.dry_friction", "1"),
    Tolerance("surface.dry_friction", "1"),
    Tolerance("motor.back_emf_constant", "1"),
    *(Tolerance(f"motor.back_emf_deviation_{phase}", "1") for phase in "abc"),
    Tolerance("motor.inertia", "1"),
    Tolerance("surface.inertia", "1"),
    Tolerance("shaft.stiffness", "1"),
    *(Tolerance(f"current_sensor_gain.phase_{phase}", "1") for phase in "abc"),
    *(Tolerance(f"current_sensor_offset.phase_{phase}", "A") for phase in "abc"),
    Tolerance("surface_load.constant", "N m"),
)
"""Their bands are the kit's (`fleet.units.half_widths`)."""
N_TOLERANCES = len(TOLERANCES)
REFERENCE_TEMPERATURE = 20.0


class NoiseFactors(NamedTuple):
    """Times the described noise of a sensor, of those whose noise a record shows."""

    speed: float = 1.0
    current: float = 1.0


NOMINAL = NoiseFactors()


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordConditions:
    """What is known of one test."""

    temperature: float = REFERENCE_TEMPERATURE
    """Of the winding (degC)."""
    bus: float = 0.0
    """Relative deviation of the bus voltage at `bus_current`."""
    bus_current: float = 0.0
    """What the inverter draws at that voltage (A): 0, unless the record tells no slope."""
    noise: NoiseFactors = NOMINAL
    start_angle: float = 0.0
    """Electrical rotor angle at the start (rad); of a record, in the first pole pair."""
    measured: frozenset[str] = field(default_factory=frozenset)
    """Which of ``temperature`` and ``bus`` the record measures."""

    def regressors(self) -> np.ndarray:
        """Return temperature, bus and noises, each about -1 to 1, shape (4,)."""
        return np.array([(self.temperature - 15.0) / 55.0, self.bus / 0.1,
                         *(math.log2(factor) for factor in self.noise)])

    def row(self) -> tuple[float, ...]:
        """Return temperature, bus, noises and start angle, as `conditions_of` takes them."""
        return self.temperature, self.bus, *self.noise, self.start_angle


CONDITIONS = len(RecordConditions().row())
"""Numbers of a `RecordConditions.row`."""
NOISES = slice(2, 2 + len(NoiseFactors._fields))
"""Noises in it."""


def conditions_of(row: np.ndarray) -> RecordConditions:
    """Return the conditions of a row, shape (5,), all measured."""
    temperature, bus, speed, current, angle = map(float, row)
    return RecordConditions(
        temperature=temperature, bus=bus, noise=NoiseFactors(speed, current), start_angle=angle,
        measured=frozenset({"temperature", "bus"}))


def realise(
    model: Model, off: np.ndarray, conditions: RecordConditions, effects: Effects | None = None
) -> tuple[Actuator, Effects]:
    """Return the actuator and effects of a unit under conditions.

    Parameters
    ----------
    model : the model under test.
    off : ndarray, shape (18,), deviations of `TOLERANCES`, in their units.
    conditions : of the test.
    effects : in place of those of the model.
    """
    value = {t.name: float(x) for t, x in zip(TOLERANCES, off)}
    a, e = model.actuator, model.effects if effects is None else effects
    motor, surface = a.motor, a.surface
    dry_m, dry_s = 1.0 + value["motor.dry_friction"], 1.0 + value["surface.dry_friction"]
    a = a._replace(
        motor=motor._replace(
            phase_resistance=motor.phase_resistance * (1.0 + value["motor.phase_resistance"]),
            phase_inductance=motor.phase_inductance * (1.0 + value["motor.phase_inductance"]),
            back_emf_constant=motor.back_emf_constant * (1.0 + value["motor.back_emf_constant"]),
            **{name: getattr(motor, name) + value[f"motor.{name}"]
               for name in (f"back_emf_deviation_{p}" for p in "abc")},
            inertia=motor.inertia * (1.0 + value["motor.inertia"]),
            dynamic_friction=motor.dynamic_friction * dry_m,
            static_friction=motor.static_friction * dry_m,
        ),
        surface=surface._replace(
            inertia=surface.inertia * (1.0 + value["surface.inertia"]),
            dynamic_friction=surface.dynamic_friction * dry_s,
            static_friction=surface.static_friction * dry_s,
        ),
        shaft=a.shaft._replace(stiffness=a.shaft.stiffness * (1.0 + value["shaft.stiffness"])),
        noise=a.noise._replace(speed=a.noise.speed * conditions.noise.speed,
                               current=a.noise.current * conditions.noise.current),
    )
    gain, offset, load = e.current_sensor_gain, e.current_sensor_offset, e.surface_load
    e = e._replace(
        current_sensor_gain=gain._replace(**{
            f: getattr(gain, f) + value[f"current_sensor_gain.{f}"] for f in gain._fields}),
        current_sensor_offset=offset._replace(**{
            f: getattr(offset, f) + value[f"current_sensor_offset.{f}"] for f in offset._fields}),
        surface_load=load._replace(constant=load.constant + value["surface_load.constant"]),
    )
    if "temperature" in conditions.measured or _neutral(e, "winding_temperature"):
        e = e._replace(winding_temperature=e.winding_temperature._replace(
            temperature=conditions.temperature))
    if "bus" in conditions.measured or _neutral(e, "bus_voltage_change"):
        drop = e.bus_voltage_sag.resistance * conditions.bus_current
        e = e._replace(bus_voltage_change=e.bus_voltage_change._replace(
            change=conditions.bus + drop / (2.0 * a.inverter.bus_voltage)))
    return a, e


def _neutral(effects: Effects, name: str) -> bool:
    return EFFECTS[name].is_neutral(getattr(effects, name))


NOISE_RANGE = (0.1, 20.0)
"""Factors on the sensor noise that are believed."""
FEWEST_VALUES = 4
"""Of a speed at rest: one that reads fewer shows the steps of its converter, not its noise."""
PARTS, PART_SAMPLES = 8, 16
"""Into so many parts a rest is cut at most, of at least so many samples, to tell noise from
motion: of some 2 ms, where the shaft swings in 20."""


def align(record: Record, model: Model) -> RecordConditions:
    """Return the conditions of a test, read off its record."""
    found = set()
    temperature = REFERENCE_TEMPERATURE
    if len(winding := measured(record.winding_temperature)):
        temperature = float(np.mean(winding[:, 1]))
        found.add("temperature")
    bus = drawn = 0.0
    rails, voltages = measured(record.dc_bus), measured(record.dc_bus[:, 1])
    if len(voltages):
        voltage, drawn = _supply(rails) if len(rails) else (float(voltages.mean()), 0.0)
        bus = voltage / (2.0 * model.actuator.inverter.bus_voltage) - 1.0
        found.add("bus")
    # Of the first samples alone: a load turns the rotor as soon as nothing holds it.
    first = record.channel("rotor_angle")[:max(1, record.at_rest.start)]
    turned = np.exp(1j * first).mean()
    return RecordConditions(
        temperature=temperature, bus=bus, bus_current=drawn, noise=_noise(record, model),
        start_angle=float(np.angle(turned)) % TURN, measured=frozenset(found),
    )


def _supply(rails: np.ndarray) -> tuple[float, float]:
    """Return a voltage between the rails (V) and the current that is drawn at it (A).

    Where currents differ enough that at none, else the means.
    """
    voltage, current = rails[:, 1], rails[:, 2]
    if len(voltage) >= 3 and float(np.ptp(current)) >= 0.5:
        slope, level = np.polyfit(current, voltage, 1)
        if abs(slope) < 2.0:
            return float(level), 0.0
    return float(voltage.mean()), float(current.mean())


def _variance(values: np.ndarray) -> np.ndarray:
    """Return the variance of noise, shape (n, m) -> (m,): about a parabola in each of some parts.

    A load turns the rotor while nothing holds it, which is motion and no noise.
    """
    squares, freedom = np.zeros(values.shape[1]), 0
    for part in np.array_split(values, max(1, min(PARTS, len(values) // PART_SAMPLES))):
        basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, len(part)), 3))[0]
        squares += ((part - basis @ (basis.T @ part)) ** 2).sum(axis=0)
        freedom += len(part) - 3
    return squares / freedom


def _noise(record: Record, model: Model) -> NoiseFactors:
    """Return the factors on the noise, from what is read while the inverter is off.

    Where the speed shows none, that of the currents.
    """
    a = model.actuator
    nominal = a.sample_noise(record.rate)
    rest = record.samples[record.at_rest]
    if len(rest) < 40 or nominal.current <= 0.0:
        return NoiseFactors()
    speed, currents = rest[:, MOTOR_SPEED], rest[:, PHASE_CURRENTS]
    current = math.sqrt(float(_variance(currents).mean())) / nominal.current
    shown = current
    if nominal.speed > 0.0 and len(np.unique(speed)) >= FEWEST_VALUES:
        c = a.converters
        step = a.acquisition.converters * c.speed_range / 2.0**c.speed_bits
        rounding = step**2 / 12.0  # of an even error
        shown = math.sqrt(max(float(_variance(speed[:, None])[0]) - rounding, 0.0)) / nominal.speed
    return NoiseFactors(*(float(np.clip(x, *NOISE_RANGE)) for x in (shown, current)))
