"""`Chain`: the whole built-in test of one actuator or several, from outside the nodes.

Waits until the nodes say that they are active, asks for each test and waits for its verdict. It
plays the aircraft, all in one thread.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

from ema_record.errors import TestRefusedError
from ema_ros.supervisor import Supervisor

if TYPE_CHECKING:
    from ema_monitor.aircraft_node import AircraftNode

PROGNOSTICS = "ema_prognostics.prognostics_node"
START_TIMEOUT = 180.0
"""Longest start of the nodes: the first one compiles the physics (s)."""
PATIENCE = 5.0
"""After which it is said what the start waits for (s)."""
MOST_NAMED = 2
"""Actuators that are named of those that it waits for."""
TEST_MARGIN = 60.0
"""Longest test beyond the duration of its profile (s)."""
VERDICT_TIMEOUT = 60.0
SPIN = 0.02
Progress = Callable[..., AbstractContextManager[Callable[[float], None]]]


class NoVerdictError(TestRefusedError):
    """The test was refused, aborted, or not answered."""

    exit_status = 4


class ActuatorTest:
    """The test of one actuator: asked for, answered, judged.

    Parameters
    ----------
    node : asks for it, and hears the verdict.
    limit : longest time until the answer (s).
    """

    def __init__(self, node: AircraftNode, limit: float) -> None:
        self._node, self._limit = node, limit
        self._begin = self._tested = time.monotonic()
        self._answer = node.call_self_test()
        self.result: dict[str, Any] | None = None
        """What came of it."""

    def over(self) -> bool:
        """Whether it is over (NoVerdictError: it takes too long)."""
        now = time.monotonic()
        if self.result is None:
            if not self._answer.done():
                _bound(now - self._begin, self._limit, "the monitor")
                return False
            from ema_monitor.aircraft_node import answer_of

            self.result, self._tested = summarise(answer_of(self._answer.result())), now
            self.result["times"] = {"test": now - self._begin, "after_record_closed": None}
        if self.result["status"] != "complete":
            return True
        verdict = self._node.verdict
        if verdict is None or verdict["bag"] != self.result["record"]:
            _bound(now - self._tested, VERDICT_TIMEOUT, "the prognostics")
            return False
        self.result["verdict"] = verdict
        closed = self.result.pop("closed")
        self.result["times"]["after_record_closed"] = (time.time_ns() - closed) / 1e9
        return True


def _bound(passed: float, limit: float, what: str) -> None:
    if passed > limit:
        raise NoVerdictError(f"no answer from {what} after {limit:g} s")


class Chain:
    """Runs tests of actuators whose nodes were started.

    Parameters
    ----------
    supervisor : has started the nodes.
    note : takes a line for the user.
    with_drivers : the actuators are those of drivers, not of our simulator.
    check : is called all the time, between calls of the middleware; may raise what ends the test.
    """

    def __init__(
        self, supervisor: Supervisor, note: Callable[[str], None], *, with_drivers: bool = False,
        check: Callable[[], object] = lambda: None,
    ) -> None:
        self._supervisor, self._note, self._check = supervisor, note, check
        self._with_drivers = with_drivers
        self._nodes: dict[str, AircraftNode] = {}

    def run(
        self, namespaces: Sequence[str], side_by_side: int, duration: float, factor: float,
        progress: Progress, meanwhile: Callable[[], object] | None = None,
    ) -> list[dict[str, Any]]:
        """Test each actuator and return what came of it, in their order.

        Parameters
        ----------
        namespaces : of the actuators.
        side_by_side : how many are tested at a time.
        duration : of the test (s).
        factor : simulated seconds a second; 0: as fast as possible.
        progress : shows what is done, as `ema_cli.console.progress`.
        meanwhile : what may be done while the tests run, in a thread of its own.
        """
        from ema_monitor.aircraft_node import aircrafts

        begin = time.monotonic()
        test_time = duration / factor if factor > 0.0 else duration
        with aircrafts(namespaces) as nodes:
            self._nodes = dict(zip(namespaces, nodes))
            for node in nodes:
                node.gives_way = self._with_drivers
            waits = "drivers" if self._with_drivers else "simulator"
            with progress(f"starting {waits}, monitor and prognostics") as show:
                self._wait_for_nodes(show)
            start = time.monotonic() - begin
            rounds = -(-len(namespaces) // side_by_side)
            what = f"{len(namespaces)} built-in tests" if len(namespaces) > 1 else "built-in test"
            if meanwhile is not None:
                threading.Thread(target=meanwhile, daemon=True).start()
            with progress(f"{what}, {duration:g} s", rounds * (test_time + 1.0)) as show:
                tests = self._run_all(namespaces, side_by_side, test_time + TEST_MARGIN, show)
        for result in tests:
            result["times"] = {"start": start, **result["times"]}
            result.pop("closed", None)
        return tests

    def _spin(self) -> None:
        """Do what is due of all nodes, and look whether the processes are alive."""
        self._check()
        next(iter(self._nodes.values())).spin(SPIN)
        for namespace, node in self._nodes.items():
            node.poll()
            revived = self._supervisor.revive(PROGNOSTICS, namespace)
            if revived:
                self._note(f"{revived}; it will find the record")
        self._supervisor.check()

    def _wait_for_nodes(self, show: Callable[[float], None]) -> None:
        """Wait until all nodes are active and connected; say what for where it takes long."""
        begin, told = time.monotonic(), ""
        late = dict(self._nodes)
        while late:
            self._spin()
            waiting = {}
            for namespace, node in late.items():
                missing = node.waiting_for(self._with_drivers)
                if missing:
                    waiting[namespace] = f"{namespace.removeprefix('/')} {missing}".strip()
            late = {namespace: self._nodes[namespace] for namespace in waiting}
            others = f" and {len(waiting) - MOST_NAMED} more" if len(waiting) > MOST_NAMED else ""
            what = "; ".join(list(waiting.values())[:MOST_NAMED]) + others
            passed = time.monotonic() - begin
            show(passed)
            if waiting and passed > PATIENCE and what != told:
                self._note(f"waiting for {what}")
                told = what
            _bound(passed, START_TIMEOUT, f"{what}, see {self._supervisor.log},")

    def _run_all(
        self, namespaces: Sequence[str], side_by_side: int, limit: float,
        show: Callable[[float], None],
    ) -> list[dict[str, Any]]:
        """Run the tests, so many at a time."""
        begin = time.monotonic()
        waiting = list(namespaces)
        running: dict[str, ActuatorTest] = {}
        done: dict[str, dict[str, Any]] = {}
        while waiting or running:
            while waiting and len(running) < side_by_side:
                namespace = waiting.pop(0)
                running[namespace] = ActuatorTest(self._nodes[namespace], limit)
            self._spin()
            show(time.monotonic() - begin)
            for namespace, test in list(running.items()):
                if test.over():
                    assert test.result is not None
                    done[namespace] = test.result
                    del running[namespace]
        return [done[namespace] for namespace in namespaces]


def summarise(answer: dict[str, Any]) -> dict[str, Any]:
    """Return the answer of the self-test with the record's path and status at the top."""
    checks = {check["name"]: check for check in answer["checks"]}
    record = checks.pop("record", {"values": {}})["values"]
    test = checks.pop("test", {"message": "no answer"})
    return {
        "record": record.get("path", ""), "status": record.get("status", "refused"),
        "closed": int(record.get("closed", 0)), "passed": answer["passed"],
        "message": test["message"], "serial_number": answer["serial_number"],
        "checks": list(checks.values()), "verdict": None,
    }
