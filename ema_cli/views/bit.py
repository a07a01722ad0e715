"""What `ema bit` shows: the record checks and the verdict."""

from __future__ import annotations

from typing import Any

from ema_cli.console import stdout
from ema_cli.views.verdict import print_verdict

LEVELS = ("[green]ok[/green]", "[yellow]unusual[/yellow]", "[red]failed[/red]")


def print_result(result: dict[str, Any]) -> None:
    """Print the result of a built-in test."""
    from rich.table import Table

    console = stdout()
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column()
    for check in result["checks"]:
        table.add_row(check["name"], LEVELS[min(check["level"], 2)], check["message"])
    console.print(f"[bold]Record[/bold] {result['record']}", soft_wrap=True)
    console.print(table)
    console.print()
    print_verdict(result["verdict"], console)
    times = result["times"]
    console.print(
        f"\n[dim]nodes up in {times['start']:.1f} s, test {times['test']:.1f} s, verdict "
        f"{times['after_record_closed']:.2f} s after the record was closed, "
        f"{times['total']:.1f} s in all[/dim]"
    )
