"""Fleet and training in small: everything follows from the seed."""

import math

import numpy as np
import pytest

from ema_prognostics.evaluation import evaluate
from ema_prognostics.fleet import BLIND_ANGLE, SPREAD, draw_runs, fleet_features, plant_of, unit
from ema_prognostics.model_file import Model, model_text, parse_model
from ema_prognostics.training import FleetSize, TrainingSettings, train_cascade
from ema_sim.actuator import load_actuator

TINY = TrainingSettings(
    seed=5, train=FleetSize(healthy=40, fault=40, wear=8),
    calibrate=FleetSize(healthy=30, fault=18, wear=0),
    test=FleetSize(healthy=6, fault=6, wear=2), n_restarts=1,
)


def test_runs_follow_from_the_seed():
    labels = TINY.train.labels()
    assert draw_runs(labels, 3) == draw_runs(labels, 3)
    assert draw_runs(labels, 3) != draw_runs(labels, 4)


def test_static_eccentricity_stays_away_from_the_axes_of_a_short():
    runs = [r for r in draw_runs(["rotor_eccentricity"] * 400, 1)
            if "rotor_eccentricity.mode=static" in r.effects]
    assert len(runs) > 40
    for run in runs:
        values = dict(e.split("=") for e in run.effects)
        zeta = float(values["rotor_eccentricity.zeta"])
        angle = float(values["rotor_eccentricity.angle"])
        for k in range(3):
            # phase k weakened most: zeta cos(angle - phi_k) = -|zeta|
            weakest = 2 * math.pi * k / 3 + (math.pi if zeta > 0 else 0.0)
            apart = abs(math.remainder(angle - weakest, 2 * math.pi))
            assert apart >= BLIND_ANGLE - 1e-9


def test_a_unit_has_its_deviations():
    nominal = load_actuator()
    factors = tuple(0.5 * width for width in SPREAD.values())
    made = unit(nominal, factors)
    assert made.motor.phase_resistance == pytest.approx(1.05 * nominal.motor.phase_resistance)
    assert made.shaft.stiffness == pytest.approx(1.015 * nominal.shaft.stiffness)
    assert unit(nominal, (0.0,) * len(SPREAD)) == nominal


def test_features_do_not_depend_on_the_number_of_processes():
    runs = draw_runs(["healthy", "turn_short", "rotor_eccentricity", "backlash.increase"], 9)
    one = fleet_features(runs, "step", jobs=1)
    two = fleet_features(runs, "step", jobs=2, chunk=2)
    for a, b in zip(one, two):
        np.testing.assert_array_equal(a.lines, b.lines)
        np.testing.assert_array_equal(a.mechanics, b.mechanics)


def test_same_seed_same_bytes_of_the_model():
    texts, steps = [], []
    for _ in range(2):
        cascade, fleet = train_cascade("step", TINY, 1, steps.append)
        model = Model(
            cascades={"step": cascade}, paper=None, plant=plant_of(load_actuator()),
            training={"held_out": evaluate(cascade, fleet)},
        )
        texts.append(model_text(model))
    assert texts[0] == texts[1]
    assert len(steps) == 2 * TINY.steps(1)
    counts = parse_model(texts[0], "tiny").training["held_out"]["confusion"]
    assert sum(counts["healthy"].values()) == 6
