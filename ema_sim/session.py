"""`ActuatorSession`: the emulated actuator, run block by block (what the node holds)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ema_record.actuator import Actuator
from ema_record.channels import N_CHANNELS, TIME
from ema_record.errors import SimulationError, UsageError, bounded
from ema_record.profile import Profile
from ema_sim.acquisition import SensorNoise, convert, effective_converters
from ema_sim.drives import check_drive
from ema_sim.effects.registry import Effects
from ema_sim.plant import kernel as k
from ema_sim.plant import state as st

RATES = (1_000.0, 1_000_000.0)
"""Bounds of the acquisition rate (1/s)."""
NOISE_LEVELS = (0.0, 100.0)
SETTLE_TIME = 1.0
NOTHING_READ = (0, np.empty(0))
"""First control period, and commanded positions from it on (rad)."""


class Commanded(NamedTuple):
    """A profile and from when on it is commanded."""

    profile: Profile
    begin: float
    """Time of its beginning (s)."""
    first: int
    """First control period."""


class ActuatorSession:
    """An actuator that answers commands; time stands still while it is idle.

    Parameters
    ----------
    actuator, effects : parameters.
    seed : of the sensor noise and, if `start_angle` is None, of the start angle.
    noise : factor on the sensor noise.
    rate : samples a second, default that of the actuator's acquisition.
    start_angle : electrical rotor angle at the start (rad).
    position, twist : of surface and shaft at the start (rad).
    trace : keep torques and surface speed, see `take_trace`.
    max_step : longest step of the integration (s).
    settle : reach the last command after a run, unrecorded; left out, no run may follow.
    switching : simulate the edges of a carrier, not the means of its periods.
    """

    def __init__(
        self,
        actuator: Actuator,
        effects: Effects | None = None,
        *,
        seed: int = 0,
        noise: float = 1.0,
        rate: float | None = None,
        start_angle: float | None = None,
        position: float = -0.4,
        twist: float = 0.0,
        trace: bool = False,
        max_step: float = k.MAX_STEP,
        settle: bool = True,
        switching: bool = False,
    ) -> None:
        """Set the actuator at rest at `position`."""
        rate = actuator.acquisition.rate if rate is None else rate
        check_drive(actuator)
        bounded("noise", noise, *NOISE_LEVELS, "times nominal")
        bounded("rate", rate, *RATES, "samples a second")
        bounded("initial position", position, -actuator.surface.end_stop,
                actuator.surface.end_stop, "rad")
        if seed < 0:
            raise UsageError(f"seed {seed}: must be 0 or more")
        self.actuator = actuator
        self.effects = effects if effects is not None else Effects()
        self.rate = rate
        self._converters = effective_converters(actuator.converters, self.effects)
        self._noise = SensorNoise(actuator, seed, noise, rate)
        if start_angle is None:
            start_angle = float(np.random.default_rng([seed, 1]).uniform(
                0.0, 2.0 * math.pi * actuator.motor.pole_pairs))
        if not math.isfinite(start_angle):
            raise UsageError(f"start angle {start_angle}: must be a finite number (rad)")
        self._state = st.initial_state(actuator, position, start_angle, twist)
        self._profile: Profile | None = None
        self._begin = 0.0
        self._inverter_on = math.inf
        self._keep_trace = trace
        self._max_step = max_step
        self._settle, self._switching = settle, switching
        self._traces: list[np.ndarray] = []
        self._read = NOTHING_READ
        self._asked: list[Commanded] = []
        self.last_bus = (self.bus_voltage(0.0), 0.0)
        """Bus voltage (V) and mean current (A) of the last block."""
        self.final_state = self._state.copy()
        """State with the last sample of the last run."""

    @property
    def active(self) -> bool:
        """Whether a command is being executed."""
        return self._profile is not None

    @property
    def surface_position(self) -> float:
        """True surface position (rad)."""
        return float(self._state[st.THETA_S])

    @property
    def time(self) -> float:
        """Time since the command that started the run was accepted (s)."""
        return float(self._state[st.TIME])

    @property
    def dc_bus(self) -> tuple[float, float]:
        """Voltage between the rails (V) and current (A): the last block's mean, 0 when idle."""
        return self.last_bus if self.active else (self.bus_voltage(0.0), 0.0)

    @property
    def winding_temperature(self) -> float:
        """Temperature of the winding (degC)."""
        return float(self.effects.winding_temperature.temperature)

    @property
    def state(self) -> np.ndarray:
        """A copy of the state, indices in `ema_sim.plant.state`."""
        return self._state.copy()

    def command(self, profile: Profile) -> None:
        """Execute `profile`: from time 0 when idle; in place of the running one when active.

        Raises
        ------
        UsageError
            It commands a position beyond the actuator's own end stops; nothing moves.
        """
        profile.check_within(self.actuator.surface.end_stop)
        if not self.active:
            self._state = st.restart(self._state, self.actuator)
            self._inverter_on = profile.inverter_off
            self._asked = []
        self._take(profile)

    def _take(self, profile: Profile) -> None:
        """Go by `profile` from now on."""
        first = int(self._state[st.TICK])
        late = math.ceil(self.actuator.acquisition.command_latency) + 1
        kept = [asked for asked, after in zip(self._asked, self._asked[1:])
                if after.first > first - late]
        self._asked = [*kept, *self._asked[-1:], Commanded(profile, self.time, first)]
        self._profile, self._begin, self._read = profile, self.time, NOTHING_READ

    def advance(self, n_samples: int) -> np.ndarray:
        """Return the next samples, shape (k, 10), k <= n_samples; k = 0 when idle.

        The run ends, and the session is idle again, with the last sample of the profile.
        """
        if self._profile is None:
            return np.empty((0, N_CHANNELS))
        return self.advance_reading(n_samples, n_samples)[0]

    @property
    def samples_left(self) -> int:
        """How many samples the present run still has, 0 when idle."""
        if self._profile is None:
            return 0
        total = round((self._begin + self._profile.duration) * self.rate)
        return total - int(self._state[st.SAMPLE])

    def advance_reading(self, n_samples: int, block: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the next samples, as `advance`, and the bus current in blocks of them.

        Shape (k, 10); shape (m,), mean current (A) over each `block` samples begun.
        """
        left = self.samples_left
        n = min(n_samples, left)
        if n <= 0:
            self._finish()
            return np.empty((0, N_CHANNELS)), np.empty(0)
        bus = np.empty(-(-n // block))
        samples = self._run(n, bus, block)
        current = float(bus[-1])
        self.last_bus = (self.bus_voltage(current), current)
        convert(self._converters, self.actuator.acquisition, samples, self._noise.currents(n))
        if n == left:
            self._finish()
        return samples, bus

    def take_trace(self) -> np.ndarray:
        """Return and forget the trace, shape (n, 3), columns `kernel.TRACE_NAMES`."""
        found = np.concatenate(self._traces) if self._traces else np.empty((0, 3))
        self._traces = []
        return found

    def bus_voltage(self, current: float) -> float:
        """Return the voltage between the rails (V) at the mean bus current (A)."""
        e = self.effects
        nominal = 2.0 * self.actuator.inverter.bus_voltage
        sag = e.bus_voltage_sag.resistance * current
        return nominal * (1.0 + e.bus_voltage_change.change) - sag

    def _run(self, n: int, bus: np.ndarray, block: int) -> np.ndarray:
        assert self._profile is not None
        control = self.actuator.control
        first = int(self._state[st.TICK])
        last = math.floor((self._state[st.SAMPLE] + n) / self.rate / control.period + 1e-6)
        if abs(last * control.period - (self._state[st.SAMPLE] + n) / self.rate) < 1e-9:
            last -= 1  # the period that begins with the next block belongs to that block
        periods = max(0, last - first + 1)
        command = self._commanded(first, max(1, periods))
        noise = self._noise.inside(periods) if periods else np.zeros((1, 2))
        out = np.empty((n, N_CHANNELS))
        trace = np.empty((n if self._keep_trace else 0, len(k.TRACE_NAMES)))
        status = k.kernel(self.actuator.drive.kind, self._switching)(
            self.actuator, self.effects, self._state, command, noise, self._inverter_on,
            self.rate, self._max_step, out, trace, bus, block,
        )
        if status != k.OK:
            raise SimulationError(
                f"simulation at {out[0, TIME]:.4f} s: "
                + ("values are not finite" if status == k.NOT_FINITE else "too many events")
                + ": the parameters are outside what the model holds for"
            )
        if self._keep_trace:
            self._traces.append(trace)
        return out

    def _commanded(self, first: int, periods: int) -> np.ndarray:
        """Return the position that acts at control periods from `first` on, shape (periods,).

        The profile is read once for all that is left of it. The control takes it at its periods,
        so that it acts from the one on that is nearest to its latency.
        """
        assert self._profile is not None
        begin, read = self._read
        if not begin <= first <= begin + len(read) - periods:
            period = self.actuator.control.period
            latency = self.actuator.acquisition.command_latency
            end = math.ceil((self._begin + self._profile.duration) / period)
            begin, n = first, max(periods, end - first)
            read = self._undelayed(first - math.floor(latency + 0.5), n)
            read.flags.writeable = False  # else numba takes it for another type, and compiles
            self._read = begin, read
        return read[first - begin:first - begin + periods]

    def _undelayed(self, first: int, periods: int) -> np.ndarray:
        """Return what was or will be commanded at control periods from `first` on (rad)."""
        period = self.actuator.control.period
        found = _positions(self._asked[-1].profile, first, periods, period, self._asked[-1].begin)
        for earlier, after in zip(self._asked[-2::-1], self._asked[:0:-1]):
            n = min(after.first - first, periods)
            if n > 0:
                found = found.copy()
                found[:n] = _positions(earlier.profile, first, n, period, earlier.begin)
        return found

    def _finish(self) -> None:
        """Let the drive reach its last command, unrecorded, and switch it off."""
        assert self._profile is not None
        keep, self._keep_trace = self._keep_trace, False
        target = self._profile.points[-1][1]
        self._take(Profile(name="settle", points=((0.0, target), (SETTLE_TIME, target))))
        self.final_state = self._state.copy()
        if self._settle:
            n = round(SETTLE_TIME * self.rate)
            self._run(n, np.empty(1), n)
        self._profile, self._keep_trace = None, keep


@lru_cache(maxsize=8)
def _positions(
    profile: Profile, first: int, periods: int, period: float, begin: float
) -> np.ndarray:
    """Return what `profile`, begun at `begin` (s), commands at control periods from `first` on."""
    found = profile.command((first + np.arange(periods)) * period - begin + 1e-9)
    found.flags.writeable = False
    return found
