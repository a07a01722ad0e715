"""What `ema bit` shows: the record checks and the verdict."""

from __future__ import annotations

from typing import Any

from ema_cli.console import print_table, stdout, styled
from ema_cli.views.verdict import print_verdict

LEVELS = (("ok", "green"), ("unusual", "yellow"), ("failed", "red"))


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
