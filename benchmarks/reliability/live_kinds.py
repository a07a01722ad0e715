"""Faults of the live system: what is done to the chain while a test runs, and what may follow."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from random import Random
from typing import NamedTuple

from benchmarks.reliability.chain import Chain, slow_reader
from ema_cli.commands.bit import MONITOR, PROGNOSTICS, SIMULATOR

NEIGHBOUR = "EMA-NEIGHBOUR"


class Fault:
    """One fault: what is done while the test records, and when.

    Parameters
    ----------
    found : the chain.
    at : moment since the recording began (s).
    """

    def __init__(self, found: Chain, at: float) -> None:
        """Begin before the fault."""
        self.found, self.at, self.done = found, at, False

    def act(self, now: float) -> None:
        """Do what is due at `now` (s since the recording began)."""
        if not self.done and now >= self.at:
            self.done = True
            self.strike()

    def strike(self) -> None:
        """Do the damage."""

    def lost(self) -> bool:
        """Return whether no answer can come any more."""
        return False

    def end(self) -> None:
        """Undo what would hinder the next test."""

    def wrong(self) -> list[str]:
        """Return what else went wrong."""
        return []


class Nothing(Fault):
    """No fault."""


class SimulatorKilled(Fault):
    """The acquisition dies."""

    def strike(self) -> None:
        """Kill it."""
        self.found.send_signal(SIMULATOR, signal.SIGKILL)


class SimulatorRestarted(SimulatorKilled):
    """The acquisition dies and comes back while the test still waits for it."""

    def strike(self) -> None:
        """Kill and start it."""
        super().strike()
        self.found.process(SIMULATOR).wait(5.0)
        self.found.start(SIMULATOR)


class PrognosticsKilled(Fault):
    """The prognostics die; they are started again after the test."""

    def strike(self) -> None:
        """Kill them."""
        self.found.send_signal(PROGNOSTICS, signal.SIGKILL)


class PeerLost(Fault):
    """The acquisition is cut off for longer than its lease, and comes back."""

    def strike(self) -> None:
        """Stop it."""
        self.found.send_signal(SIMULATOR, signal.SIGSTOP)

    def end(self) -> None:
        """Let it go on."""
        self.found.send_signal(SIMULATOR, signal.SIGCONT)


class AircraftSilent(Fault):
    """Weight on wheels is not sent any more."""

    def strike(self) -> None:
        """Stop sending."""
        self.found.node.send = False

    def end(self) -> None:
        """Send again."""
        self.found.node.send = True
        self.found.node.send_weight_on_wheels()


class WheelsFlap(Fault):
    """Weight on wheels is off for a moment."""

    def strike(self) -> None:
        """Off and on again."""
        for value in (False, True):
            self.found.node.weight_on_wheels = value
            self.found.node.send_weight_on_wheels()

    def end(self) -> None:
        """Stay on the ground."""
        self.found.node.weight_on_wheels = True


class MonitorKilled(Fault):
    """The monitor dies; a new one takes over while the simulator runs."""

    def strike(self) -> None:
        """Kill it."""
        self.found.send_signal(MONITOR, signal.SIGKILL)

    def lost(self) -> bool:
        """Whoever asked is not answered."""
        return self.done and not self.found.runs(MONITOR)


class MonitorEnded(MonitorKilled):
    """The monitor is told to end."""

    def strike(self) -> None:
        """Tell it."""
        self.found.send_signal(MONITOR, signal.SIGTERM)


class SlowConsumer(Fault):
    """A reader of the samples is too slow, and the prognostics are stopped for a while."""

    def __init__(self, found: Chain, at: float) -> None:
        """Start the reader before the test."""
        super().__init__(found, at)
        self._reader = slow_reader()

    def strike(self) -> None:
        """Stop the prognostics too."""
        self.found.send_signal(PROGNOSTICS, signal.SIGSTOP)

    def end(self) -> None:
        """Let all go on."""
        self.found.send_signal(PROGNOSTICS, signal.SIGCONT)
        self._reader.kill()
        self._reader.wait()


class ClockBack(Fault):
    """The clock of the host is set back."""

    size = 0.0

    def strike(self) -> None:
        """Set it."""
        assert self.found.clock is not None
        self.found.clock.step(-self.size)


class Neighbour(Fault):
    """Another aircraft, healthy, is tested at the same time on the domain beside."""

    def __init__(self, found: Chain, at: float) -> None:
        """Start its test."""
        super().__init__(found, at)
        domain = int(os.environ["ROS_DOMAIN_ID"])
        environment = {k: v for k, v in os.environ.items() if k != "LD_PRELOAD"}
        self._other = subprocess.Popen(
            [sys.executable, "-m", "ema_cli", "bit", "--domain",
             str(domain + 1 if domain < 101 else domain - 1), "--serial-number", NEIGHBOUR,
             "--out", str(found.out / ".." / f"{found.out.name}_neighbour"), "--json"],
            env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )

    def wrong(self) -> list[str]:
        """Return what is wrong with the other test."""
        out, errors = self._other.communicate(timeout=180.0)
        if self._other.returncode != 0:
            return [f"neighbour: {errors.strip() or out[:300]}"]
        result = json.loads(out)
        same = result["serial_number"] == NEIGHBOUR and NEIGHBOUR in result["record"]
        return [] if same and result["passed"] else [f"neighbour: {result['serial_number']}"]


class Kind(NamedTuple):
    """One kind of fault."""

    name: str
    make: Callable[[Chain, Random], Fault]
    limit: float
    """Longest time to the answer (s)."""
    ends: tuple[str, ...]
    """How the test may end."""


def _clock_back(found: Chain, rng: Random) -> Fault:
    fault = ClockBack(found, rng.uniform(0.0, 3.0))
    fault.size = rng.choice([0.05, 0.5, 5.0, 60.0, 3600.0])
    return fault


def _at(kind: type[Fault], last: float = 2.9) -> Callable[[Chain, Random], Fault]:
    return lambda found, rng: kind(found, rng.uniform(0.0, last))


_TEST = 40.0
"""A test of 3.1 s, the move to its start before it, and a machine with ten times its work (s)."""
_ABORT = _TEST + 5.0 + 5.0
"""The same with the longest silence and the longest way back (s)."""
KINDS: dict[str, Kind] = {kind.name: kind for kind in (
    Kind("nothing", _at(Nothing), _TEST, ("complete",)),
    Kind("simulator_killed", _at(SimulatorKilled), _ABORT, ("aborted", "refused")),
    Kind("simulator_restarted", _at(SimulatorRestarted), _ABORT, ("aborted", "refused")),
    Kind("prognostics_killed", _at(PrognosticsKilled), _TEST, ("complete",)),
    Kind("peer_lost", _at(PeerLost), _ABORT, ("aborted", "refused")),
    Kind("aircraft_silent", _at(AircraftSilent, 1.5), _TEST, ("aborted",)),
    Kind("wheels_flap", _at(WheelsFlap), _TEST, ("aborted",)),
    Kind("monitor_killed", _at(MonitorKilled), _TEST, ("no answer",)),
    Kind("monitor_ended", _at(MonitorEnded), _TEST, ("no answer", "interrupted")),
    Kind("slow_consumer", _at(SlowConsumer), _TEST, ("complete",)),
    Kind("clock_back", _clock_back, _TEST, ("complete",)),
    Kind("neighbour", _at(Neighbour), _TEST, ("complete",)),
)}
