"""Verdicts for machines: JSON objects or CSV rows on standard output."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ema_cli.console import print_json
from ema_cli.lines import say_lines
from ema_record.errors import UsageError, unknown_name

if TYPE_CHECKING:
    from ema_prognostics.trend.flights import Flight
    from ema_prognostics.verdict.judge import Judge
    from ema_prognostics.verdict.verdict import Judged

FORMATS = ("text", "json", "csv")


def check_format(chosen: str, *, json: bool) -> str:
    """Return the format; `json`: whether ``--json`` was given, which is short for it."""
    if chosen not in FORMATS:
        raise unknown_name("format", chosen, FORMATS, f"give one of {', '.join(FORMATS)}")
    if json and chosen == "csv":
        raise UsageError("--json and --format csv exclude each other: give one")
    return "json" if json else chosen


class Machine:
    """Prints verdicts as a program reads them.

    Parameters
    ----------
    kind : ``json`` or ``csv``.
    judge : who judges.
    """

    def __init__(self, kind: str, judge: Judge) -> None:
        """Look up what judges, once."""
        from ema_prognostics.verdict.contract import trace_of

        self.kind, self._header = kind, True
        self._trace = trace_of(judge.model_sha256)

    def object_of(self, said: Flight | Judged) -> dict[str, Any]:
        """Return the JSON object of the verdict on a bag."""
        from ema_prognostics.verdict.contract import verdict_object
        from ema_prognostics.verdict.verdict import Judged

        return verdict_object(Judged(said.verdict, said.serial_number, said.start_time,
                                     said.profile), self._trace)

    def print(self, found: Mapping[str, Any]) -> None:
        """Print an object."""
        if self.kind == "json":
            print_json(found)
            return
        from ema_prognostics.fleet.tables import csv_text

        say_lines(csv_text(found, header=self._header))
        self._header = False
