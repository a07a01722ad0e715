"""`ema bit`: the whole built-in test, three nodes as processes, from one command."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ema_cli.console import note, print_json, print_table, progress, stdout, styled
from ema_cli.options import Changes, Effect, Noise, Seed, SerialNumber
from ema_cli.views.verdict import print_verdict
from ema_record.errors import TestRefusedError

if TYPE_CHECKING:
    from ema_monitor.aircraft_node import AircraftNode
    from ema_ros.supervisor import ParameterValue, Supervisor

SIMULATOR = "ema_sim.simulator_node"
MONITOR = "ema_monitor.monitor_node"
PROGNOSTICS = "ema_prognostics.prognostics_node"

START_TIMEOUT = 180.0
"""Longest start of the nodes: the first one compiles the physics (s)."""
TEST_MARGIN = 60.0
"""Longest test beyond the duration of its profile (s)."""
VERDICT_TIMEOUT = 60.0
SPIN = 0.02
LEVELS = (("ok", "green"), ("unusual", "yellow"), ("failed", "red"))
"""Of a record check, as printed."""


class NoVerdictError(TestRefusedError):
    """The test was refused, aborted, or not answered."""

    exit_status = 4


def bit(
    profile: Annotated[str, typer.Option(
        "--profile", "-p", metavar="NAME|FILE.yaml", help="Test profile.")] = "extended",
    effect: Effect = None,
    out: Annotated[Path, typer.Option(
        "--out", "-o", metavar="DIR", help="Folder for the records.")] = Path("records"),
    model: Changes = None,
    seed: Seed = 0,
    noise: Noise = 1.0,
    serial_number: SerialNumber = "SIM-0000",
    real_time_factor: Annotated[float, typer.Option(
        "--real-time-factor", help="Simulated seconds a second; 0: no pacing.")] = 1.0,
    domain: Annotated[int | None, typer.Option(
        "--domain", min=0, max=232, help="ROS domain, default a free one.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> int:
    """Run the whole built-in test over ROS 2 and print the verdict.

    Simulator, monitor and prognostics run as three processes; this one plays the aircraft.
    With --kit all three work with that kit. The effect is known to the simulator alone. Exit
    status: 0 healthy, 1 a fault, 2 wrong use, 3 the verdict is unknown or incomplete, 4 no
    verdict: the test was refused or aborted, or a node ended.

    Example: `ema bit --effect turn_short.fraction=0.1 --effect turn_short.phase=b`
    """
    from ema_record.actuator import load_actuator
    from ema_record.profile import load_profile
    from ema_ros.domain import enter_domain, private_domain
    from ema_ros.parameters import check_values
    from ema_ros.supervisor import Supervisor
    from ema_sim.node.settings import load_model, parameter_specs

    chosen = load_profile(profile)
    chosen.check_within(load_actuator(model).surface.end_stop)
    model_file = str(model.resolve()) if model is not None else ""
    simulator: dict[str, ParameterValue] = {
        "model_file": model_file,
        "seed": seed, "noise": noise, "serial_number": serial_number,
        "real_time_factor": real_time_factor,
        **effect_parameters(effect or []),
    }
    check_values(parameter_specs(load_model(model_file)), simulator)
    log = new_log(out)
    before = set(out.iterdir())
    begin = time.monotonic()
    with contextlib.ExitStack() as stack:
        stack.enter_context(ended_by_signals())
        enter_domain(stack.enter_context(private_domain(domain)))
        supervisor = stack.enter_context(Supervisor(log))
        supervisor.start(SIMULATOR, simulator)
        supervisor.start(PROGNOSTICS, {})
        supervisor.start(MONITOR, {
            "profile": profile, "model_file": model_file, "output_directory": str(out),
            "serial_number": serial_number,
        })
        try:
            result = _run(supervisor, chosen.duration, real_time_factor)
        except KeyboardInterrupt:
            supervisor.stop(MONITOR)
            for path in sorted(set(out.iterdir()) - before - {log}):
                note(f"record kept, marked interrupted: {path}")
            raise
        supervisor.stop()
    result["times"]["total"] = time.monotonic() - begin
    if result["record"]:
        log = log.rename(out / f"{Path(result['record']).name}.log")
    result["log"] = str(log)
    if as_json:
        print_json(result)
    else:
        print_result(result)
    return exit_status(result)


def exit_status(result: dict[str, Any]) -> int:
    """Return 0 healthy, 1 fault, 3 unknown or a record that failed its checks, 2 unreadable.

    Where there is no verdict at all, `NoVerdictError` gives 4.
    """
    from ema_prognostics.verdict.verdict import EXIT_STATUS

    status = EXIT_STATUS[result["verdict"]["verdict"]]
    return TestRefusedError.exit_status if status == 0 and not result["passed"] else status


def effect_parameters(settings: list[str]) -> dict[str, ParameterValue]:
    """Return effects as parameters of the simulator node; UsageError where one is wrong."""
    from ema_sim.effects import parse_effects

    parse_effects(settings)
    found: dict[str, ParameterValue] = {}
    for setting in settings:
        name, _, value = (part.strip() for part in setting.partition("="))
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = value
    return found


def new_log(out: Path) -> Path:
    """Make the folder of the records, and a log file in it."""
    from ema_record.files import cannot_write

    try:
        out.mkdir(parents=True, exist_ok=True)
        stamp = datetime.now(tz=timezone.utc).strftime("%Y%m%dT%H%M%S%fZ")
        log = out / f"bit_{stamp}.log"
        log.touch(exist_ok=False)
    except OSError as error:
        raise cannot_write(out, error) from None
    return log


@contextlib.contextmanager
def ended_by_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the test as Ctrl-C does."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    numbers = (signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(number, interrupt) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before):
            signal.signal(number, handler)


def _run(supervisor: Supervisor, duration: float, factor: float) -> dict[str, Any]:
    """Play the aircraft: wait for the nodes, ask for the test, wait for the verdict."""
    from ema_monitor.aircraft_node import aircraft, answer_of

    begin = time.monotonic()
    test_time = duration / factor if factor > 0.0 else duration
    with aircraft() as node:

        def wait(until: Callable[[], bool], limit: float, what: Callable[[], str],
                 show: Callable[[float], None]) -> None:
            start = time.monotonic()
            while not until():
                node.spin(SPIN)
                node.poll()
                revived = supervisor.revive(PROGNOSTICS)
                if revived:
                    note(f"{revived}; it will find the record")
                supervisor.check()
                passed = time.monotonic() - start
                show(passed)
                if passed > limit:
                    raise NoVerdictError(f"no answer from {what()} after {limit:g} s")

        with progress("starting simulator, monitor and prognostics") as show:
            wait(lambda: not node.missing(), START_TIMEOUT, node.missing, show)
        ready = time.monotonic()
        answer = node.call_self_test()
        with progress(f"built-in test, {duration:g} s", test_time + 1.0) as show:
            wait(answer.done, test_time + TEST_MARGIN, lambda: "the monitor", show)
        result = summarise(answer_of(answer.result()))
        tested = time.monotonic()
        if result["record"] and result["status"] == "complete":
            with progress("diagnosing") as show:
                wait(lambda: _has_verdict(node, result["record"]), VERDICT_TIMEOUT,
                     lambda: "the prognostics", show)
            result["verdict"] = node.verdict
    end = time.time_ns()
    result["times"] = {
        "start": ready - begin, "test": tested - ready,
        "after_record_closed": (end - result.pop("closed")) / 1e9 if result["verdict"] else None,
    }
    if result["status"] != "complete":
        kept = f"; record kept: {result['record']}" if result["record"] else ""
        raise NoVerdictError(f"built-in test {result['message']}{kept}")
    return result


def _has_verdict(node: AircraftNode, record: str) -> bool:
    return node.verdict is not None and node.verdict["bag"] == record


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


def print_result(result: dict[str, Any]) -> None:
    """Print the result of a built-in test."""
    from rich.table import Table

    console = stdout()
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column()
    for check in result["checks"]:
        table.add_row(styled(check["name"]), styled(LEVELS[min(check["level"], 2)]),
                      styled(check["message"]))
    console.print(styled(("Record", "bold"), f" {result['record']}"), soft_wrap=True)
    print_table(table)
    console.print()
    print_verdict(result["verdict"], console)
    times = result["times"]
    console.print()
    console.print(
        f"nodes up in {times['start']:.1f} s, test {times['test']:.1f} s, verdict "
        f"{times['after_record_closed']:.2f} s after the record was closed, "
        f"{times['total']:.1f} s in all", style="dim",
    )
