"""A fleet for a person at the terminal: a row a unit, worst first."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ema_cli.console import plain_table, print_table, say, stdout, styled
from ema_record.errors import counted
from ema_record.record import iso_time

if TYPE_CHECKING:
    from ema_prognostics.fleet.fleet import Fleet

STYLES = {"fault": "bold red", "suspected": "bold yellow", "no answer": "yellow",
          "healthy": "green"}
NARROW = 90
"""Characters of a line below which date and forecast are left out."""


def print_fleet(fleet: Fleet) -> None:
    """Print the units and how many there are in each state."""
    wide = stdout().width >= NARROW
    table = plain_table(pad_edge=False, header_style="dim")
    table.add_column("unit", overflow="fold")
    table.add_column("state", no_wrap=True)
    table.add_column("finding")
    if wide:
        table.add_column("ahead")
        table.add_column("last test (UTC)", no_wrap=True)
    table.add_column("tests", justify="right", no_wrap=True)
    for unit in fleet.units:
        more = (unit.ahead(), (iso_time(unit.last.start_time) or "")[:16].replace("T", " "))
        table.add_row(
            styled(unit.serial_number or "not known"), styled((unit.state, STYLES[unit.state])),
            styled(unit.finding()), *(more if wide else ()), str(len(unit.objects)))
    print_table(table)
    say(summary(fleet))


def summary(fleet: Fleet) -> str:
    """Return how many units are in which state, in words."""
    states = [unit.state for unit in fleet.units]
    flights = sum(len(unit.objects) for unit in fleet.units)
    counts = ", ".join(f"{states.count(s)} {s}" for s in STYLES if s in states)
    return f"{counted(len(states), 'unit')}, {counted(flights, 'flight')}: {counts}"
