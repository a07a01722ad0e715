"""A verdict for a person: a few lines on the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

STYLES = {
    "healthy": "bold green", "fault": "bold red", "unknown": "bold yellow",
    "incomplete": "bold yellow", "invalid": "bold magenta",
}
NAMES = {
    "turn_short": "turn short", "rotor_eccentricity": "rotor eccentricity",
    "friction": "friction", "backlash": "backlash",
}
ALTERNATIVES = {"healthy": "does not rule out", "unknown": "most like"}
SCALES = {
    "turn_short": (100.0, "% of the turns"), "rotor_eccentricity": (100.0, "% of the air gap"),
    "friction": (100.0, "% increase"), "backlash": (1e3, "mrad"),
}


def print_verdict(verdict: dict[str, Any], console: Console) -> None:
    """Print a verdict.

    Parameters
    ----------
    verdict : the JSON object of ``ema check --json``.
    console : where to.
    """
    from rich.text import Text

    outcome = str(verdict["verdict"])
    line = Text()
    line.append(outcome.upper(), style=STYLES.get(outcome, "bold"))
    if verdict.get("bag"):
        line.append(f"  {verdict['bag']}", style="dim")
    console.print(line)
    for fault in verdict["faults"] or ([verdict] if verdict["fault_class"] else []):
        console.print(Text("  " + fault_line(fault), style="bold"))
    others = ", ".join(NAMES.get(name, name) for name in verdict["alternatives"])
    if others:
        console.print(Text(f"  {ALTERNATIVES.get(outcome, 'cannot be told from')}: {others}"))
    probabilities = [
        f"{NAMES.get(name, name)} {100 * p:.1f} %" for name, p in verdict["probabilities"].items()
    ]
    if probabilities:
        console.print(Text(
            "  probability of each, more than one may hold: " + ", ".join(probabilities)))
    for reason in verdict["reasons"]:
        console.print(Text(f"  - {reason}"))


def fault_line(fault: dict[str, Any]) -> str:
    """Return one fault in words: class, phase, severity with its interval, level."""
    name = fault["fault_class"]
    words = NAMES.get(name, name)
    if fault["phase"]:
        words += f" in phase {fault['phase']}"
    if fault["severity"] is not None:
        scale, unit = SCALES.get(name, (1.0, fault["severity_unit"] or ""))
        words += f": {scale * fault['severity']:.3g} {unit}"
        if fault["severity_interval"]:
            low, high = fault["severity_interval"]
            words += f" (90 %: {scale * low:.3g} to {scale * high:.3g})"
    return words + (f", {fault['level']}" if fault["level"] else "")
