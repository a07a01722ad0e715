"""The state of a fleet's units as OpenMetrics text."""

from __future__ import annotations

from collections.abc import Mapping

from ema_prognostics.fleet.fleet import STATES, Fleet, share_of_large
from ema_prognostics.fleet.tables import OURS


def open_metrics(fleet: Fleet) -> str:
    """Return the state of the units as OpenMetrics 1.0 text, for a textfile collector.

    It holds gauges alone, so that readers of the older text format of Prometheus take it too.
    """
    units = [({"serial_number": u.serial_number or "unknown"}, u) for u in fleet.units]
    lines = [
        "# TYPE ema_unit_state gauge",
        f"# HELP ema_unit_state What the unit needs, written by {OURS}.",
        *(_sample("ema_unit_state", labels | {"ema_unit_state": state}, int(u.state == state))
          for labels, u in units for state in STATES),
        "# TYPE ema_unit_tests gauge", "# HELP ema_unit_tests Bags of the unit.",
        *(_sample("ema_unit_tests", labels, len(u.objects)) for labels, u in units),
        "# TYPE ema_unit_last_test_timestamp_seconds gauge",
        "# UNIT ema_unit_last_test_timestamp_seconds seconds",
        "# HELP ema_unit_last_test_timestamp_seconds Start of the last test.",
        *(_sample("ema_unit_last_test_timestamp_seconds", labels, u.last.start_time / 1e9)
          for labels, u in units if u.last.start_time),
        "# TYPE ema_fault_severity_ratio gauge", "# UNIT ema_fault_severity_ratio ratio",
        "# HELP ema_fault_severity_ratio Severity now, of that of a large fault.",
        *(_sample("ema_fault_severity_ratio", labels | {
            "fault_class": f.history.fault_class, "phase": f.history.phase or "",
            "confirmed": str(f.present).lower()}, share_of_large(f))
          for labels, u in units for f in u.trend.faults if f.episodes[-1].cleared is None),
    ]
    return "\n".join([*lines, "# EOF"]) + "\n"


def _sample(name: str, labels: Mapping[str, str], value: float) -> str:
    inside = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
    return f"{name}{{{inside}}} {value:.10g}"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
