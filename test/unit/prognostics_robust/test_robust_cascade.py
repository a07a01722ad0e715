"""What is announced, and what the guard makes of a record: small closed cases."""

from __future__ import annotations

import numpy as np
import pytest

from ema_prognostics.network import Network, logit
from ema_prognostics.robust.cascade import announced
from ema_prognostics.robust.classes import FAMILIES, OUTPUTS, level_of
from ema_prognostics.robust.guard import SQUEEZE, Guard, Limits, squeeze
from ema_prognostics.robust.strangers import RANGES, draw_stranger
from ema_sim.effects.settings import effects_from_mapping


def say(margins: dict[str, float], **probability: float) -> tuple[str, ...]:
    p = np.zeros(len(OUTPUTS))
    for name, value in probability.items():
        p[OUTPUTS.index(name)] = value
    return announced(p, np.array([margins.get(name, -1.0) for name in FAMILIES]))


def test_nothing_is_announced_below_the_thresholds() -> None:
    assert say({}, short_a=0.9) == ()


def test_member_of_a_family_with_the_largest_share_is_named() -> None:
    assert say({"asymmetry": 1.0}, short_a=0.1, short_b=0.6, static_eccentricity=0.2) == (
        "short_b",)


def test_two_faults_of_different_classes_most_probable_first() -> None:
    found = say({"asymmetry": 1.0, "backlash": 2.0}, short_c=0.7, backlash=0.99)
    assert found == ("backlash", "short_c")


def test_second_fault_must_be_probable_and_of_another_class() -> None:
    assert say({"asymmetry": 1.0, "backlash": 2.0}, short_c=0.4, backlash=0.99) == ("backlash",)
    both = {"motor_friction": 1.0, "surface_friction": 2.0}
    assert say(both, motor_friction=0.8, surface_friction=0.9) == ("surface_friction",)


@pytest.mark.parametrize(("severity", "level"), [(0.05, "small"), (0.1, "medium"),
                                                 (0.2, "large")])
def test_levels_of_a_short(severity: float, level: str) -> None:
    assert level_of("turn_short", severity) == level


def constant(value: float, inputs: int, outputs: int) -> Network:
    """Return a network that always gives `value`."""
    return Network(
        input_mean=np.zeros(inputs), input_scale=np.ones(inputs),
        hidden_weights=np.zeros((inputs, 1)), hidden_bias=np.zeros(1),
        output_weights=np.zeros((1, outputs)), output_bias=np.full(outputs, value),
        output_law="linear", output_mean=np.zeros(outputs), output_scale=np.ones(outputs),
    )


def test_guard_has_its_own_limits_for_records_without_a_fault() -> None:
    wide = Limits(np.full(2, 4.0), np.eye(2), 8.0, 0.0)
    narrow = Limits(np.full(2, 2.0), np.eye(2), 4.0, 0.0)
    guard = Guard(
        drivers=np.array([0]), checked=np.array([1, 2]), mean=constant(0.0, 1, 2),
        scale=constant(0.0, 1, 2), stranger=constant(0.5, 2, 1), known=wide, healthy=narrow,
    )
    u = np.array([[9.0, 3.0, 0.0]] * 2)
    scores = guard.scores(u, np.array([True, False]))
    assert scores[0, 0] == pytest.approx(3.0 / 1.02 / 2.0)
    assert scores[1, 0] == pytest.approx(3.0 / 1.02 / 4.0)
    assert scores[0, 0] > 1.0 > scores[1, 0]
    # The network of strangers says one half: logit 0, exactly its bound.
    assert scores[:, -1] == pytest.approx([1.0, 1.0])


def test_squeeze_bounds_a_single_feature() -> None:
    assert squeeze(np.array([100.0]))[0] == pytest.approx(SQUEEZE)
    assert squeeze(np.array([0.01]))[0] == pytest.approx(0.01, rel=1e-4)


def test_logit_is_bounded() -> None:
    assert np.isfinite(logit(np.array([0.0, 1.0]))).all()
    assert logit(np.array([0.5]))[0] == 0.0


def test_strangers_are_effects_within_their_bounds_and_no_class_of_ours() -> None:
    rng = np.random.default_rng(0)
    seen = set()
    for _ in range(300):
        settings = draw_stranger(rng)
        effects_from_mapping(settings)  # raises where a value is out of bounds
        seen.add(next(iter(settings)))
    assert seen == set(RANGES)
    faults = {"turn_short", "rotor_eccentricity", "motor_friction", "surface_friction",
              "backlash"}
    assert not {name.partition(".")[0] for name in RANGES} & faults
