"""`ema bit`: the whole built-in test, three nodes as processes, from one command."""

from __future__ import annotations

import contextlib
import importlib
import time
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ema_cli.console import note, print_json, progress, speech, stdout, styled
from ema_cli.ending import held_signals
from ema_cli.lines import TextLine, print_lines
from ema_cli.options import Changes, Effect, Noise, Seed, SerialNumber, given_once
from ema_cli.views.verdict import print_verdict
from ema_prognostics.words import words
from ema_record.errors import EmaError, TestRefusedError, UsageError, unknown_name
from ema_ros.process import LAST_DOMAIN

if TYPE_CHECKING:
    from ema_ros.supervisor import ParameterValue

SIMULATOR = "ema_sim.simulator_node"
MONITOR = "ema_monitor.monitor_node"
PROGNOSTICS = "ema_prognostics.prognostics_node"

NO_VERDICT = 4
SIMULATED = "SIM-0000"
"""Serial number of a simulated actuator without another."""
UNCHANGED = {"model_file": "", "seed": 0, "noise": 1.0, "real_time_factor": 1.0}
"""What a simulator is told unless something else is asked for."""
LEAST_TIMEOUT, MOST_TIMEOUT = 120.0, 3600.0
"""Of a test (s): moving to its start, and a test in real time; the monitor's bound."""
REPORTS = (".html", ".xml")
"""Endings of the reports that are written beside a record."""


def bit(
    profile: Annotated[str, typer.Option(
        "--profile", "-p", metavar="NAME|FILE.yaml", help="Test profile.")] = "extended",
    effect: Effect = None,
    out: Annotated[Path, typer.Option(
        "--out", "-o", metavar="DIR", help="Folder for the records.")] = Path("records"),
    model: Changes = None,
    seed: Seed = 0,
    noise: Noise = 1.0,
    serial_number: SerialNumber = SIMULATED,
    real_time_factor: Annotated[float, typer.Option(
        "--real-time-factor", help="Simulated seconds a second; 0: no pacing.")] = 1.0,
    actuators: Annotated[str | None, typer.Option(
        "--actuators", metavar="NAME,NAME...", help="Test these, each in the namespace of its "
        "name, one after another.")] = None,
    side_by_side: Annotated[int, typer.Option(
        "--side-by-side", min=1, max=32, help="How many of them are tested at a time.")] = 1,
    no_simulator: Annotated[bool, typer.Option(
        "--no-simulator", help="Test what drivers on the domain publish; the aircraft is played "
        "only where no other node is it.")] = False,
    domain: Annotated[int | None, typer.Option(
        "--domain", min=0, max=LAST_DOMAIN, help="ROS domain, default a free one; with "
        "--no-simulator ROS_DOMAIN_ID.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON, with "
                                          "--actuators a line each.")] = False,
) -> int:
    """Run the whole built-in test over ROS 2 and print the verdict.

    Simulator, monitor and prognostics run as three processes for each actuator; this one plays
    the aircraft. With --kit all work with that kit. The effect is known to the simulator alone;
    among several, NAME:EFFECT.PARAMETER=VALUE hides it in one. A report of one page (.html, .xml)
    is written beside the record ('ema report' adds what the work order needs). Exit status: 0
    healthy, 1 a fault, 2 wrong use, 3 the verdict is unknown or incomplete, 4 no verdict: the
    test was refused or aborted, or a node ended.

    Example: `ema bit --effect turn_short.fraction=0.1 --effect turn_short.phase=b`
    """
    with contextlib.ExitStack() as stack:
        check_signals = stack.enter_context(held_signals())
        from ema_monitor.chain import Chain, NoVerdictError
        from ema_record.actuator import load_actuator
        from ema_record.profile import load_profile
        from ema_record.wire.topics import checked_namespace
        from ema_ros.domain import enter_domain, private_domain, use_fast_discovery
        from ema_ros.supervisor import Supervisor

        chosen = load_profile(profile)
        chosen.check_within(load_actuator(model).surface.end_stop)
        model_file = str(model.resolve()) if model is not None else ""
        names = [name.strip() for name in actuators.split(",")] if actuators is not None else [""]
        namespaces = [checked_namespace(name) for name in names]
        if len(set(namespaces)) < len(namespaces) or (actuators is not None and "" in namespaces):
            raise UsageError(f"--actuators {actuators}: give each name once, separated by commas")
        simulators = _simulators(namespaces, effect or [], {
            "model_file": model_file, "seed": seed, "noise": noise, "serial_number": serial_number,
            "real_time_factor": real_time_factor,
        }, wanted=not no_simulator)
        serial = "" if len(namespaces) > 1 or (no_simulator and serial_number == SIMULATED) else (
            serial_number)
        timeout = LEAST_TIMEOUT + (chosen.duration / real_time_factor if real_time_factor else 0.0)
        if timeout > MOST_TIMEOUT:
            raise UsageError(f"--real-time-factor {real_time_factor:g}: the test would take "
                             f"{timeout:.3g} s, at most {MOST_TIMEOUT:g}: give a larger one")
        check_signals()
        log = new_log(out)
        before = set(out.iterdir())
        begin = time.monotonic()
        if no_simulator:
            use_fast_discovery(domain)
        else:  # a free domain, on this host alone
            enter_domain(stack.enter_context(private_domain(domain)))
        supervisor = stack.enter_context(Supervisor(log))
        for namespace in namespaces:
            if not no_simulator:
                supervisor.start(SIMULATOR, simulators[namespace], namespace)
            supervisor.start(PROGNOSTICS, {}, namespace)
            supervisor.start(MONITOR, {
                "profile": profile, "model_file": model_file, "output_directory": str(out),
                "serial_number": serial, "test_timeout": timeout,
            }, namespace)
        chain = Chain(supervisor, note, with_drivers=no_simulator, check=check_signals)
        try:
            results = chain.run(namespaces, side_by_side, chosen.duration, real_time_factor,
                                progress, _load_report)
        except KeyboardInterrupt:
            supervisor.stop(MONITOR)
            for path in sorted(set(out.iterdir()) - before - {log}):
                note(f"record kept, marked interrupted: {path}")
            raise
        supervisor.ask_to_end()
        supervisor.wait_for(MONITOR)  # the verdict is in the record; the others may still end
        for result in results:
            check_signals()
            result["reports"] = []
            try:
                if result["verdict"] is not None:
                    file_report(result)
            except EmaError as error:
                note(f"no report: {error}")
    if actuators is None:
        (result,) = results
        if result["status"] != "complete":
            kept = f"; record kept: {result['record']}" if result["record"] else ""
            raise NoVerdictError(f"built-in test {result['message']}{kept}")
        if result["record"]:
            log = log.rename(out / f"{Path(result['record']).name}.log")
    else:
        results = [{"actuator": name.removeprefix("/"), **result}
                   for name, result in zip(namespaces, results)]
    for result in results:
        result["times"]["total"] = time.monotonic() - begin
        result["log"] = str(log)
        if as_json:
            print_json(result)
        else:
            print_result(result)
    from ema_prognostics.verdict.verdict import worst_status

    return worst_status([exit_status(result) for result in results])


def _simulators(
    namespaces: list[str], effects: list[str], common: dict[str, ParameterValue], *, wanted: bool
) -> dict[str, dict[str, ParameterValue]]:
    """Return the parameters of each simulated actuator, checked; none where none is wanted.

    Several have each a seed and a serial number of their own. What is left as it is needs no
    check, which would take as long as the start of a node.
    """
    if not wanted:
        if effects:
            raise UsageError("--effect hides a fault in a simulator: leave out --no-simulator")
        return {}
    hidden: dict[str, list[str]] = {namespace: [] for namespace in namespaces}
    for setting in effects:
        name, colon, rest = setting.partition(":")
        if colon and f"/{name}" not in hidden:
            raise unknown_name("actuator", name, [n.removeprefix("/") for n in namespaces],
                               "give one of --actuators before the colon")
        for namespace in [f"/{name}"] if colon else namespaces:
            hidden[namespace].append(rest if colon else setting)
    if effects or any(common[name] != value for name, value in UNCHANGED.items()):
        from ema_ros.parameters import check_values
        from ema_sim.model_file import load_model_file
        from ema_sim.node.settings import parameter_specs

        specs = parameter_specs(load_model_file(str(common["model_file"]) or None))
        for namespace in namespaces:
            check_values(specs, {**common, **effect_parameters(hidden[namespace])})
    found = {}
    for number, namespace in enumerate(namespaces):
        found[namespace] = dict(common)
        if hidden[namespace]:
            found[namespace] |= effect_parameters(hidden[namespace])
        if len(namespaces) > 1:
            found[namespace]["seed"] = int(common["seed"]) + number
            found[namespace]["serial_number"] = f"{common['serial_number']}-{number + 1}"
    return found


def exit_status(result: dict[str, Any]) -> int:
    """Return 0 healthy, 1 fault, 3 unknown or a record that failed its checks, 2 unreadable.

    Where there is no verdict at all it is 4.
    """
    from ema_prognostics.verdict.verdict import EXIT_STATUS

    if result["verdict"] is None:
        return NO_VERDICT
    status = EXIT_STATUS[result["verdict"]["verdict"]]
    return TestRefusedError.exit_status if status == 0 and not result["passed"] else status


def effect_parameters(settings: list[str]) -> dict[str, ParameterValue]:
    """Return effects as parameters of the simulator node; UsageError where one is wrong."""
    from ema_sim.effects import parse_effects

    given_once("--effect", settings)
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


def _load_report() -> None:
    """Import what the report of a test needs."""
    for name in ("ema_cli.pages.report_data", "ema_cli.pages.report_files",
                 "ema_prognostics.verdict.examination"):
        importlib.import_module(name)


def file_report(result: dict[str, Any]) -> None:
    """Write the report of the test beside its record; tell in `result` where, or why not."""
    from ema_cli.pages.report_data import report_data
    from ema_cli.pages.report_files import write_report_file
    from ema_prognostics.cascade.model_file import stated_sha256
    from ema_prognostics.verdict.examination import heading_of
    from ema_record.bag.read import read_bag
    from ema_record.checks.live import CheckResult, Level, check_record
    from ema_record.kit import CASCADE, kit_path

    bag = Path(result["record"])
    record = read_bag(bag)
    known = {check.name: check for check in check_record(record)}
    checks = [
        CheckResult(name=c["name"], level=Level(min(c["level"], 2)), message=c["message"],
                    values=c.get("values") or {},
                    limits=known[c["name"]].limits if c["name"] in known else {})
        for c in result["checks"]
    ]
    result["heading"] = heading_of(record, checks, stated_sha256(kit_path(CASCADE)))
    data = report_data(result["verdict"], record, checks, heading=result["heading"], fields={})
    for form in REPORTS:
        path = bag.with_name(f"{bag.name}{form}")
        write_report_file(path, data, record)
        result["reports"].append(str(path))


def print_result(result: dict[str, Any]) -> None:
    """Print the result of a built-in test."""
    said, console = speech(), stdout()
    if "actuator" in result:
        console.print(styled(("Actuator", "bold"), f" {result['actuator']}"), soft_wrap=True)
    if result["verdict"] is None:
        console.print(styled((f"no verdict: built-in test {result['message']}", "bold")))
        return
    print_verdict(result["verdict"], result.get("heading") or {}, console, **said._asdict())
    if said.quiet:
        return
    if result.get("reports"):
        label = words()("label.report")
        print_lines([TextLine(label if k == 0 else "", path)
                     for k, path in enumerate(result["reports"])], console)
    times = result["times"]
    console.print(
        f"nodes up in {times['start']:.1f} s, test {times['test']:.1f} s, verdict "
        f"{times['after_record_closed']:.2f} s after the record was closed, "
        f"{times['total']:.1f} s in all", style="dim", soft_wrap=True,
    )
