"""`ema conformance`: a driver of somebody else, held to docs/driver.md."""

from __future__ import annotations

from typing import Annotated

import typer

from ema_cli.console import plain_table, print_json, print_table, progress, styled
from ema_cli.options import Domain
from ema_record.errors import bounded

STYLES = {"ok": "green", "absent": "yellow", "untested": "yellow", "WRONG": "bold red"}


def conformance(
    namespace: Annotated[str, typer.Option(
        "--namespace", "-n", metavar="NAME", help="Of the actuator, such as left_aileron; empty: "
        "none.")] = "",
    wait: Annotated[float, typer.Option(
        "--wait", help="Longest wait for the driver (s).")] = 10.0,
    domain: Domain = None,
    as_json: Annotated[bool, typer.Option(
        "--json", help="Print one JSON object a line of the report.")] = False,
) -> int:
    """Run a driver through its contract, line by line.

    Listens, commands the surface to stay where it is, and plays the aircraft for the interlock;
    no motion is commanded. docs/driver.md is the contract. With --kit the rate of the samples is
    that of the kit. Exit status: 0 nothing wrong, 1 something is, 3 no driver was found.

    Example: `ema conformance --namespace left_aileron`
    """
    from ema_monitor.conformance import report
    from ema_record.actuator import load_actuator
    from ema_record.wire.topics import checked_namespace
    from ema_ros.domain import use_fast_discovery

    bounded("--wait", wait, 0.1, 3600.0, "s")
    chosen = checked_namespace(namespace)
    use_fast_discovery(domain)
    from ema_monitor.conformance_node import examine

    with progress("listening to the driver"):
        heard = examine(chosen, wait)
    lines = report(heard, load_actuator())
    if as_json:
        for line in lines:
            print_json(line._asdict())
    else:
        table = plain_table(show_header=False)
        for line in lines:
            table.add_row(styled((line.outcome, STYLES[line.outcome])), styled(line.item),
                          styled(line.text))
        print_table(table)
    return 1 if any(line.outcome == "WRONG" for line in lines) else 0
