"""A condition left out of training: accuracy there, beside the rest.

The networks are trained again on the records of the campaign that do not have the condition,
baselines included, and judge the whole held-out fleet, with the fleet model only and with each
unit's own baseline.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.detection.generate import Tested
from benchmarks.detection.judge import CLASS, VIEWS, Judged, View, inside, judge, of
from benchmarks.detection.table import accuracy, plain
from ema_prognostics.cascade.model_body import Body
from ema_prognostics.cascade.model_file import model_of
from ema_prognostics.training.campaign import Campaign
from ema_prognostics.training.rates import rate
from ema_prognostics.training.training import train_view

CONDITIONS: dict[str, tuple[str, Callable[[np.ndarray], np.ndarray],
                            Callable[[Judged], bool]]] = {
    "hot winding (above 45 degC)": (
        "temperature", lambda v: v > 0.5,
        lambda j: float(j.case.effects["winding_temperature.temperature"]) > 45.0),
    "cold winding (below -15 degC)": (
        "temperature", lambda v: v < -0.7,
        lambda j: float(j.case.effects["winding_temperature.temperature"]) < -15.0),
    "low bus (below -5 %)": (
        "bus_voltage", lambda v: v < 0.95,
        lambda j: float(j.case.effects["bus_voltage_change.change"]) < -0.05),
    "high bus (above +5 %)": (
        "bus_voltage", lambda v: v > 1.05,
        lambda j: float(j.case.effects["bus_voltage_change.change"]) > 0.05),
    "large surface load (beyond 10 N m)": (
        "load_quarter", lambda v: np.abs(v) > 0.0205,
        lambda j: abs(float(j.case.effects["surface_load.constant"])) > 10.0),
}
"""Name; feature and rule that find it in the campaign; rule that finds it in the fleet."""


def _without(campaign: Campaign, feature: str, rule: Callable[[np.ndarray], np.ndarray]
             ) -> Campaign:
    column = campaign.names.index(feature)
    keep = ~(rule(campaign.record[:, column]) | rule(campaign.baseline[:, column]))
    return replace(campaign, baseline=campaign.baseline[keep], record=campaign.record[keep],
                   severity=campaign.severity[keep], unit=campaign.unit[keep],
                   friction=campaign.friction[keep])


def left_out(
    campaign: Campaign, healthy: Campaign, fleet: Sequence[Tested],
    visible: dict[View, dict[str, float]], *, seed: int,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Return, for each view and condition, accuracy and coverage in it and in the rest.

    Parameters
    ----------
    campaign, healthy : those of the shipped model.
    fleet : the held-out fleet.
    visible : for each view, severity of each group from which a fault counts.
    seed : of the networks.
    progress : called with each condition.
    """
    result: dict[str, Any] = {view: {} for view in VIEWS}
    for name, (feature, rule, there) in CONDITIONS.items():
        progress(name)
        rest = _without(campaign, feature, rule), _without(healthy, feature, rule)
        model = model_of(Body(
            views={f"extended/{view}": train_view(*rest, "extended", view, seed=seed)
                   for view in VIEWS}, paper=None, training={}))
        for view in VIEWS:
            judged = judge(fleet, model, view)
            parts = {"in it": [j for j in judged if there(j)],
                     "elsewhere": [j for j in judged if not there(j)]}
            result[view][name] = {where: _numbers(part, visible[view])
                                  for where, part in parts.items()}
    return result


def _numbers(judged: Sequence[Judged], visible: dict[str, float]) -> dict[str, Any]:
    known = of(judged, "healthy", *CLASS)
    strangers = of(judged, "stranger", "sensor")
    return {
        "accuracy": plain(accuracy(known, visible)),
        "false alarms": plain(rate([j.detected for j in of(judged, "healthy")])),
        "unknown": plain(rate([j.outcome == "unknown" for j in known])),
        "interval holds": plain(rate(inside(of(judged, *CLASS)))),
        "strangers wrong": plain(rate([
            j.detected or j.outcome == "healthy" for j in strangers])),
    }
