"""What each effect makes of its port, by the equation that its catalogue states.

In plain Python: nothing is compiled. The contract test knows no equation, nor any sign.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, exp, pi, sin

import pytest

from ema_record.actuator import load_actuator
from ema_sim.effects import EFFECTS, Effects, parse_effects
from ema_sim.plant import ports, sensor_ports

A = load_actuator()
M, SURFACE, SHAFT, GEAR, C = A.motor, A.surface, A.shaft, A.gear, A.converters
THIRD = 2.0 * pi / 3.0


def of_phases(port: Callable[[int], float]) -> list[float]:
    return [port(phase) for phase in range(3)]


def resistances(e: Effects) -> list[float]:
    return of_phases(lambda p: ports.phase_resistance(e, M, p) / M.phase_resistance)


def constants(e: Effects) -> list[float]:
    return of_phases(lambda p: ports.phase_constant(e, M, p) / M.back_emf_constant)


def inductances(e: Effects, current: float = 2.0) -> list[float]:
    return of_phases(lambda p: ports.phase_inductance(e, M, p, current) / M.phase_inductance)


def swings(e: Effects, angle: float = 0.4) -> list[float]:
    return of_phases(lambda p: ports.swing(e, p, angle))


def added_torque(e: Effects, omega: float = 50.0, angle: float = 0.4) -> float:
    return ports.added_motor_torque(e, M, 0.03, -0.01, -0.02, omega, angle)


def shape(e: Effects, angle: float = 0.2) -> float:
    return ports.unit_shape(e, M, ports.flat_top(e, M), angle, sin(angle), harmonic=False)


SHORT = "turn_short.fraction=0.2 turn_short.phase=b"
ROTOR = "rotor_eccentricity.zeta=0.1 rotor_eccentricity.angle=0.3 rotor_eccentricity."
RIPPLE = "gear_mesh_ripple.amplitude=1e-4 gear_mesh_ripple.periods=5 gear_mesh_ripple.phase=0.3"
SAG = "bus_voltage_sag.resistance=0.5 bus_voltage_sag.capacitance=2e-3"
STRIBECK = "stribeck_friction.increase=0.5 stribeck_friction.speed=20"
CASES: list[tuple[str, Callable[[Effects], object], object]] = [
    (SHORT, resistances, [1.0, 0.8, 1.0]),
    (SHORT, constants, [1.0, 0.8, 1.0]),
    (SHORT, inductances, [1.0, 0.64, 1.0]),
    (f"{SHORT} turn_short.mode=paper", resistances, [1.0] * 3),
    (f"{SHORT} turn_short.mode=paper", constants, [1.0, 0.8, 1.0]),
    (f"{SHORT} turn_short.fault_conductance=10", added_torque,
     -((0.01 * 0.25) ** 2) * 50.0 / (0.2 * M.phase_resistance + 0.1)),
    (f"{ROTOR}mode=paper rotor_eccentricity.phase=c", swings, [1.0, 1.0, 1.0 + 0.1 * cos(0.1)]),
    (f"{ROTOR}mode=common", swings, [1.0 + 0.1 * cos(0.1)] * 3),
    (f"{ROTOR}mode=shifted", swings, [1.0 + 0.1 * cos(0.1 - k * THIRD) for k in range(3)]),
    (f"{ROTOR}mode=static", swings, [1.0 + 0.1 * cos(0.3 - k * THIRD) for k in range(3)]),
    ("back_emf_shape.flat_top_change=-0.3", shape, 0.2 * 2.0 / (pi - M.flat_top + 0.3)),
    ("back_emf_shape.sine_share=0.25", shape,
     0.75 * 0.2 * 2.0 / (pi - M.flat_top) + 0.25 * sin(0.2)),
    ("back_emf_shape.fifth_harmonic=0.1", shape,
     0.2 * 2.0 / (pi - M.flat_top) + 0.1 * sin(1.0)),
    ("torque_constant_drop.drop=0.1", constants, [0.9] * 3),
    ("winding_temperature.temperature=70", resistances, [1.0 + 0.00393 * 50.0] * 3),
    ("winding_temperature.temperature=70", constants, [1.0 - 1.1e-3 * 50.0] * 3),
    ("phase_resistance_imbalance.increase=0.2 phase_resistance_imbalance.phase=c", resistances,
     [1.0, 1.0, 1.2]),
    ("magnetic_saturation.inverse_current=0.05", inductances, [1.0 / 1.01] * 3),
    ("hall_misalignment.angle=0.1", sensor_ports.commutation_angle, 0.1),
    ("control_delay.delay=3e-4", lambda e: sensor_ports.delay_periods(e, A),
     3e-4 / A.control.period),
    ("cogging_torque.amplitude=0.02 cogging_torque.periods=3 cogging_torque.phase=0.5",
     added_torque, 0.02 * sin(1.7)),
    ("motor_friction.increase=0.5", lambda e: ports.motor_dry_friction(e, M, 50.0, 0.0),
     (1.5 * M.dynamic_friction, 1.5 * M.static_friction)),
    ("surface_friction.increase=0.5", lambda e: ports.surface_dry_friction(e, SURFACE),
     (1.5 * SURFACE.dynamic_friction, 1.5 * SURFACE.static_friction)),
    ("viscous_friction.coefficient=1e-3", lambda e: ports.motor_viscous_friction(e, M, -50.0),
     -50.0 * (M.viscous_friction + 1e-3)),
    (STRIBECK, lambda e: ports.motor_dry_friction(e, M, -10.0, 0.0)[0],
     M.dynamic_friction * (1.0 + 0.5 * exp(-0.25))),
    ("load_dependent_friction.coefficient=0.1",
     lambda e: ports.motor_dry_friction(e, M, 50.0, -0.2),
     (M.dynamic_friction + 0.02, M.static_friction + 0.02)),
    ("backlash.increase=1e-3", lambda e: ports.lost_motion(e, SHAFT), SHAFT.backlash + 1e-3),
    ("shaft_compliance.increase=0.25", lambda e: ports.shaft_stiffness(e, SHAFT),
     SHAFT.stiffness / 1.25),
    (RIPPLE, lambda e: ports.gear_output(e, GEAR, 7.0, 0.4), 7.0 / GEAR.ratio + 1e-4 * sin(2.3)),
    (RIPPLE, lambda e: ports.gear_slope(e, GEAR, 0.4), 1.0 / GEAR.ratio + 5e-4 * cos(2.3)),
    ("inverter_voltage_drop.drop=1.5", lambda e: [
        ports.switch_drop(e, i) for i in (-3.0, -0.05, 0.02, 9.0)], [-1.5, -0.75, 0.3, 1.5]),
    (SAG, lambda e: ports.rail_drop(e, 8.0), 2.0),
    (SAG, lambda e: ports.supply(e, 8.0, 2e-3, 1e-3),  # from 8 A to 2 A by its time of 1 ms
     (2.0 + 6.0 * exp(-1.0), 2e-3 + 1e-3 * 6.0 * (1.0 - exp(-1.0)))),
    ("bus_voltage_change.change=-0.1", lambda e: ports.leg_voltage(e, 100.0), 90.0),
    ("current_sensor_offset.phase_a=0.1 current_sensor_offset.phase_b=0.2",
     lambda e: of_phases(lambda p: sensor_ports.current_offset(e, p)), [0.1, 0.2, 0.0]),
    ("current_sensor_gain.phase_b=0.01 current_sensor_gain.phase_c=-0.02",
     lambda e: of_phases(lambda p: sensor_ports.current_gain(e, p)), [1.0, 1.01, 0.98]),
    ("speed_sensor_runout.amplitude=0.01 speed_sensor_runout.angle=0.3",
     lambda e: sensor_ports.speed_factor(e, 0.4), 1.0 + 0.01 * cos(0.1)),
    ("position_sensor_offset.offset=2e-3", sensor_ports.position_offset, 2e-3),
    ("quantisation.position_bits_lost=3", lambda e: sensor_ports.position_step(e, C),
     8.0 * C.position_range / 2.0**C.position_bits),
    ("quantisation.speed_bits_lost=2", lambda e: sensor_ports.speed_step(e, C),
     4.0 * C.speed_range / 2.0**C.speed_bits),
    ("inertia_change.motor=0.5", lambda e: ports.motor_inertia(e, M), 1.5 * M.inertia),
    ("inertia_change.surface=-0.5", lambda e: ports.surface_inertia(e, SURFACE),
     0.5 * SURFACE.inertia),
    ("surface_load.constant=3 surface_load.slope=20", lambda e: ports.load_torque(e, -0.1), 1.0),
]


@pytest.mark.parametrize(("settings", "port", "expected"), CASES)
def test_port_is_by_the_stated_equation(settings, port, expected):
    assert port(parse_effects(settings.split())) == pytest.approx(expected, rel=1e-12)


def test_every_effect_has_a_closed_form():
    assert {settings.partition(".")[0] for settings, *_ in CASES} == set(EFFECTS)
