"""Torque of the surface and compliance of the shaft, from what a record shows. Closed forms."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from ema_prognostics.cascade.inputs import LEAST_TORQUE, MECHANICAL, derive, mechanical
from ema_prognostics.features.vector import START, difference_names, differences, start_allowed
from ema_record.actuator import load_actuator

NAMES = ["torque_ramp", "gap_torque", "torque_full", "torque_quarter", "lag_ramp", "gap_width",
         "shaft_slope"]
LINES = [f"quarter_even_m{h}_{part}" for h in range(1, 7) for part in ("re", "im")]


class Told(NamedTuple):
    """Stands for the filter of lines: says of which records it was told the lines."""

    def derive(self, names, x, told=None):
        return np.ones((len(x), 1)) if told is None else 1.0 * told[:, None]


NOMINAL = load_actuator()


def record(motor: float, surface: float, viscous: float, soft: float, play: float) -> np.ndarray:
    """Return features of torques at the motor (N m), lost motion (rad), compliance of nominal.

    The surface winds the shaft up one way on the ramp forward, the other way on the ramp back.
    """
    wound = 2.0 * soft * surface * NOMINAL.gear.ratio / NOMINAL.shaft.stiffness
    torque = motor + surface
    return np.array([[np.log(torque), np.log(motor), np.log(torque + viscous), np.log(torque),
                      1e4 * (play + wound), 1e4 * play, 1.0 / soft]])


def test_what_the_surface_takes_and_how_far_it_winds_the_shaft() -> None:
    found = dict(zip(MECHANICAL, mechanical(NAMES, record(0.03, 0.2, 0.04, 1.5, 1e-4))[0]))
    assert found == pytest.approx({
        "surface_torque": np.log(0.2), "viscous_torque": 0.04, "compliance": np.log(1.5),
        "stiffness_agreement": 0.0})
    less = mechanical(NAMES[:4], record(0.03, 1e-9, 0.04, 1.5, 1e-4)[:, :4])
    assert less[0] == pytest.approx([np.log(LEAST_TORQUE * NOMINAL.friction_torque), 0.04])
    assert mechanical(["torque_full"], np.ones((3, 1))).shape == (3, 0)


@pytest.mark.parametrize("hidden", [0, 1, 2])
def test_with_a_baseline_it_is_what_has_changed_and_what_is(hidden: int) -> None:
    before, now = record(0.03, 0.2, 0.04, 1.5, 1e-4), record(0.06, 0.3, 0.09, 3.0, 1e-3)
    rows = [np.hstack([row, np.where(k == hidden, 0.0, np.ones((1, len(LINES))))])
            for k, row in enumerate((before, now))]
    names = [*NAMES, *LINES]
    found = derive(difference_names(names), differences(*rows[::-1]), Told(), Told())[0]
    own = mechanical(NAMES, now)[0]
    changed = own - mechanical(NAMES, before)[0]
    assert found[2 * len(names):] == pytest.approx([float(hidden == 2), *changed, 1.0, *own])


def test_a_surface_may_rest_up_to_the_wind_up_off() -> None:
    lag = NOMINAL.surface.static_friction / NOMINAL.shaft.stiffness + NOMINAL.shaft.backlash
    x = np.array([[k * 1e3 * lag, 5.0] for k in (0.9, -0.9, 1.5, -1.5)])  # mrad
    found = start_allowed(x, [START, "torque_full"])
    assert found[:, 0] == pytest.approx([0.0, 0.0, 500.0 * lag, -500.0 * lag])
    assert (found[:, 1] == 5.0).all()
