"""`simulate`: one test on the emulated actuator, as a `Record`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ema_record.actuator import Actuator, load_actuator
from ema_record.channels import TIME
from ema_record.profile import Profile
from ema_record.record import Provenance, Record
from ema_record.version import VERSION
from ema_sim.effects.registry import Effects
from ema_sim.plant.kernel import MAX_STEP
from ema_sim.session import ActuatorSession

AUXILIARY_PERIOD = 0.1
"""Interval of bus and temperature readings (s)."""


class Simulation(NamedTuple):
    """A record together with what no sensor sees."""

    record: Record
    trace: np.ndarray
    """Shape (n, 3): motor torque (N m), shaft torque (N m), surface speed (rad/s)."""
    state: np.ndarray
    """State at the end of the record, indices in `ema_sim.plant.state`."""


def simulate(
    profile: Profile,
    *,
    actuator: Actuator | None = None,
    effects: Effects | None = None,
    seed: int = 0,
    noise: float = 1.0,
    rate: float | None = None,
    start_angle: float | None = None,
    start: tuple[float, float] | None = None,
    serial_number: str = "SIM-0000",
    start_time: int = 0,
    switching: bool = False,
) -> Record:
    """Run one test and return its record; channels that are not recorded are not numbers.

    Parameters
    ----------
    profile : the position command.
    actuator : parameters, default the nominal ones.
    effects : what is hidden in the actuator, default nothing.
    seed : of noise and start angle; the same seed gives the same bytes.
    noise : factor on the sensor noise, 0 for none.
    rate : samples a second, default that of the actuator's acquisition.
    start_angle : electrical rotor angle at the start (rad), default drawn from the seed; a pole
        pair further it is another mechanical one.
    start : surface position and twist of the shaft at the start (rad), default that of the
        profile and a relaxed shaft.
    serial_number : of the actuator, for the record.
    start_time : acceptance of the command (ns since the epoch), for the record.
    switching : simulate the edges of a carrier (drives pwm and foc), not means of its periods.

    Raises
    ------
    UsageError, SimulationError.
    """
    return simulate_traced(
        profile, actuator=actuator, effects=effects, seed=seed, noise=noise, rate=rate,
        start_angle=start_angle, start=start, serial_number=serial_number, start_time=start_time,
        trace=False, switching=switching,
    ).record


def start_of(
    a: Actuator, profile: Profile, shares: Sequence[float] | np.ndarray,
) -> tuple[float, float]:
    """Return surface position and twist of the shaft when a test begins (rad).

    As friction has held them since the last move: `shares`, from -1 to 1, of what the motor of
    the type `a` turns before a surface at rest starts.
    """
    reach, stop = a.wind_up / a.gear.ratio, a.surface.end_stop
    position, twist = (reach * float(x) for x in shares)
    return float(np.clip(profile.start + position, -stop, stop)), twist


def simulate_traced(
    profile: Profile,
    *,
    actuator: Actuator | None = None,
    effects: Effects | None = None,
    seed: int = 0,
    noise: float = 1.0,
    rate: float | None = None,
    start_angle: float | None = None,
    start: tuple[float, float] | None = None,
    serial_number: str = "SIM-0000",
    start_time: int = 0,
    trace: bool = True,
    max_step: float = MAX_STEP,
    switching: bool = False,
) -> Simulation:
    """Run one test and return its record with torques, surface speed and final state."""
    actuator = load_actuator() if actuator is None else actuator
    session = ActuatorSession(
        actuator, effects, seed=seed, noise=noise, rate=rate, start_angle=start_angle,
        position=profile.start if start is None else start[0],
        twist=0.0 if start is None else start[1], trace=trace, max_step=max_step,
        settle=False, switching=switching,
    )
    session.command(profile)
    block = max(1, math.ceil(AUXILIARY_PERIOD * session.rate))
    samples, current = session.advance_reading(session.samples_left, block)
    times = samples[np.minimum(np.arange(1, len(current) + 1) * block, len(samples)) - 1, TIME]
    bus = [(t, session.bus_voltage(i), i) for t, i in zip(times, current)]
    record = Record(
        samples=samples,
        profile=profile,
        provenance=Provenance(
            serial_number=serial_number, software_version=VERSION, start_time=start_time
        ),
        dc_bus=np.array(bus),
        winding_temperature=np.column_stack(
            [times, np.full(len(times), session.winding_temperature)]),
    )
    return Simulation(record, session.take_trace(), session.final_state)
