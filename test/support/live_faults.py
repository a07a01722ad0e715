"""Faults of the live system: what is done to the chain while a test runs, and what may follow.

The actuator has a turn short throughout (`HIDDEN`), so "healthy" is always wrong. After each
fault: the request is answered within a stated time, `/diagnostics` says why, the record is whole
or marked or known to be cut, its samples are those of one run, and the verdict that follows is
right.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

from ema_cli.commands.bit import MONITOR, PROGNOSTICS, SIMULATOR
from ema_record.bag.read import read_bag
from ema_record.checks.guard import guard_findings
from ema_record.errors import IncompleteRecordError, RecordError
from support.chain import ACTUATOR_STATUS, MONITOR_STATUS, Chain, TimedOutError, slow_reader

NEIGHBOUR = "EMA-NEIGHBOUR"
HIDDEN = {"turn_short.fraction": 0.1, "turn_short.phase": "b"}
SAMPLES_OF_A_TEST = 62_600
VERDICT_LIMIT = 30.0


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


def records(folder: Path) -> set[Path]:
    """Return the bags in a folder."""
    return {path for path in folder.iterdir() if path.is_dir()}


def judge_record(path: Path) -> str:
    """Return how a bag ended: complete, aborted, interrupted or cut; or what is wrong in it."""
    try:
        record = read_bag(path)
    except IncompleteRecordError:
        return "cut"
    except RecordError as error:
        return f"WRONG {error}"
    status = record.provenance.status
    wrong = [f.rule for f in guard_findings(record)
             if f.rule not in ("test_not_complete", "record_length")]
    if wrong or (status == "complete" and len(record) != SAMPLES_OF_A_TEST):
        return f"WRONG {status}, {len(record)} samples, {wrong}"
    return status


def verdict_on(found: Chain, record: str) -> dict[str, Any]:
    """Return the verdict on a record, starting the prognostics where it was killed."""
    if not found.runs(PROGNOSTICS):
        found.start(PROGNOSTICS)
    found.wait(
        lambda: found.node.verdict is not None and found.node.verdict["bag"] == record,
        VERDICT_LIMIT, "the verdict",
    )
    assert found.node.verdict is not None
    return found.node.verdict


def one(found: Chain, kind: Kind, rng: Random) -> dict[str, Any]:
    """Run one test with one fault; return what came of it, "wrong" empty where all is well."""
    found.ready()
    found.stay(1.4)
    before = records(found.out)
    fault = kind.make(found, rng)
    begin = time.monotonic()
    wrong: list[str] = []
    answer = verdict = None
    try:
        answer = found.run_test(fault.act, kind.limit, fault.lost)
        took = time.monotonic() - begin
        fault.end()
        found.ready()
        if answer is not None and answer["status"] == "complete":
            verdict = verdict_on(found, answer["record"])
        found.wait(lambda: found.status.get(ACTUATOR_STATUS, ("", {}))[1].get("state") == "idle"
                   and found.stage() == "idle", 15.0, "the actuator at rest")
    except TimedOutError as error:
        took = time.monotonic() - begin
        wrong.append(f"hang: {error}")
        fault.end()
    ended = answer["status"] if answer is not None else "no answer"
    expected = kind.ends if fault.done else (*kind.ends, "complete")
    if not wrong and ended not in expected:
        said = answer["message"] if answer is not None else "nothing"
        wrong.append(f"ended {ended} ({said}), expected one of {', '.join(expected)}")
    if verdict is not None and (verdict["verdict"], verdict["fault_class"]) != (
        "fault", "turn_short"
    ):
        wrong.append(f"verdict {verdict['verdict']} {verdict['reasons'][:1]}")
    new = [judge_record(path) for path in sorted(records(found.out) - before)]
    wrong += [text for text in new if text.startswith("WRONG")]
    wrong += fault.wrong()
    said = found.status.get(MONITOR_STATUS, ("", {}))[0]
    if ended in ("aborted", "refused") and "abort" not in said and "refused" not in said:
        wrong.append(f"/diagnostics says only {said!r}")
    return {"kind": kind.name, "ended": ended, "took": round(took, 2), "records": new,
            "message": answer["message"] if answer else "",
            "verdict": verdict["verdict"] if verdict else None, "wrong": wrong}
