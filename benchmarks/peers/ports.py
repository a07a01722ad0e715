"""Regression problems of a record: residuals at the ports and the laws along the trajectory.

Set up to be fair to sparse regression: all laws of the panel's effects are offered at the port
where they show; measured bus and temperature are used; known parameters are first fitted within
their tolerances (bounded least squares), as `identify` may; columns that are parallel at a port
are offered as one that carries both names; response and columns pass the same filter.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear
from scipy.signal import firwin, oaconvolve

from ema_record.actuator import load_actuator
from ema_record.record import Record
from ema_sim.plant.control import speed_control

CUT_OFF = 900.0
"""Of the filter (Hz): keeps 24 a turn at a quarter of the slew speed."""
KEPT = slice(800, -200, 16)
"""Samples that are rows, after the filter: the ends are left out."""
FEWEST = 20
"""Readings of the bus that make a problem."""
PHASES = 3
PARALLEL = 0.995
"""Cosine from which two columns are one."""
ORDERS = (4, 6, 9, 12, 13, 17, 18, 23, 24)
"""Periods a turn that are offered: all that the panel hides, and no others."""
STRIBECK_SPEEDS = (10.0, 25.0, 60.0)
THIRD = 2.0 * np.pi / 3.0
COPPER, MAGNET = 0.00393, -0.0011


@dataclass(slots=True)
class Port:
    """One regression problem under construction."""

    name: str
    response: np.ndarray
    base: list[tuple[np.ndarray, float]] = field(default_factory=list)
    """What recalibration may add: column and bound of its factor."""
    laws: list[tuple[str, np.ndarray]] = field(default_factory=list)
    regime: np.ndarray = field(default_factory=lambda: np.zeros(1, dtype=int))
    """Of each row after filtering: direction of motion, twice, plus 1 where it is fast."""


class Problem(NamedTuple):
    """One regression problem; n rows, b columns of known parameters, k columns of laws."""

    port: str
    columns: np.ndarray
    """Of the laws, rms 1, shape (n, k)."""
    names: list[str]
    """Of the columns: ``effect.law``; several with ``|`` are parallel at this port."""
    response: np.ndarray
    """After recalibration of the known parameters, shape (n,)."""
    raw: np.ndarray
    """Before it."""
    base: np.ndarray
    """What recalibration may add, times factors from -1 to 1, shape (n, b)."""
    regime: np.ndarray


def _smooth(x: np.ndarray) -> np.ndarray:
    taps = firwin(161, CUT_OFF, fs=20_000.0)
    return np.asarray(oaconvolve(x, taps, mode="same"))


def _trapezoid(theta: np.ndarray, top: float = THIRD) -> np.ndarray:
    return np.clip(np.arcsin(np.sin(theta)) / (0.5 * (np.pi - top)), -1.0, 1.0)


def ports_of(record: Record) -> list[Port]:
    """Return the problems of a record, filtered, the inverter-off interval and ends left out."""
    a = load_actuator()
    m, ratio = a.motor, a.gear.ratio
    warm = float(record.winding_temperature[0, 1]) - 20.0
    k = m.back_emf_constant * (1.0 + MAGNET * warm)
    resistance = m.phase_resistance * (1.0 + COPPER * warm)
    w, theta = record.channel("motor_speed"), record.channel("rotor_angle")
    position = record.channel("surface_position")
    i, ref = record.samples[:, 2:5], record.samples[:, 5:8]
    turn = np.unwrap(theta)
    angles = theta[:, None] - np.arange(3) * THIRD
    shape = _trapezoid(angles)
    torque = k * np.sum(shape * i, axis=1)
    smooth_w = _smooth(w)
    rise = np.gradient(smooth_w, 1.0 / record.rate)
    way = np.tanh(smooth_w / 3.0)
    surface = a.surface
    carried = surface.dynamic_friction * way + surface.viscous_friction * smooth_w / ratio
    carried = (carried + surface.inertia * rise / ratio) / ratio
    inertia = m.inertia + surface.inertia / ratio**2
    dry, outer = m.dynamic_friction, surface.dynamic_friction / ratio
    viscous = m.viscous_friction + surface.viscous_friction / ratio**2

    opposed = inertia * rise + viscous * smooth_w + (dry + outer) * way
    motor = Port("motor torque", torque - opposed)
    motor.base = [(-torque, 0.03), (inertia * rise, 0.1), (dry * way, 0.1), (outer * way, 0.1),
                  (np.ones_like(w), 19.0 / ratio)]
    motor.base += [(-k * shape[:, p] * i[:, p], 0.015) for p in range(3)]
    motor.base += [(k * shape[:, p], 0.05) for p in range(3)]
    # Less their mean: the sum of all three is the torque itself, whose scale the balance of
    # torques cannot tell (it is offered at the winding).
    motor.laws = [(f"turn_short.{p}", k * shape[:, p] * i[:, p] - torque / 3.0)
                  for p in range(3)]
    for wave, name in ((np.cos, "cos"), (np.sin, "sin")):
        motor.laws.append((f"rotor_eccentricity.common_{name}", torque * wave(theta)))
        motor.laws.append((f"rotor_eccentricity.shifted_{name}",
                           k * np.sum(shape * i * wave(angles), axis=1)))
        motor.laws.append((f"rotor_eccentricity.static_{name}",
                           k * np.sum(shape * i * wave(np.arange(3) * THIRD), axis=1)))
        for p in range(3):
            motor.laws.append((f"rotor_eccentricity.paper_{p}_{name}",
                               k * shape[:, p] * i[:, p] * wave(theta)))
        for n in ORDERS:
            motor.laws.append((f"cogging_torque.{n}_{name}", wave(n * turn)))
            motor.laws.append((f"gear_mesh_ripple.{n}_{name}",
                               ratio * carried * n * wave(n * turn)))
    narrower = (_trapezoid(angles, THIRD - 0.1) - shape) / 0.1
    edge = (_trapezoid(angles + 0.05) - _trapezoid(angles - 0.05)) / 0.1
    motor.laws += [
        ("back_emf_shape.fifth", k * np.sum(np.sin(5.0 * angles) * i, axis=1)),
        ("back_emf_shape.top", k * np.sum(narrower * i, axis=1)),
        ("hall_misalignment.angle", k * np.sum(edge * i, axis=1)),
        ("magnetic_saturation.slope", k * np.sum(shape * i**3, axis=1)),
        ("motor_friction.increase", dry * way), ("surface_friction.increase", outer * way),
        ("viscous_friction.coefficient", smooth_w),
        ("load_dependent_friction.coefficient", np.abs(carried) * way),
        ("inertia_change.motor", rise), ("inertia_change.surface", rise),
        ("surface_load.constant", np.ones_like(w)), ("surface_load.slope", position),
    ]
    motor.laws += [(f"stribeck_friction.{v:g}", way * np.exp(-((smooth_w / v) ** 2)))
                   for v in STRIBECK_SPEEDS]

    twist = turn / ratio - position
    twist -= np.median(twist[:400])
    shaft = ratio * carried / a.shaft.stiffness
    gear = Port("transmission", twist - shaft - 0.5 * a.shaft.backlash * way)
    gear.base = [(shaft, 0.2), (np.ones_like(w), 1e-3)]
    gear.laws = [("backlash.increase", 0.5 * way), ("shaft_compliance.increase", shaft)]
    for n in ORDERS:
        gear.laws += [(f"gear_mesh_ripple.{n}_cos", np.cos(n * turn)),
                      (f"gear_mesh_ripple.{n}_sin", np.sin(n * turn))]

    slip = Port("speed sensor", w - np.gradient(turn, 1.0 / record.rate))
    slip.laws = [("speed_sensor_runout.cos", w * np.cos(theta)),
                 ("speed_sensor_runout.sin", w * np.sin(theta))]

    asked = np.sum(np.sign(ref) * ref, axis=1) * 0.5 * np.sign(np.sum(shape * ref, axis=1))
    predicted = _controller(record)
    delayed = Port("controller", asked - predicted)
    later = -np.gradient(_smooth(predicted))
    delayed.base = [(np.ones_like(w), 1.0), (later, 1.0)]  # as late as one period
    delayed.laws = [("control_delay.delay", later)]

    error, way_ref = i - ref, np.sign(np.round(ref, 2))
    electrical = Port("winding", error.T.ravel())
    flat = (way_ref, ref, shape * w[:, None], np.gradient(ref, axis=0))
    electrical.base = [(flat[3].T.ravel(), 10.0), (resistance * flat[1].T.ravel(), 0.1)]
    electrical.laws = [("inverter_voltage_drop.drop", flat[0].T.ravel()),
                       ("torque_constant_drop.drop", flat[2].T.ravel())]
    for p in range(3):
        only = np.zeros_like(ref)
        only[:, p] = ref[:, p]
        electrical.laws.append((f"phase_resistance_imbalance.{p}", only.T.ravel()))
        electrical.laws.append((f"turn_short.{p}", (only * np.abs(w)[:, None]).T.ravel()))
    speed = smooth_w[KEPT]
    regime = 2 * (speed > 0.0) + (np.abs(speed) > 0.5 * np.quantile(np.abs(speed), 0.9))
    found = [_filtered(port, regime) for port in (motor, gear, slip, delayed, electrical)]
    bus = record.dc_bus
    if len(bus) >= FEWEST:
        flat = np.ones(len(bus))
        found.append(Port("supply", bus[:, 1] - np.mean(bus[:, 1]), [(flat, 1e3)],
                          [("bus_voltage_sag.resistance", -bus[:, 2])],
                          np.zeros(len(bus), dtype=int)))
    return found


def _controller(record: Record) -> np.ndarray:
    """Return the current that the nominal controller asks for, replayed on the record (A)."""
    a = load_actuator()
    c = a.control
    command = record.profile.command(record.time)
    wanted = np.clip(c.position_gain * (command - record.channel("surface_position")),
                     -c.speed_limit, c.speed_limit)
    error = wanted - record.channel("motor_speed")
    found, integral = np.zeros(len(record)), 0.0
    on = int(record.profile.inverter_off * record.rate)
    for n in range(on, len(record)):
        found[n], integral = speed_control(
            error[n], integral, c.proportional_gain, c.integral_gain, c.period,
            a.inverter.current_limit)
    return found


def _filtered(port: Port, regime: np.ndarray) -> Port:
    """Return the port with all columns filtered, thinned and cut."""
    count = len(port.response) // PHASES if port.name == "winding" else len(port.response)

    def treat(column: np.ndarray) -> np.ndarray:
        parts = [_smooth(part)[KEPT] for part in np.split(column, len(column) // count)]
        return np.concatenate(parts)

    response = treat(port.response)
    return Port(port.name, response, [(treat(c), bound) for c, bound in port.base],
                [(name, treat(c)) for name, c in port.laws],
                np.tile(regime, len(response) // len(regime)))


def recalibrated(raw: np.ndarray, base: np.ndarray, rows: np.ndarray | None = None) -> np.ndarray:
    """Return `raw` less what known parameters take away, fitted within bounds to `rows`."""
    if not base.shape[1]:
        return raw
    some = slice(None) if rows is None else rows
    return np.asarray(raw - base @ lsq_linear(base[some], raw[some], bounds=(-1.0, 1.0)).x)


def problems_of(record: Record, without: tuple[str, ...] = ()) -> list[Problem]:
    """Return the problems of a record; laws of the effects `without` are not offered."""
    found = []
    for port in ports_of(record):
        port.laws = [law for law in port.laws if law[0].partition(".")[0] not in without]
        columns: list[np.ndarray] = []
        names: list[str] = []
        for name, column in port.laws:
            size = float(np.sqrt(np.mean(column**2)))
            if size < 1e-12:
                continue
            unit = column / size
            for place, other in enumerate(columns):
                if abs(np.mean(unit * other)) > PARALLEL:
                    names[place] += f"|{name}"
                    break
            else:
                columns.append(unit)
                names.append(name)
        if columns:
            base = np.array([column * bound for column, bound in port.base]).T.reshape(
                len(port.response), -1)
            found.append(Problem(port.name, np.stack(columns, axis=1), names,
                                 recalibrated(port.response, base), port.response, base,
                                 port.regime))
    return found
