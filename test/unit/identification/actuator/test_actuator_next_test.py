"""The next test: machines that no command tells apart, and tests that tell the others."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fleet_unit import unit

from ema_identification.actuator import next_test
from ema_identification.actuator.decision.decide import decide
from ema_identification.actuator.next_test import (
    inseparable,
    phase_constants,
    separating_test,
    separation_of,
    separations_needed,
)
from ema_record.profile import load_profile
from ema_record.spread import load_spread
from ema_sim.effects import parse_effects
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate


def eccentric(zeta, angle):
    return parse_effects([f"rotor_eccentricity.zeta={zeta}", "rotor_eccentricity.mode=static",
                          f"rotor_eccentricity.angle={angle}"])


def shorted(fraction, phase="b", mode="physical"):
    return parse_effects([f"turn_short.fraction={fraction}", f"turn_short.phase={phase}",
                          f"turn_short.mode={mode}"])


def of(short, bent):
    return {"turn_short": short, "rotor_eccentricity": bent}


def test_a_short_of_constants_and_an_eccentricity_along_its_phase_are_one_machine():
    zeta = 0.04
    fraction = 1.5 * zeta / (1.0 + 0.5 * zeta)
    short, bent = shorted(fraction, "a", "paper"), eccentric(-zeta, 0.0)
    ratio = phase_constants(bent) / phase_constants(short)
    assert ratio == pytest.approx(np.full(3, 1.0 + 0.5 * zeta), rel=1e-12)
    actuator = load_model_file().actuator
    larger = actuator._replace(motor=actuator.motor._replace(
        back_emf_constant=actuator.motor.back_emf_constant * (1.0 + 0.5 * zeta)))
    one = simulate(load_profile("step"), actuator=larger, effects=short, seed=3)
    other = simulate(load_profile("step"), actuator=actuator, effects=bent, seed=3)
    early = one.time < 0.05  # rounding grows in the limit cycle after it
    assert np.abs(one.samples[early] - other.samples[early]).max() < 1e-6
    assert "phase a" in inseparable(of(short, bent))


@pytest.mark.parametrize(("zeta", "off", "one"), [
    (-0.03, 0.0, True), (-0.03, 0.05, True), (-0.03, 0.3, False), (0.03, 0.0, False)])
def test_a_test_is_proposed_where_the_axis_is_not_that_of_the_phase(zeta, off, one):
    fraction = 1.5 * abs(zeta) / (1.0 + 0.5 * abs(zeta))
    across = math.sqrt(3.0) * abs(zeta * math.sin(off))
    bent = eccentric(zeta, 2.0 * math.pi / 3.0 + off)
    assert bool(inseparable(of(shorted(fraction), bent))) is one
    if zeta < 0.0:
        assert one is (across < load_spread().tolerances.back_emf_phase)


def test_other_sets_are_left_to_the_prediction():
    friction = parse_effects(["motor_friction.increase=0.2"])
    assert inseparable({"turn_short": shorted(0.03), "motor_friction": friction}) == ""
    assert inseparable({**of(shorted(0.03), eccentric(-0.02, 2.1)),
                        "motor_friction": friction}) == ""


@pytest.mark.parametrize("common", [0.0, 1.0])
@pytest.mark.parametrize("apart", [0.0, 6.0, 30.0])
def test_how_far_two_samples_are_apart_is_told_by_rows_that_chose_no_direction(apart, common):
    """Of normal ones never more than Mahalanobis' distance, and half of it where that is large."""
    rng, d = np.random.default_rng(5), 160
    aside = np.r_[0.0, np.ones(5), np.zeros(d - 6)] / np.sqrt(5.0)

    def sample(shift):
        return shift * aside + rng.standard_normal((48, d)) + common * rng.standard_normal((48, 1))

    found = np.mean([separation_of(sample(0.0), sample(apart)) for _ in range(8)])
    most = apart * np.sqrt(aside @ np.linalg.solve(np.eye(d) + common**2, aside))
    assert 0.5 * most <= found <= 1.1 * most + 0.4


def test_what_differs_as_much_between_runs_of_one_candidate_sets_none_apart():
    """All features differ by one deviation, along what both candidates do anyway."""
    rng = np.random.default_rng(6)
    both = [shift + 5.0 * rng.standard_normal((48, 1)) + 0.1 * rng.standard_normal((48, 160))
            for shift in (0.0, 5.0)]
    assert separation_of(*both) < 1.5


def test_what_is_needed_to_leave_one_name_follows_from_the_evidence():
    """Costs of the other one are normal about d + s², 2 s wide: counted, not derived."""
    one = unit(seed=3)
    likely, sure = separations_needed(one)
    nu, d = one.library.freedom, one.size
    rng = np.random.default_rng(6)
    for s, share in ((likely, 0.5), (sure, 0.95)):
        more = s**2 + 2.0 * s * rng.standard_normal(20000)
        left = 0.5 * nu * more / d > np.log(19.0)
        assert left.mean() == pytest.approx(share, abs=0.02)


@pytest.mark.slow
def test_a_command_is_proposed_that_sets_the_candidates_apart(monkeypatch):
    """Linear units: every command shows the same, so the first one that was not run is enough."""
    example = SimpleMap()
    monkeypatch.setattr(next_test, "feature_map", lambda *_: example)
    monkeypatch.setattr(next_test, "simulate", lambda *_, **__: None)
    monkeypatch.setattr(next_test, "whole", lambda record, _: record)
    one = unit(seed=3, backlash=2.0)
    answer = decide(one)
    others = [f for f in answer.fits if len(f.terms) == 1 and f.names != answer.fit.names][:1]
    proposed = separating_test(one, [answer.fit, *others])
    assert proposed is not None
    assert proposed.separation > 2.0
    assert "it would set backlash and" in proposed.text
    blind = replace(answer.fit, slopes=np.zeros_like(answer.fit.slopes))  # may be anything
    less = separating_test(one, [blind, *others])
    assert less is None or 0.0 <= less.separation < proposed.separation


@pytest.mark.slow
@pytest.mark.parametrize(("share", "told"), [(0.25, True), (0.75, False)])
def test_runs_beside_what_can_be_simulated_do_not_count(monkeypatch, share, told):
    monkeypatch.setattr(next_test, "feature_map", lambda *_: SimpleMap())
    monkeypatch.setattr(next_test, "simulate", lambda *_, **__: None)
    monkeypatch.setattr(next_test, "whole", lambda record, _: record)
    one = unit(seed=3, backlash=2.0)
    answer = decide(one)
    others = [f for f in answer.fits if len(f.terms) == 1 and f.names != answer.fit.names][:1]

    def often_cannot(*arguments):
        found = simulator(*arguments)
        return np.full_like(found, np.nan) if arguments[5] % 100 < 100 * share else found

    simulator = one.simulator
    part = replace(one, simulator=often_cannot)
    assert (separating_test(part, [answer.fit, *others]) is not None) is told


class SimpleMap:
    """Stands for a map of features."""

    features = ()
