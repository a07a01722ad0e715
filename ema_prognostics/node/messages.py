"""The verdict as messages of the client library."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float64

from ema_ros.messages import ERROR, OK, WARN, diagnostic_status

_LEVELS = {"healthy": OK, "fault": ERROR, "invalid": ERROR}
_SCALARS = ("verdict", "fault_class", "phase", "severity", "severity_unit", "level")


def sentence(verdict: Mapping[str, Any]) -> str:
    """Return the verdict in a few words."""
    if verdict["verdict"] != "fault":
        return str(verdict["verdict"])
    words = [str(verdict["fault_class"])]
    if verdict.get("phase"):
        words.append(f"phase {verdict['phase']}")
    if verdict.get("severity") is not None:
        words.append(f"{verdict['severity']:.3g} {verdict.get('severity_unit') or ''}".strip())
    return ", ".join(words)


def verdict_status(verdict: Mapping[str, Any], serial_number: str) -> DiagnosticStatus:
    """Return a verdict, as `ema check --json` prints it, as a diagnostic status."""
    values = {name: _text(verdict.get(name)) for name in _SCALARS}
    interval = verdict.get("severity_interval") or (None, None)
    values["severity_lower"], values["severity_upper"] = map(_text, interval)
    for name, probability in (verdict.get("probabilities") or {}).items():
        values[f"probability.{name}"] = _text(probability)
    values["alternatives"] = ", ".join(verdict.get("alternatives") or [])
    values["reasons"] = "; ".join(map(str, verdict.get("reasons") or []))
    values["json"] = json.dumps(dict(verdict), ensure_ascii=False)
    return diagnostic_status(
        "ema_prognostics: verdict", _LEVELS.get(verdict["verdict"], WARN), sentence(verdict),
        values, serial_number,
    )


def severity_message(verdict: Mapping[str, Any]) -> Float64:
    """Return the severity: 0 when healthy, NaN when it is not known."""
    severity = verdict.get("severity")
    if severity is None:
        severity = 0.0 if verdict["verdict"] == "healthy" else math.nan
    return Float64(data=float(severity))


def _text(value: object) -> str:
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
