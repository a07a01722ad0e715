"""What is announced, and what the guard makes of a record: small closed cases."""

from __future__ import annotations

import numpy as np
import pytest

from ema_prognostics.cascade.classes import (
    CLEAR,
    FAMILIES,
    KINDS_FOUND,
    OUTPUTS,
    STRANGERS,
    TAIL_RATES,
    kind_found,
    level_of,
    probability_known,
    scale_of,
    tail_probability,
)
from ema_prognostics.cascade.find import SeverityNetwork, announced
from ema_prognostics.cascade.guard import (
    GROUP_SQUEEZE,
    LEAST_KNOWN,
    SQUEEZE,
    GroupLimit,
    Guard,
    Limits,
    squeeze,
)
from ema_prognostics.cascade.guard_groups import GROUPS, group_columns
from ema_prognostics.cascade.inputs import Inputs, group_inputs, input_names
from ema_prognostics.cascade.lines import LineFilter
from ema_prognostics.cascade.model_body import NetworkPart, SeverityPart
from ema_prognostics.networks.network import Network, logit
from ema_record.actuator import load_actuator


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


def test_no_third_fault_is_named() -> None:
    found = say({"asymmetry": 1.0, "backlash": 2.0, "motor_friction": 1.0},
                short_c=0.7, backlash=0.9, motor_friction=0.8)
    assert found == ("backlash", "motor_friction")


@pytest.mark.parametrize(("severity", "level"), [(0.05, "small"), (0.1, "medium"),
                                                 (0.2, "large")])
def test_levels_of_a_short(severity: float, level: str) -> None:
    assert level_of("turn_short", severity) == level


def test_lost_motion_is_counted_in_a_tenth_of_what_the_surface_lags() -> None:
    nominal = load_actuator()
    lag = nominal.surface.static_friction / nominal.shaft.stiffness + nominal.shaft.backlash
    assert scale_of("backlash") == pytest.approx(0.1 * lag) and scale_of("friction") == 1.0
    levels = [level_of("backlash", part * lag) for part in (0.29, 0.31, 0.99, 1.01)]
    assert levels == ["small", "medium", "medium", "large"]


def test_eccentricity_is_seen_in_the_record_itself_with_a_baseline_too() -> None:
    names = ["torque_full", "absolute_torque_full"]
    seen = {group: group_inputs(group, input_names(names))
            for group in ("eccentricity", "asymmetry")}
    assert all(n.startswith("absolute_") for n in seen["eccentricity"])
    assert {"amplitude_2", "absolute_amplitude_2"} <= set(seen["asymmetry"])
    alone = group_inputs("eccentricity", input_names(names[:1]))
    assert [n.removeprefix("absolute_") for n in seen["eccentricity"]] == alone


def constant(value: float, inputs: int, outputs: int) -> Network:
    """Return a network that always gives `value`."""
    return Network(
        input_mean=np.zeros(inputs), input_scale=np.ones(inputs),
        hidden_weights=np.zeros((inputs, 1)), hidden_bias=np.zeros(1),
        output_weights=np.zeros((1, outputs)), output_bias=np.full(outputs, value),
        output_law="linear", output_mean=np.zeros(outputs), output_scale=np.ones(outputs),
    )


TAIL = np.linspace(0.3, 1.0, len(TAIL_RATES))


def test_guard_has_limits_of_its_own_for_what_is_found() -> None:
    limits = [Limits(np.full(2, x), np.eye(2), 2.0 * x, TAIL) for x in (2.0, 4.0, 4.0, 8.0)]
    guard = Guard(
        drivers=np.array([0]), checked=np.array([1, 2]), signed=np.array([True, False]),
        mean=constant(0.0, 1, 2),
        scale=constant(0.0, 1, 2), limits=tuple(limits),
    )
    u = np.array([[9.0, 3.0, 0.0]] * 3)
    scores, known = guard.scores(u, np.array([0, 1, 3]))
    assert scores[:, 0] == pytest.approx(3.0 / 1.02 / np.array([2.0, 4.0, 8.0]))
    assert scores[0].max() > 1.0 > scores[1].max()
    assert known[0] < known[1] < known[2]
    assert guard.scores(np.array([[9.0, 0.0, -9.0]]), np.array([0]))[0].max() == 0.0
    # Another test than the one trained on: the widest limits, with a margin.
    scores, known = guard.scores(u, np.array([0, 1, 3]), exact=False)
    assert scores[:, 0] == pytest.approx([3.0 / 1.02 / 16.0] * 3)
    assert (known == 1.0).all()


def test_what_was_not_measured_is_not_judged() -> None:
    """It stands at exactly a healthy unit's value, which here is not what is expected."""
    guard = Guard(
        drivers=np.array([0]), checked=np.array([1]), signed=np.array([True]),
        mean=constant(1.0, 1, 1), scale=constant(0.0, 1, 1), limits=())
    found = guard.residuals(np.array([[0.0, 0.0], [0.0, 1e-9]]))[:, 0]
    assert found == pytest.approx([0.0, -1.0 / 1.02])


def test_limits_grow_beyond_the_conditions_that_were_seen() -> None:
    guard = Guard(
        drivers=np.array([0]), checked=np.array([1]), signed=np.array([True]),
        mean=constant(0.0, 1, 1), scale=constant(0.0, 1, 1),
        limits=(Limits(np.ones(1), np.eye(1), 1.0, TAIL),),
        measured=np.array([0]), seen=np.array([[-1.0, 1.0]]),
    )
    u = np.array([[0.0, 3.0], [1.0, 3.0], [2.0, 3.0], [-1.4, 3.0], [90.0, 3.0]])
    assert guard.beyond(u) == pytest.approx([1.0, 1.0, 1.5, 1.2, 2.0])
    inside = guard.residuals(u)[0, 0]
    assert guard.residuals(u)[:, 0] == pytest.approx(inside / guard.beyond(u))


def test_group_is_unusual_where_none_of_its_features_is() -> None:
    group = GroupLimit(np.array([0, 2]), np.eye(2), 2.0)
    limits = Limits(np.full(3, 3.0), np.zeros((3, 3)), 1.0, TAIL, (group,))
    scores = limits.scores(np.array([[2.0, 0.0, 2.0], [2.0, 2.0, 0.0]]))
    assert scores[:, :3].max() < 1.0
    expected = np.sqrt(2.0) * squeeze(np.array(2.0), GROUP_SQUEEZE) / 2.0
    assert scores[0, 3] == pytest.approx(expected)
    assert scores[0, 3] > 1.0 > scores[1, 3]


def test_groups_hold_features_of_one_part_of_the_physics() -> None:
    checked = ("shaft_bend", "control_gain", "lag_ramp", "inertia", "rise_time")
    found = group_columns(checked)
    assert found["transmission"].tolist() == [0, 2]
    assert found["acceleration"].tolist() == [3, 4]
    assert "commutation" not in found  # nothing to be together with
    assert set(found) < set(GROUPS)


def test_what_is_found_in_a_record() -> None:
    severity = np.zeros((5, len(OUTPUTS)))
    severity[1, OUTPUTS.index("short_b")] = 0.99 * CLEAR["turn_short"]
    severity[1, OUTPUTS.index("motor_friction")] = 0.99 * CLEAR["friction"]
    severity[2, OUTPUTS.index("backlash")] = CLEAR["backlash"] * scale_of("backlash")
    severity[3, OUTPUTS.index("short_b")] = 0.04
    severity[4, OUTPUTS.index("eccentricity")] = 0.01
    severity[4, OUTPUTS.index("motor_friction")] = 0.6
    assert [KINDS_FOUND[k] for k in kind_found(severity)] == list(KINDS_FOUND)
    severity[1, OUTPUTS.index("motor_friction")] = 0.0
    assert KINDS_FOUND[kind_found(severity)[1]] == "slight"


def severity_of(u: np.ndarray, names: list[str], **more: list[float]) -> np.ndarray:
    """Return what a network says that always says 0.5, at all inputs `u`, shape (n, inputs)."""
    part = SeverityPart(
        inputs=names[:2], network=NetworkPart.of(constant(0.5, 2, 1)),
        scale=NetworkPart.of(constant(np.log(0.1), 2, 1)), unit=0.01, knots=[0.0, 1.0],
        factors=[1.0, 3.0], company=1.5, upper=0.2, least=0.0, **more,
    )
    filters = LineFilter(weight=np.empty((0, 6)), deviation=np.ones(6), template=np.ones(2),
                         winding=np.ones(2), precision=np.eye(2), floor=np.ones((2, 0)),
                         by_noise=np.ones((2, 0)), share=0.0)
    size = len(input_names(names))
    inputs = Inputs(names, filters, None, np.zeros(size), np.ones(size))
    rows = np.zeros((len(u), size))
    rows[:, :u.shape[1]] = u
    return SeverityNetwork(part, inputs)(rows)


def test_interval_is_wider_beside_another_fault() -> None:
    """The half width is factor times expected error, at what the network says."""
    alone, beside = severity_of(np.zeros((1, 2)), ["noise_speed", "torque_full"])[0]
    assert alone == pytest.approx(0.01 * np.sinh([0.5, 0.3, 0.7]))
    assert beside == pytest.approx(0.01 * np.sinh([0.5, 0.2, 0.8]))


def test_interval_stays_between_none_and_twice_what_was_trained_on() -> None:
    beyond = severity_of(np.zeros((1, 2)), ["noise_speed", "torque_full"],
                         noise_factors=[90.0, 90.0], noise_knots=[0.0, 1.0])[0, 0]
    assert beyond == pytest.approx([0.01 * np.sinh(0.5), 0.0, 0.4])


@pytest.mark.parametrize("own", [False, True])
def test_interval_grows_with_the_noise_of_the_record(own: bool) -> None:
    """The noise is that of the record itself, with a baseline too; none beyond the knots."""
    names = ["torque_full", "noise_speed", *(["absolute_noise_speed"] if own else [])]
    u = np.zeros((4, len(names)))
    u[:, -1] = [-9.0, -1.0, 0.0, 1.0]
    found = severity_of(u, names, noise_knots=[-1.0, 1.0], noise_factors=[0.5, 1.5])[:, 0]
    half = np.arcsinh(found[:, 2] / 0.01) - 0.5
    assert half == pytest.approx([0.1, 0.1, 0.2, 0.3])


def test_probability_of_a_known_kind_falls_with_the_tail() -> None:
    assert tail_probability(TAIL[[0, 3, 7]], TAIL) == pytest.approx(
        [TAIL_RATES[k] for k in (0, 3, 7)])
    assert tail_probability(np.array([1.5]), TAIL)[0] < TAIL_RATES[-1]
    # The bound is even odds where the tail tells nothing, p = 1/e and above.
    usual = 1.0 / (1.0 + STRANGERS)
    assert probability_known(np.array([1.0, np.exp(-1.0)])) == pytest.approx([usual, usual])
    found = probability_known(np.array([0.3, 0.05, 0.01, 0.001]))
    assert (np.diff(found) < 0.0).all()
    b = -np.e * 0.01 * np.log(0.01)
    assert found[2] == pytest.approx(b / (b + STRANGERS))


def test_squeeze_bounds_a_single_feature() -> None:
    assert squeeze(np.array([100.0]))[0] == pytest.approx(SQUEEZE)
    assert squeeze(np.array([0.01]))[0] == pytest.approx(0.01, rel=1e-4)


def test_logit_is_bounded() -> None:
    assert np.isfinite(logit(np.array([0.0, 1.0]))).all()
    assert logit(np.array([0.5]))[0] == 0.0


def test_what_the_limits_let_pass_is_no_certain_stranger() -> None:
    """A limit far beyond the scores that were seen: within it their trend is not followed."""
    limits = Limits(np.ones(1), np.eye(1), 1.0, 0.3 * TAIL)
    within, beyond = limits.known(np.array([[0.95], [1.05]]))
    assert within == pytest.approx(LEAST_KNOWN) and within > 0.45
    assert beyond < 0.1
