"""The verdict as messages of the client library."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float64

from ema_prognostics.verdict.verdict import Judged
from ema_prognostics.words import severity_words
from ema_ros.messages import ERROR, OK, WARN, diagnostic_status

_LEVELS = {"healthy": OK, "fault": ERROR, "invalid": ERROR}
FAULTS = ("turn_short_a", "turn_short_b", "turn_short_c", "rotor_eccentricity", "friction",
          "backlash")
"""Each class and phase, as a status of its own is named."""
NOT_JUDGED = ("unknown", "incomplete", "invalid")
"""Outcomes that say of no class that it is or is not there."""
_SIZE = ("severity", "severity_unit", "level")
_SCALARS = ("verdict", "fault_class", "phase", "severity", "severity_unit", "level")


def sentence(verdict: Mapping[str, Any]) -> str:
    """Return the verdict in a few words."""
    if verdict["verdict"] != "fault":
        return str(verdict["verdict"])
    words = [str(verdict["fault_class"])]
    if verdict.get("phase"):
        words.append(f"phase {verdict['phase']}")
    if verdict.get("severity") is not None:
        words.append(severity_words(str(verdict["fault_class"]), verdict["severity"]))
    return ", ".join(words)


def fault_codes(verdict: Mapping[str, Any]) -> list[str]:
    """Return a code for each fault, largest first: ``EMA_TURN_SHORT_B``, ``EMA_FRICTION``.

    What is not known is a code too: ``EMA_UNKNOWN``, ``EMA_INCOMPLETE``, ``EMA_INVALID``. A
    healthy actuator has none.
    """
    if verdict["verdict"] == "healthy":
        return []
    faults = verdict.get("faults") or [verdict]
    codes = ["_".join(filter(None, ("EMA", fault.get("fault_class"), fault.get("phase")))).upper()
             for fault in faults if fault.get("fault_class")]
    return codes or [f"EMA_{verdict['verdict']}".upper()]


def verdict_status(name: str, verdict: Mapping[str, Any], judged: Judged) -> DiagnosticStatus:
    """Return a verdict as a diagnostic status.

    Parameters
    ----------
    name : of the status.
    verdict : as `ema check --json` prints it.
    judged : whose it is: serial number and start of the test.
    """
    codes = fault_codes(verdict)
    values = {"fault_code": codes[0] if codes else "", "fault_codes": ", ".join(codes)}
    values["bag"] = str(verdict["bag"])
    values |= {key: _text(verdict.get(key)) for key in _SCALARS}
    interval = verdict.get("severity_interval") or (None, None)
    values["severity_lower"], values["severity_upper"] = map(_text, interval)
    for key, probability in (verdict.get("probabilities") or {}).items():
        values[f"probability.{key}"] = _text(probability)
    values["alternatives"] = ", ".join(verdict.get("alternatives") or [])
    values["reasons"] = "; ".join(map(str, verdict.get("reasons") or []))
    values["stamp"], values["test_stamp"] = str(time.time_ns()), str(judged.start_time)
    values["json"] = json.dumps(dict(verdict), ensure_ascii=False)
    return diagnostic_status(
        name, _LEVELS.get(verdict["verdict"], WARN), sentence(verdict), values,
        judged.serial_number,
    )


def fault_statuses(
    prefix: str, verdict: Mapping[str, Any], serial_number: str
) -> list[DiagnosticStatus]:
    """Return a status for each class and phase, for consumers that take one fault a name.

    They are named ``ema: turn_short_b`` after `prefix`. OK clears a fault, so it is said only
    where the verdict rules the class out: not of one that it cannot tell from what it names, and
    of none where it is unknown, incomplete or invalid, each of which has a status of its own.
    """
    outcome, codes = verdict["verdict"], fault_codes(verdict)
    open_classes = set(verdict.get("alternatives") or [])
    faults = dict(zip(codes, verdict.get("faults") or []))
    found = []
    for name in (*FAULTS, *NOT_JUDGED):
        code = f"EMA_{name}".upper()
        if code not in codes and name in FAULTS and (
            outcome in NOT_JUDGED or any(name.startswith(other) for other in open_classes)
        ):
            continue
        level = _LEVELS.get(outcome, WARN) if code in codes else OK
        fault = faults.get(code, {})
        found.append(diagnostic_status(
            f"{prefix}ema: {name}", level, sentence(verdict) if code in codes else "no sign of it",
            {"fault_code": code, **{key: _text(fault.get(key)) for key in _SIZE}}, serial_number,
        ))
    return found


def severity_message(verdict: Mapping[str, Any]) -> Float64:
    """Return the severity: 0 when healthy, NaN when it is not known."""
    severity = verdict.get("severity")
    if severity is None:
        severity = 0.0 if verdict["verdict"] == "healthy" else math.nan
    return Float64(data=float(severity))


def _text(value: object) -> str:
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
