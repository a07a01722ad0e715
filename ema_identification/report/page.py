"""What the page says, ready to be printed: sentences, tables, plots, what to run next."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ema_identification.report import words
from ema_identification.result import (
    INTERVAL_LEVEL,
    Candidate,
    Identification,
    NamedEffect,
    Panel,
    Parameter,
)
from ema_record.kit import kit_option
from ema_record.version import VERSION

MODEL_FILE = "model.yaml"
NEXT_TEST_FILE = "next_test.yaml"
"""In the folder of an identification."""
MAX_CANDIDATES = 12
"""Rows of the table of candidates; the rest is in the JSON file's steps."""


def page_context(
    identification: Identification,
    panels: Sequence[Panel],
    *,
    title: str,
    inputs: Mapping[str, Sequence[str]],
) -> dict[str, Any]:
    """Return the variables of the template."""
    unknown = identification.unknown
    shape = unknown.panel.name if unknown is not None else ""
    by_step: dict[str, list[Panel]] = {}
    for panel in panels:
        if panel.name != shape:
            by_step.setdefault(panel.step, []).append(panel)
    steps = [
        {"name": step.name, "text": step.text, "head": step.rows[0] if step.rows else (),
         "rows": step.rows[1:],
         "panels": [] if step.name in ("where", "show") else by_step.get(step.name, [])}
        for step in identification.steps
    ]
    return {
        "title": title,
        "inputs": inputs,
        "version": VERSION,
        "verdict": identification.verdict,
        "tone": "open" if identification.exit_status else "good",
        "sentence": words.verdict_sentence(identification),
        "advice": advice(identification),
        "figures": _figures(identification),
        "gap_unit": identification.gap_unit,
        "data": words.data_of(identification),
        "findings": [_finding(finding) for finding in identification.findings],
        "since": _since(identification.since),
        "rivals": _candidates(_not_shown(identification)),
        "next_test": identification.next_test,
        "unknown": unknown,
        "shape": shape,
        "recalibrated": [_parameter(p) for p in identification.recalibrated],
        "level": f"{INTERVAL_LEVEL:.0%}".replace("%", " %"),
        "reasons": identification.reasons,
        "show_panels": by_step.get("show", []),
        "where_panels": by_step.get("where", []),
        "steps": steps,
        "titles": {panel.name: panel.title for panel in panels},
    }


def advice(identification: Identification) -> list[str]:
    """Return what to do with the answer, in sentences."""
    found = []
    contradicted = identification.verdict == "contradicted"
    ambiguous = any(finding.equivalent for finding in identification.findings)
    if identification.verdict == "no disagreement":
        found.append("Keep the model. No effect needs to be added.")
    if contradicted:
        found.append("Do not use what was found. Check that all records are of one unit in one "
                     "state, then record again and identify again.")
    elif identification.findings:
        found.append("Use the updated model: it carries "
                     f"{words.listed(identification)} with the parameters below.")
    if identification.findings and identification.held_out and not (
            contradicted or words.gap_shows(identification)):
        found.append("The held-out data hardly show what was found: their gap was near the noise "
                     "floor before. Judge by the fitted record below, or record another command.")
    if identification.findings and not identification.held_out:
        found.append("No held-out record judged this: give one of another command with "
                     "--validate.")
    if ambiguous:
        found.append("More than one name fits equally well"
                     + (". The model file holds the first of them"
                        if identification.model_text else "")
                     + "; do not order a repair on the name alone.")
    if identification.verdict in ("partly explained", "unknown effect"):
        found.append("Do not rely on the model where the gap is left (see below) until the "
                     "cause is known.")
    if identification.unknown is not None and "controller" in identification.unknown.port:
        found.append("Compare gains, limits and delay of the controller with those of the model, "
                     "and what the record holds with what the controller reads.")
    if identification.next_test:
        found.append(f"Run next: {identification.next_test}")
    return found


def _figures(identification: Identification) -> list[tuple[str, str, str]]:
    """Return name, value and remark of the numbers at the top."""
    floor = identification.noise_floor

    def floors(value: float) -> str:
        return f"{words.number(value / floor, 2)} noise floors" if floor > 0.0 else ""

    figures = [
        ("gap before", words.number(identification.gap_before), floors(identification.gap_before)),
        ("gap after", words.number(identification.gap_after), floors(identification.gap_after)),
        ("noise floor", words.number(floor), "what a complete model leaves"),
    ]
    closed = words.closed_share(identification)
    if closed is not None and identification.findings:
        figures.append(("gap closed", f"{100.0 * closed:.0f} %", "100 % is down to the floor"))
    return figures


def _parameter(parameter: Parameter) -> dict[str, str]:
    return {"name": parameter.name, "value": words.quantity(parameter),
            "interval": words.interval(parameter)}


def _candidates(candidates: Sequence[Candidate]) -> list[dict[str, str]]:
    return [
        {"effect": words.pretty(c.effect), "score": words.number(c.score),
         "p_value": words.probability(c.p_value), "reason": c.reason}
        for c in candidates[:MAX_CANDIDATES]
    ]


def _not_shown(identification: Identification) -> list[Candidate]:
    """Return the rivals that are in no finding's own table."""
    shown = [c for finding in identification.findings
             for c in finding.candidates[:MAX_CANDIDATES]]
    return [rival for rival in identification.rivals if rival not in shown]


def _finding(finding: NamedEffect) -> dict[str, Any]:
    return {
        "effect": finding.effect, "name": words.pretty(finding.effect),
        "equivalent": [words.pretty(name) for name in finding.equivalent],
        "formula": finding.formula,
        "where": _where(finding), "p_value": words.probability(finding.p_value),
        "before": words.number(finding.gap_before), "after": words.number(finding.gap_after),
        "parameters": [{"name": name, "value": value, "interval": "–"}
                       for name, value in finding.choices.items()]
        + [_parameter(p) for p in finding.parameters],
        "candidates": _candidates(finding.candidates),
    }


def _where(finding: NamedEffect) -> str:
    """Return the place in words; where they begin with signal and axis, those once."""
    where = finding.where
    place = f"{where.signal} against {where.against}"
    return where.text if where.text.startswith(place) else f"{place}: {where.text}"


def _since(since: Identification | None) -> dict[str, Any] | None:
    """Return what has changed since the baseline."""
    if since is None:
        return None
    return {
        "verdict": since.verdict, "sentence": words.change_sentence(since),
        "data": words.data_of(since),
        "findings": [_finding(finding) for finding in since.findings],
        "unknown": since.unknown, "reasons": since.reasons, "next_test": since.next_test,
    }


ALSO = "validate", "baseline", "without"
"""Options of `ema identify` that are given again."""


def next_commands(
    identification: Identification,
    out: Path,
    inputs: Mapping[str, Sequence[str]],
) -> list[str]:
    """Return commands that use the updated model, check it, and run the proposed test.

    Parameters
    ----------
    identification : the result.
    out : the folder of the report.
    inputs : as `write_page` has them; what `ema identify` was given is given again.
    """
    found = []
    measured = " ".join(shlex.quote(path) for path in inputs.get("measured", ()))

    def given(*options: str) -> str:
        return "".join(f" --{option} {shlex.quote(value)}" for option in options
                       for value in inputs.get(option, ())) + kit_option()

    own = ["model"] if Path(*inputs.get("model", ())).is_file() else []  # none of the kit
    if identification.model_text:
        model = shlex.quote(str(out / MODEL_FILE))
        if identification.machine == "actuator":
            found.append(f"ema simulate --model {model} --profile extended --out simulated"
                         f"{kit_option()}")
        if measured:
            again = shlex.quote(f"{out}_again")
            found.append(f"ema identify {measured}{given(*ALSO, 'profile')} --model {model} "
                         f"--out {again}")
    if identification.next_profile is not None:
        test = shlex.quote(str(out / NEXT_TEST_FILE))
        found.append(f"ema bit --profile {test}{kit_option()}")
        if measured:
            both = shlex.quote(f"{out}_next")
            found.append(f"ema identify {measured} NEW_RECORD{given(*ALSO, *own)} --out {both}")
    return found
