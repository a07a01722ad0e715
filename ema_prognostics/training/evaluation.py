"""The validation: how a cascade does on units that it was not trained on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ema_prognostics.cascade.classes import (
    CLASS_OF,
    FAULTS,
    OUTPUTS,
    SEVERITY_OF,
    SHORTS,
)
from ema_prognostics.cascade.find import Cascade, Detection
from ema_prognostics.cascade.guard import BESIDE_OWN
from ema_prognostics.cascade.model_body import View, ViewPart
from ema_prognostics.training.fleet import FleetFeatures
from ema_prognostics.training.rates import ORIGIN, Rate, detection_curve, rate
from ema_prognostics.training.view_training import view_inputs
from ema_record.actuator import load_actuator
from ema_record.profiles.motion import turnable


def outcome_of(detection: Detection) -> str:
    """Return the verdict in one word: healthy, unknown or the classes, joined by ``+``."""
    if detection.unusual() or detection.doubtful:
        return "unknown"
    return "+".join(sorted(CLASS_OF[o] for o in detection.outputs)) or "healthy"


def _plain(found: Rate) -> dict[str, float | int]:
    return {"count": found.hits, "total": found.total, "lower": round(found.lower, 5),
            "upper": round(found.upper, 5)}


def evaluated(
    views: Mapping[View, ViewPart], held: Sequence[FleetFeatures]
) -> dict[str, Any]:
    """Return the validation of both views on `held` fleets, in the order of `evaluate`."""
    fleet, own = Cascade(views["fleet"]), Cascade(views["baseline"])
    return {"fleet": evaluate(fleet, None, *held), "baseline": evaluate(fleet, own, *held)}


def evaluate(
    fleet: Cascade, own: Cascade | None, campaign: FleetFeatures, healthy: FleetFeatures,
    strangers: FleetFeatures | None = None,
) -> dict[str, Any]:
    """Return the validation of one view as plain values.

    Parameters
    ----------
    fleet : the cascade without baseline; its guard judges every record first.
    own : the cascade with a baseline, None to evaluate `fleet`.
    campaign, healthy, strangers : units that neither trained nor calibrated anything. A friction
        that the actuator cannot turn counts nowhere: what crawls is unknown, not missed.
    """
    cascade = fleet if own is None else own
    result: dict[str, Any] = {}
    _, outcomes = _judge(fleet, own, healthy)
    result["false alarms"] = _plain(rate([o not in ("healthy", "unknown") for o in outcomes]))
    result["healthy called unknown"] = _plain(rate([o == "unknown" for o in outcomes]))
    if strangers is not None:
        _, outcomes = _judge(fleet, own, strangers)
        result["strangers told"] = _plain(rate([o == "unknown" for o in outcomes]))
    detections, outcomes = _judge(fleet, own, campaign)
    turned = np.ones(len(campaign), dtype=bool)
    for output, most in turnable(load_actuator()).items():
        turned &= campaign.severity[:, OUTPUTS.index(output)] <= most
    for name in FAULTS:
        columns = [k for k, o in enumerate(OUTPUTS) if CLASS_OF[o] == name]
        mine = campaign.severity[:, columns].max(axis=1)
        only = turned & (mine > 0.0) & ((campaign.severity > 0.0).sum(axis=1) == 1)
        said = [outcomes[k] for k in np.flatnonzero(only)]
        found = np.array([o not in ("healthy", "unknown") for o in said], dtype=bool)
        right = [name in o.split("+") for o, f in zip(said, found) if f]
        inside, error = _severities(detections, campaign, only, columns)
        curve = detection_curve(mine[only], found, ORIGIN.get(name, 0.0))
        result[name] = {
            "detected": _plain(rate(found)), "right class of detected": _plain(rate(right)),
            "interval coverage": _plain(rate(inside)),
            **({"right phase": _plain(rate(_phases(detections, campaign, only, columns)))}
               if name == CLASS_OF[SHORTS[0]] else {}),
            "median relative error": round(float(np.median(error)), 4) if error else None,
            **{key: None if curve is None or value > mine.max() else float(f"{value:.3g}")
               for key, value in (("a90", curve and curve.a90), ("a90/95", curve and curve.a90_95))
               },
        }
    pairs = turned & ((campaign.severity > 0.0).sum(axis=1) == 2)
    result["pairs both named"] = _plain(rate([
        set(outcomes[k].split("+")) == {
            CLASS_OF[OUTPUTS[c]] for c in np.flatnonzero(campaign.severity[k])}
        for k in np.flatnonzero(pairs)
    ]))
    result["features"] = len(cascade.view.names)
    return result


def _judge(
    fleet: Cascade, own: Cascade | None, campaign: FleetFeatures
) -> tuple[list[Detection], list[str]]:
    _, x = view_inputs(campaign, "fleet")
    detections = fleet.find(x)
    if own is None:
        return detections, [outcome_of(f) for f in detections]
    guarded = [f.unusual(BESIDE_OWN, stranger=False) for f in detections]
    _, x = view_inputs(campaign, "baseline")
    detections = own.find(x)
    return detections, ["unknown" if g else outcome_of(f) for g, f in zip(guarded, detections)]


def _phases(
    detections: list[Detection], campaign: FleetFeatures, rows: np.ndarray, columns: list[int]
) -> list[bool]:
    """Return whether the phase is right, where a short is there and named."""
    found = []
    for k in np.flatnonzero(rows):
        said = [output for output in detections[k].outputs if output in SHORTS]
        if said:
            found.append(said[0] == OUTPUTS[columns[int(campaign.severity[k, columns].argmax())]])
    return found


def _severities(
    detections: list[Detection], campaign: FleetFeatures, rows: np.ndarray, columns: list[int]
) -> tuple[list[bool], list[float]]:
    """Return whether the interval holds the truth, and the relative error, where named."""
    inside, error = [], []
    for k in np.flatnonzero(rows):
        column = next(c for c in columns if campaign.severity[k, c] > 0.0)
        truth = float(campaign.severity[k, column])
        for output, s in zip(detections[k].outputs, detections[k].severity):
            if SEVERITY_OF[output] == SEVERITY_OF[OUTPUTS[column]]:
                inside.append(s.lower <= truth <= s.upper)
                error.append(abs(s.value - truth) / truth)
    return inside, error
