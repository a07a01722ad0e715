"""`ActuatorServer`: the emulated actuator with its topics, without the middleware.

The simulated time is paced to real time by deadlines, so that no error adds up.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ema_record.actuator import Actuator
from ema_record.channels import MOTOR_SPEED, SURFACE_POSITION, TIME
from ema_record.errors import UsageError
from ema_record.limits import MAX_DURATION
from ema_record.profile import Profile, load_profile_dict
from ema_record.wire.samples import encode_samples
from ema_record.wire.sensors import encode_dc_bus, encode_joint_states, encode_temperature
from ema_record.wire.topics import (
    COMMAND,
    DC_BUS,
    JOINT_STATES,
    PHASE_CURRENTS,
    SAMPLES,
    WINDING_TEMPERATURE,
)
from ema_record.wire.trajectory import UNNAMED, profile_from_points
from ema_record.wire.types import NANOSECONDS
from ema_sim.model_file import load_model_file
from ema_sim.node.settings import SimulatorSettings, parameter_specs, settings_from
from ema_sim.plant.state import THETA_E

INVERTER_OFF = 0.020
"""Time without current at the begin of a run (s)."""
SETTLING = 6.0
"""Added to the slewing time of a single step, in time constants of the position control."""

LEAST_SETTLING = 0.05
"""The same in s, at least: shaft and currents settle too."""
FASTEST_RAMP = 1.05
"""Of a ramp that is obeyed (of the slew speed); a step may ask for any speed."""
OVERSPEED, OVERTRAVEL = 1.5, 1.05
"""At which the surface is stopped (of the slew speed, of the way to the end stop)."""
SLOWEST_LOOP = 1.0
"""Least gain of a position control that settles (1/s)."""


def profile_of_command(
    points: Sequence[tuple[float, float]], position: float, actuator: Actuator
) -> Profile:
    """Return the profile of a command.

    Parameters
    ----------
    points : (time (s), position (rad)). One point is a step there, executed as soon as the
        inverter is on; its time, if later, is when the run ends. Several are the profile.
    position : where the surface stands (rad).
    actuator : its slew speed and its position control set the length of a single step.

    Raises
    ------
    UsageError
        A time or a position out of bounds, times that run back, or a ramp that is too steep.
    """
    if len(points) > 1:
        profile = profile_from_points(points)
        _check_ramps(profile, FASTEST_RAMP * actuator.slew_speed)
        return profile
    (time, target), = points
    way = abs(target - position) / actuator.slew_speed
    end = min(max(time, INVERTER_OFF + way + settling_time(actuator)), MAX_DURATION)
    stop = actuator.surface.end_stop
    at = min(max(position, -stop), stop)  # it reads beyond it where its transducer is off
    step = [(0.0, at), (INVERTER_OFF, at), (INVERTER_OFF, target), (end, target)]
    return load_profile_dict(
        {"name": UNNAMED, "points": step, "description": f"step read off {COMMAND}"}, COMMAND
    )


def settling_time(actuator: Actuator) -> float:
    """Return how long the position control takes to settle (s)."""
    gain = max(actuator.control.position_gain, SLOWEST_LOOP) / actuator.gear.ratio
    return max(SETTLING / gain, LEAST_SETTLING)


def _check_ramps(profile: Profile, fastest: float) -> None:
    """Raise UsageError where a ramp is steeper than `fastest` (rad/s)."""
    for (t0, p0), (t1, p1) in zip(profile.points, profile.points[1:]):
        if t1 > t0 and abs(p1 - p0) > fastest * (t1 - t0):
            raise UsageError(
                f"{COMMAND}: {abs(p1 - p0) / (t1 - t0):.3g} rad/s from {t0:g} s on, at most "
                f"{fastest:.3g} rad/s: give the ramp more time, or command a step"
            )


UNPACED_BUDGET = 0.010
"""Wall time of one turn when the simulation runs as fast as it can (s)."""


def compile_kernel() -> None:
    """Compile all that a node needs, into the cache beside the sources, so that none waits."""
    model = load_model_file()
    values = {spec.name: spec.default for spec in parameter_specs(model)}
    ActuatorServer(settings_from(values, model))


IDLE_PERIOD = 0.1
"""Interval of joint states and temperature while idle (s)."""


class Message(NamedTuple):
    """One serialised message."""

    topic: str
    data: bytes


class ActuatorServer:
    """Executes commands block by block and says what is to be published.

    Parameters
    ----------
    settings : what the node's parameters say.
    clock : monotonic clock (s).
    wall_clock : ns since the epoch.
    """

    def __init__(
        self,
        settings: SimulatorSettings,
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], int] = time.time_ns,
    ) -> None:
        """Set up the actuator at its initial position, compiled and idle."""
        self.settings = settings
        self._clock, self._wall_clock = clock, wall_clock
        self._columns = settings.actuator.acquisition.columns
        self._warm_up()
        self.session = settings.session(settings.initial_position)
        self.command_stamp = 0
        """Stamp of the command of the current or last run (ns since the epoch)."""
        self.start_time = 0
        """Acceptance of that command (ns since the epoch)."""
        self.samples_published = 0
        """Samples of the current or last run."""
        self.runs = 0
        self.stopped = ""
        """Why the current or last run was stopped; empty: it was not."""
        self._begin = 0.0
        self._views = settings.decimator()
        self._next_idle = 0.0

    def _warm_up(self) -> None:
        """Compile everything that a run needs, so that no run waits for the compiler."""
        session = self.settings.session(0.0)
        session.command(profile_of_command([(0.0, 0.01)], 0.0, self.settings.actuator))
        views = self.settings.decimator().push(session.advance(self.settings.block_size))
        views.joint_states(0)
        views.phase_currents(0)
        while session.active:
            encode_samples(session.advance(10_000), self._columns)

    @property
    def active(self) -> bool:
        """Whether a command is being executed."""
        return self.session.active

    @property
    def measured_position(self) -> float:
        """Surface position as its transducer gives it, without noise (rad)."""
        offset = self.settings.effects.position_sensor_offset.offset
        return self.session.surface_position + offset

    def command(self, points: Sequence[tuple[float, float]], stamp: int) -> None:
        """Accept a command; an active one is pre-empted.

        Parameters
        ----------
        points : time (s), position of the surface (rad).
        stamp : of the command's header (ns since the epoch).

        Raises
        ------
        UsageError
            The command is out of bounds; what was executed goes on.
        """
        profile = profile_of_command(points, self.measured_position, self.settings.actuator)
        idle = not self.active
        self.session.command(profile)
        if idle:
            self._begin = self._clock()
            self._views = self.settings.decimator()
            self.start_time = self._wall_clock()
            self.samples_published = 0
        self.runs += 1
        self.command_stamp = stamp
        self.stopped = ""

    def stop(self, reason: str) -> None:
        """Stop the surface where it is, hold it until it is at rest, and end the run."""
        end_stop = self.settings.actuator.surface.end_stop
        at = min(max(self.measured_position, -end_stop), end_stop)
        hold = [(0.0, at), (min(settling_time(self.settings.actuator), MAX_DURATION), at)]
        self.session.command(load_profile_dict(
            {"name": "stop", "points": hold, "description": "hold"}, "stop"
        ))
        self.stopped = reason

    def _supervise(self, block: np.ndarray) -> None:
        """Stop where the surface is faster, or further out, than the actuator may be."""
        actuator = self.settings.actuator
        speed = np.abs(block[:, MOTOR_SPEED]).max() / actuator.gear.ratio
        out = np.abs(block[:, SURFACE_POSITION]).max()
        if self.stopped or not self.active:
            return
        if speed > OVERSPEED * actuator.slew_speed:
            self.stop(f"the surface moves at {speed:.3g} rad/s, its slew speed is "
                      f"{actuator.slew_speed:.3g} rad/s")
        elif out > OVERTRAVEL * actuator.surface.end_stop:
            self.stop(f"the surface reads {out:.3g} rad, its end stops are at "
                      f"{actuator.surface.end_stop:g} rad")

    def reconfigure(self, settings: SimulatorSettings) -> None:
        """Put another actuator in the place of this one, where the surface stands (idle only)."""
        session = settings.session(self.session.surface_position)
        self.settings, self.session = settings, session
        self._columns = settings.actuator.acquisition.columns

    def give_up(self) -> None:
        """End the run where it is: the drive is switched off, the surface stays."""
        self.session = self.settings.session(self.session.surface_position)

    def poll(self) -> Iterator[Message]:
        """Return the messages that are due; bounded work a call."""
        if not self.active:
            yield from self._idle()
            return
        now = self._clock()
        rate, factor = self.settings.rate, self.settings.real_time_factor
        due = (now - self._begin) * factor if factor else math.inf
        while self.active and self._clock() - now <= UNPACED_BUDGET:
            if (self.samples_published + self.settings.block_size) / rate > due:
                break
            block = self.session.advance(self.settings.block_size)
            if len(block):
                self.samples_published += len(block)
                self._supervise(block)
                yield from self._block(block)

    def _block(self, block: np.ndarray) -> Iterator[Message]:
        """Return one block of samples with its views, bus and temperature."""
        yield Message(SAMPLES, encode_samples(block, self._columns))
        views = self._views.push(block)
        for data in views.joint_states(self.start_time):
            yield Message(JOINT_STATES, data)
        for data in views.phase_currents(self.start_time):
            yield Message(PHASE_CURRENTS, data)
        stamp = self.start_time + round(float(block[-1, TIME]) * NANOSECONDS)
        yield self._bus(stamp, *self.session.last_bus)
        before = stamp - round(len(block) / self.settings.rate * NANOSECONDS)
        period = round(IDLE_PERIOD * NANOSECONDS)
        if (stamp - self.start_time) // period != (before - self.start_time) // period:
            yield self._temperature(stamp)

    def _idle(self) -> Iterator[Message]:
        """Return the readings at standstill, ten a second."""
        now = self._clock()
        if now < self._next_idle:
            return
        late = now - self._next_idle > IDLE_PERIOD
        self._next_idle = (now if late else self._next_idle) + IDLE_PERIOD
        stamp = self._wall_clock()
        angle, position = float(self.session.state[THETA_E]), self.measured_position
        yield Message(JOINT_STATES, encode_joint_states(
            np.array([stamp]), np.array([[angle, position]]), np.zeros((1, 2))
        )[0])
        yield self._bus(stamp, *self.session.dc_bus)
        yield self._temperature(stamp)

    def _bus(self, stamp: int, voltage: float, current: float) -> Message:
        return Message(DC_BUS, encode_dc_bus(
            np.array([stamp]), np.array([voltage]), np.array([current])
        )[0])

    def _temperature(self, stamp: int) -> Message:
        return Message(WINDING_TEMPERATURE, encode_temperature(
            np.array([stamp]), np.array([self.session.winding_temperature])
        )[0])

    def status(self) -> dict[str, str]:
        """Return what `/diagnostics` says of the actuator."""
        return {
            "state": "active" if self.active else "idle",
            "surface_position": f"{self.measured_position:.6f}",
            "command_stamp": str(self.command_stamp),
            "start_time": str(self.start_time),
            "samples_published": str(self.samples_published),
            "runs": str(self.runs),
        }


if __name__ == "__main__":
    compile_kernel()
