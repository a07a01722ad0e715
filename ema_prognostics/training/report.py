"""The report of a validation beside a model file: as JSON, and in words."""

from __future__ import annotations

from typing import Any

from ema_prognostics.cascade.classes import FAULTS, UNITS
from ema_prognostics.cascade.model_file import TrainedModel
from ema_prognostics.words import ENGLISH, size


def _percent(found: dict[str, Any]) -> str:
    if not found["total"]:
        return "none"
    value = 100.0 * found["count"] / found["total"]
    return (f"{value:.2f} % ({found['count']} of {found['total']}; "
            f"{100 * found['lower']:.2f} to {100 * found['upper']:.2f})")


def validation_data(model: TrainedModel) -> dict[str, Any]:
    """Return the validation as plain values, what `validation.json` of a kit holds."""
    training = model.training
    return {
        "software_version": training.get("software_version", ""), "seed": training["seed"],
        "quick": training.get("quick", False), "settings": training["settings"],
        "cascade_sha256": model.sha256, "held_out": training["held_out"],
    }


def validation_report(model: TrainedModel) -> str:
    """Return the report of a model's validation: rates with counts and 95 % bounds."""
    training = model.training
    settings = training["settings"]
    lines = [
        "# Validation of a model file",
        "",
        f"Seed {training['seed']}, {settings['units']} units with faults and "
        f"{settings['healthy']} healthy ones a test; validated on "
        f"{settings['validation']} and {settings['validation_healthy']} other units. Hash "
        f"`{model.sha256[:16]}`. Rates with their exact 95 % bounds. Faults of every size, also "
        "such as cannot be found: what share of them is detected depends on that.",
    ]
    for kind, views in training["held_out"].items():
        for view, found in views.items():
            with_what = "own baseline" if view == "baseline" else "fleet model only"
            lines += [
                "", f"## Profile {kind}, {with_what}", "",
                f"- false alarms on healthy records: {_percent(found['false alarms'])}",
                f"- healthy records called unknown: {_percent(found['healthy called unknown'])}",
                f"- two faults, both named: {_percent(found['pairs both named'])}",
                *([f"- strangers of all sizes called unknown: {_percent(found['strangers told'])}"]
                  if "strangers told" in found else []),
                "",
                "| fault | detected | a90/95 | right class | interval holds | median error |",
                "|---|---|---|---|---|---|",
            ]
            for name in FAULTS:
                f = found[name]
                error = f["median relative error"]
                lines.append(
                    f"| {name} (in {UNITS[name]}) | {_percent(f['detected'])} | "
                    f"{size(name, f['a90/95'], ENGLISH)} | "
                    f"{_percent(f['right class of detected'])} | "
                    f"{_percent(f['interval coverage'])} | "
                    f"{'-' if error is None else f'{100 * error:.1f} %'} |"
                )
    return "\n".join([*lines, ""])
