"""Effect-free units for the peer's thresholds: the same spreads, seeds of their own."""

from __future__ import annotations

import numpy as np

from ema_record.profile import load_profile
from ema_record.record import Record
from ema_sim.effects.settings import effects_from_mapping
from ema_sim.model_file import load_actuator
from ema_sim.simulate import simulate

SEED = 550_001


def null_records(count: int) -> list[Record]:
    """Return records of effect-free units of the panel's spreads (item 2 of the prognostics)."""
    profile = load_profile("extended")
    records = []
    for k in range(count):
        rng = np.random.default_rng([SEED, k])
        a = load_actuator()

        def off(share: float, rng: np.random.Generator = rng) -> float:
            return 1.0 + float(rng.uniform(-share, share))

        dry, outer = off(0.1), off(0.1)
        motor = a.motor._replace(
            phase_resistance=a.motor.phase_resistance * off(0.1),
            phase_inductance=a.motor.phase_inductance * off(0.1),
            back_emf_constant=a.motor.back_emf_constant * off(0.03),
            back_emf_deviation_a=off(0.005) - 1.0, back_emf_deviation_b=off(0.005) - 1.0,
            back_emf_deviation_c=off(0.005) - 1.0, inertia=a.motor.inertia * off(0.1),
            dynamic_friction=a.motor.dynamic_friction * dry,
            static_friction=a.motor.static_friction * dry)
        surface = a.surface._replace(
            inertia=a.surface.inertia * off(0.1),
            dynamic_friction=a.surface.dynamic_friction * outer,
            static_friction=a.surface.static_friction * outer)
        shaft = a.shaft._replace(stiffness=a.shaft.stiffness * off(0.1))
        effects = {
            "winding_temperature.temperature": float(rng.uniform(-40.0, 70.0)),
            "bus_voltage_change.change": off(0.1) - 1.0,
            "surface_load.constant": float(rng.uniform(-19.0, 19.0)),
        }
        for phase in "abc":
            effects[f"current_sensor_gain.phase_{phase}"] = off(0.01) - 1.0
            effects[f"current_sensor_offset.phase_{phase}"] = float(rng.uniform(-0.05, 0.05))
        records.append(simulate(
            profile, actuator=a._replace(motor=motor, surface=surface, shaft=shaft),
            effects=effects_from_mapping(effects), seed=SEED + k,
            noise=float(2.0 ** rng.uniform(-1.0, 1.0))))
    return records
