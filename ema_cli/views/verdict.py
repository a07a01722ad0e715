"""A verdict for a person: a few lines on the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ema_cli.console import styled
from ema_prognostics.words import NAMES, look_alike, scaled

if TYPE_CHECKING:
    from rich.console import Console

STYLES = {
    "healthy": "bold green", "fault": "bold red", "unknown": "bold yellow",
    "incomplete": "bold yellow", "invalid": "bold magenta",
}
ALTERNATIVES = {"healthy": "does not rule out", "unknown": "most like"}


def print_verdict(verdict: dict[str, Any], console: Console) -> None:
    """Print a verdict.

    Parameters
    ----------
    verdict : the JSON object of ``ema check --json``.
    console : where to.
    """
    outcome = str(verdict["verdict"])
    name = f"  {verdict['actuator']}" if verdict.get("actuator") else ""
    bag = f"  {verdict['bag']}" if verdict.get("bag") else ""
    console.print(styled((outcome.upper(), STYLES.get(outcome, "bold")), name, (bag, "dim")))
    for fault in verdict["faults"]:
        console.print(styled(("  " + fault_line(fault), "bold")))
    named = [fault["fault_class"] for fault in verdict["faults"]]
    others = ", ".join(look_alike(named, name) for name in verdict["alternatives"])
    if others:
        console.print(styled(f"  {ALTERNATIVES.get(outcome, 'cannot be told from')}: {others}"))
    probabilities = [
        f"{NAMES.get(name, name)} {100 * p:.1f} %" for name, p in verdict["probabilities"].items()
    ]
    if probabilities:
        console.print(styled(
            "  probability of each, more than one may hold: " + ", ".join(probabilities)))
    for reason in verdict["reasons"]:
        console.print(styled(f"  - {reason}"))


def fault_line(fault: dict[str, Any]) -> str:
    """Return one fault in words: class, phase, severity with its interval, level."""
    name = fault["fault_class"]
    words = NAMES.get(name, name)
    if fault["phase"]:
        words += f" in phase {fault['phase']}"
    if fault["severity"] is not None:
        scale, unit = scaled(name, fault["severity_unit"])
        words += f": {scale * fault['severity']:.3g} {unit}"
        if fault["severity_interval"]:
            low, high = fault["severity_interval"]
            words += f" (90 %: {scale * low:.3g} to {scale * high:.3g})"
    return words + (f", {fault['level']}" if fault["level"] else "")
