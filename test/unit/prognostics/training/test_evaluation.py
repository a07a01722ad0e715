"""What a validation counts: a friction that stops the actuator is no missed friction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ema_prognostics.cascade.classes import OUTPUTS
from ema_prognostics.cascade.find import Cascade
from ema_prognostics.cascade.model_file import load_model
from ema_prognostics.training.evaluation import evaluate
from ema_prognostics.training.fleet import simulate_fleets
from ema_record.actuator import load_actuator
from ema_record.profiles.motion import RESERVE, friction_at, torque_at, turnable

NOMINAL = load_actuator()


@pytest.mark.parametrize("part", ["motor", "surface"])
def test_what_an_actuator_turns_leaves_the_reserve_and_no_more(part: str) -> None:
    most = turnable(NOMINAL)[f"{part}_friction"]

    def spare(increase: float) -> float:
        """Return torque less friction with the reserve, where it is least (N m)."""
        of = getattr(NOMINAL, part)
        a = NOMINAL._replace(**{part: of._replace(
            dynamic_friction=of.dynamic_friction * (1.0 + increase),
            static_friction=of.static_friction * (1.0 + increase))})
        at = np.array([0.0, a.control.speed_limit])
        torque, friction = torque_at(a, at) / RESERVE, friction_at(a, at)
        friction[0] = a.motor.static_friction + a.surface.static_friction / a.gear.ratio
        return float((torque - friction).min())

    assert spare(0.99 * most) > 0.0
    assert spare(most) == pytest.approx(0.0, abs=1e-12)
    assert spare(1.01 * most) < 0.0


def test_a_friction_that_cannot_be_turned_counts_nowhere() -> None:
    model = load_model()
    view = model.body.views["step/fleet"]
    fleet = simulate_fleets(("step",), 4, 91)["step"]
    healthy = simulate_fleets(("step",), 3, 92, healthy=True)["step"]
    severity = np.zeros_like(fleet.severity)
    column = OUTPUTS.index("motor_friction")
    severity[:, column] = 0.1
    severity[::2, column] = 1.5 * turnable(NOMINAL)["motor_friction"]
    found = evaluate(Cascade(view), None, replace(fleet, severity=severity), healthy)
    assert found["friction"]["detected"]["total"] == len(fleet) - len(severity[::2])
    severity[::2, OUTPUTS.index("backlash")] = 1e-3
    found = evaluate(Cascade(view), None, replace(fleet, severity=severity), healthy)
    assert found["pairs both named"]["total"] == 0
