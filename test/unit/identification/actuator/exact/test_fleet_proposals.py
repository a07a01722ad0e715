"""What is proposed and how far steps go, against least squares of which the answer is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fleet_unit import (
    ADDED,
    BASE,
    CONDITIONS,
    FEATURES,
    MODEL,
    SIZE,
    SLOPES,
    UNITS,
    features_of,
    plain_library,
)
from scipy.optimize import lsq_linear

from ema_identification.actuator.decision import fit, proposals
from ema_identification.actuator.decision.proposals import (
    LawProposal,
    alternating,
    linear_gains,
    ripple_power,
    sized,
)
from ema_identification.actuator.decision.slopes import (
    bounded_least_squares,
    law_slopes,
    simulated_slopes,
)
from ema_identification.actuator.laws.catalogue import Signature, ripple
from ema_identification.actuator.laws.terms import EffectTerm, LawFit

LAW = "viscous_friction", "coefficient"
(SIGNATURE,) = (s for s in plain_library().signatures if s.variant.name == LAW[0])
TWO = ripple("cogging_torque", 12, 1e-3, 4e-3)
WAVES = np.random.default_rng(41).normal(scale=3e3, size=(2, FEATURES))
LEVELS = np.sort(np.append(TWO.levels[0], 0.0))
VECTOR = Signature(variant=TWO, levels=(LEVELS,) * 2, values=tuple(
    np.outer(LEVELS, row) + (np.abs(LEVELS) > 2e-3)[:, None] * row[::-1] * 4e-3 for row in WAVES))
"""It bends: its large sizes are not four times the small ones."""
SURE = 300.0
"""How surely the units are known: so that it counts beside what a record tells."""


def least(columns, target, free=None):
    """Return what is left at least, with numbers about 0 as surely as those of a unit."""
    free = np.ones(SIZE, dtype=bool) if free is None else free
    prior = np.sqrt(SURE) * np.eye(SIZE)[:, free]
    stacked = np.vstack([np.hstack([SLOPES[:, free], columns]), np.hstack(
        [prior, np.zeros((SIZE, columns.shape[1]))])])
    whole = np.append(target, np.zeros(SIZE))
    x = np.linalg.lstsq(stacked, whole, rcond=None)[0]
    return float(((whole - stacked @ x) ** 2).sum()), x


def unit_of(z, added, **more):
    """Return a unit that is off so little that all of it counts in full; features about 0."""
    library = plain_library()
    values = BASE + SLOPES @ z + added + 0.2 * np.random.default_rng(42).normal(size=FEATURES)
    return fit.TestedUnit(library=library, values=values, conditions=CONDITIONS,
                          centre=np.zeros(SIZE), weight=np.full(SIZE, SURE), **more)


def at_ends(unit, few):
    """Return a fit of no law of which the first few numbers are at the end of their bands."""
    none = unit.without_law()
    z = np.where(np.arange(SIZE) < few, 1.0, none.z)
    mean = BASE + SLOPES @ z
    return replace(none, z=z, mean=mean, cost=float(
        ((unit.values - mean) ** 2).sum() + SURE * z @ z))


@pytest.mark.parametrize(("signature", "size"), [
    (SIGNATURE, 0.9), (SIGNATURE, 1.5), (VECTOR, 0.4)], ids=["between", "beyond", "vector"])
@pytest.mark.parametrize("few", [0, 9])
def test_a_gain_is_what_least_squares_gain_where_all_else_gives_way(signature, size, few):
    """What is at the end of its band does not."""
    columns = np.column_stack([ADDED[LAW] / UNITS[LAW]] if signature is SIGNATURE else WAVES)
    u = size * (SIGNATURE.levels[0][-1:] if signature is SIGNATURE else np.array([6e-4, -8e-4]))
    z = 0.3 * np.random.default_rng(43).uniform(-1.0, 1.0, SIZE)
    unit = unit_of(z, columns @ u)
    white, free = replace(unit.whitener(0), straight=True), np.arange(SIZE) >= few
    none = at_ends(unit, few)
    target = unit.values - BASE - SLOPES[:, ~free].sum(axis=1)
    (left, _), (better, x) = (least(c, target, free) for c in (columns[:, :0], columns))
    (found,) = linear_gains(unit, none, white, [signature])
    assert none.cost - found.cost == pytest.approx(left - better, rel=1e-3)
    assert found.u == pytest.approx(x[free.sum():], rel=1e-3)


def test_a_law_gains_at_most_at_twice_the_size_that_the_library_knows():
    most = SIGNATURE.levels[0][-1]
    column = ADDED[LAW] / UNITS[LAW]
    unit = unit_of(np.zeros(SIZE), 3.0 * most * column)
    none, white = at_ends(unit, 0), replace(unit.whitener(0), straight=True)
    (found,) = linear_gains(unit, none, white, [SIGNATURE])
    nothing = np.zeros((FEATURES, 0))
    left, better = (least(nothing, unit.values - BASE - x * column)[0] for x in (0.0, 2.0 * most))
    assert found.u == pytest.approx([2.0 * most])
    assert none.cost - found.cost == pytest.approx(left - better, rel=0.05)


def test_a_law_is_found_at_the_size_and_in_the_direction_that_it_has():
    """Of a law that is no multiple of a small one, of a vector between its axes."""
    values = SIGNATURE.values[0] * (1.0 + np.arange(len(SIGNATURE.levels[0])))[:, None]
    values[2] = -3.0 * values[2][::-1]
    bent = Signature(variant=SIGNATURE.variant, levels=SIGNATURE.levels, values=(values,))
    z = 0.5 * np.random.default_rng(44).uniform(-1.0, 1.0, SIZE)
    for signature, u in ((bent, SIGNATURE.levels[0][2:3]),
                         (bent, 0.5 * (SIGNATURE.levels[0][3:4] + SIGNATURE.levels[0][4:5])),
                         (VECTOR, 4e-3 * np.array([-1.0, 1.0]) / np.sqrt(2.0))):
        unit = unit_of(z, signature.at(u))
        best, other = sized(unit, [bent, VECTOR])
        assert best.signature is signature and best.cost < other.cost
        assert best.u == pytest.approx(u)
        exact, x = least(np.zeros((FEATURES, 0)), unit.values - signature.at(u) - BASE)
        assert best.cost == pytest.approx(exact, rel=0.05)
        assert best.z == pytest.approx(x, abs=0.01)
    near = replace(unit, edge=0.1)
    assert np.abs(sized(near, [VECTOR])[0].z).max() == 0.1
    assert sized(unit, []) == []


def test_lists_take_turns_and_an_effect_has_two_variants_at_most():
    def of(name, effect, size=1.0):
        return LawProposal(SimpleNamespace(variant=SimpleNamespace(name=name, effect=effect)),
                           np.array([size]), np.zeros(0), 0.0)

    one = [of("a1", "a"), of("b1", "b"), of("a2", "a"), of("a3", "a"), of("e", "e")]
    other = [of("c", "c", 0.0), of("a1", "a"), of("d", "d")]
    named = [p.signature.variant.name for p in alternating([one, other], 9)]
    assert named == ["a1", "b1", "a2", "d", "e"]
    assert [p.signature.variant.name for p in alternating([one, other], 3)] == named[:3]
    assert alternating([], 3) == []


def test_ripple_is_by_periods_of_the_rotor_whichever_turn_a_line_is_of():
    """Three pole pairs; lines of 1 and 2 are the windings'; ten deviations count at most."""
    motor = MODEL.actuator.motor._replace(pole_pairs=3)
    model = MODEL._replace(actuator=MODEL.actuator._replace(motor=motor))
    names = ("slew.torque_line_4_up", "slew.turn_torque_line_12_up", "slew.torque_line_2_up",
             "slew.turn_torque_line_3_up", "slew.mean_torque", "slew.current_line_6_up")
    one = SimpleNamespace(library=SimpleNamespace(model=model, fmap=SimpleNamespace(
        features=[SimpleNamespace(name=name) for name in names])))
    found = ripple_power(one, np.array([3.0, -4.0, 50.0, -50.0, 50.0, 50.0]))
    assert found == {12: 12.5, 3: 100.0}


@pytest.mark.parametrize(("in_record", "counts"), [(0.0, 0.0), (4.0, 16.0), (50.0, 49.0)])
def test_lines_that_ring_in_the_runs_alone_are_no_score(in_record, counts):
    """Of a record that has them the lesser counts, of its ten deviations at most."""
    names = [f"slew.turn_torque_line_12_{k}" for k in range(16)]
    library = plain_library()
    features = [*(SimpleNamespace(name=name) for name in names), *library.fmap.features[16:]]
    library = replace(library, fmap=replace(library.fmap, features=tuple(features)))
    rings = np.where(np.arange(FEATURES) < 16, 1.0, 0.0)
    unit = fit.TestedUnit(library=library, values=BASE + in_record * rings, conditions=CONDITIONS)
    none = replace(unit.without_law(), z=np.zeros(SIZE), runs=8)
    runs_off = 7.0 * np.sqrt(unit.covariance(8)[0, 0])
    none = replace(none, mean=unit.values - runs_off * rings)
    assert proposals.scores_of(unit, none, []).ripple == pytest.approx(counts)
    assert proposals.scores_of(unit, replace(none, mean=unit.values), []).ripple == 0.0


@pytest.mark.parametrize("effect", ["cogging_torque", "gear_mesh_ripple"])
def test_ripple_is_looked_for_where_the_lines_are_off_on_runs_and_on_the_library(effect):
    """Twelve a turn here; lines of 24 ring in the runs only. Found as it is, by runs of it."""
    names = [f"slew.turn_torque_line_{12 * (1 + k % 2)}_{k}" for k in range(16)]
    library = plain_library()
    features = [*(SimpleNamespace(name=name) for name in names), *library.fmap.features[16:]]
    library = replace(library, fmap=replace(library.fmap, features=tuple(features)))
    waves = np.zeros((2, FEATURES))
    waves[:, :16:2] = np.random.default_rng(46).normal(size=(2, 8))
    a = MODEL.actuator
    unit_size = proposals.COGGING * (
        a.motor.dynamic_friction if effect == "cogging_torque"
        else 0.5 * a.surface.dynamic_friction / a.shaft.stiffness)

    def simulator(_model, _spread, _fmap, z, _conditions, _seed, effects):
        of = getattr(effects, effect)
        size = of.amplitude * (of.periods == 12) / unit_size
        return BASE + SLOPES @ z + size * np.array([np.cos(of.phase), np.sin(of.phase)]) @ waves

    u = np.array([1.5, -2.0])
    unit = fit.TestedUnit(library=library, values=BASE + u @ waves, conditions=CONDITIONS,
                          simulator=simulator, centre=np.zeros(SIZE), weight=np.full(SIZE, 1e9))
    rings = np.where(np.arange(FEATURES) < 16, np.arange(FEATURES) % 2, 0)
    none = replace(unit.without_law(), z=np.zeros(SIZE), mean=BASE - 9.0 * rings)
    white = replace(unit.whitener(8), straight=True)
    found = {p.signature.variant.effect: p for p in proposals.ripples(unit, none, white, ())}
    assert set(found) == {"cogging_torque", "gear_mesh_ripple"}
    assert unit.run((found[effect].term,), none.z, 1) == pytest.approx(unit.values, abs=1e-3)
    assert np.linalg.norm(found[effect].u) == pytest.approx(2.5 * unit_size, rel=1e-3)
    assert found[effect].signature.variant.name.endswith("12 a turn")
    assert not proposals.ripples(unit, none, white, tuple(found))


def test_a_gain_counts_in_what_is_left_a_feature():
    assert proposals.gain_of(150.0, 100.0, 50) == pytest.approx(25.0)


@pytest.mark.parametrize("seed", range(4))
def test_a_step_is_that_of_bounded_least_squares(seed):
    """Columns of any scale, one that does nothing, bounds that hold some of them."""
    rng = np.random.default_rng([seed, 45])
    columns = rng.normal(size=(40, 7)) * 10.0 ** rng.uniform(-3.0, 3.0, 7)
    columns[:, 3] = 0.0
    target, scale = rng.normal(size=40), 1.0 / np.maximum(np.linalg.norm(columns, axis=0), 1.0)
    weight = np.where(np.arange(7) < 2, 0.0, rng.uniform(0.5, 2.0, 7))
    centre = rng.normal(size=7) * scale
    whole = np.vstack([columns, np.diag(np.sqrt(weight))]) * scale
    pulled = np.append(target, -np.sqrt(weight) * centre)
    half = 0.5 * np.linalg.lstsq(whole, pulled, rcond=None)[0]
    low, high = (side * np.where(side * half > (0.0 if side == (-1) ** seed else np.inf),
                                 side * half, 100.0) * scale for side in (-1, 1))
    found = bounded_least_squares(columns, target, low, high, weight, centre)
    exact = lsq_linear(whole, pulled, bounds=(low / scale, high / scale), tol=1e-14).x
    assert (np.isclose(exact, high / scale) | np.isclose(exact, low / scale)).any()
    assert found / scale == pytest.approx(exact, abs=1e-4)
    far = 1e9 * np.ones(7)
    damped = bounded_least_squares(columns, target, -far, far, weight, centre, 0.5)
    normal = columns.T @ columns + np.diag(weight)
    pull = columns.T @ target - weight * centre
    assert (normal + 0.5 * np.diag(np.diag(normal))) @ damped == pytest.approx(
        pull, rel=1e-6, abs=1e-6)


def test_slopes_are_simulated_within_the_bands_and_kept_where_nothing_can_be_run():
    def simulator(_model, _spread, _fmap, z, _conditions, _seed, _effects):
        return SLOPES @ z if np.abs(z).max() <= 1.0 and z[5] <= 0.45 else np.full(
            FEATURES, np.nan)

    z = np.where(np.arange(SIZE) % 2, -0.9, 0.8) * (np.arange(SIZE) != 5)
    unit = fit.TestedUnit(library=plain_library(), values=np.zeros(FEATURES), simulator=simulator,
                          conditions=CONDITIONS)
    model = LawFit(terms=(), z=z, mean=SLOPES @ z, slopes=np.full((FEATURES, SIZE), 7.0),
                   cost=1.0, runs=1)
    found = simulated_slopes(unit.run_all, model, 1)
    other = np.arange(SIZE) != 5
    assert found[:, other] == pytest.approx(SLOPES[:, other], abs=1e-9)
    assert (found[:, 5] == 7.0).all()
    assert (model.slopes == 7.0).all()


def test_the_slope_of_a_law_at_the_end_of_what_it_may_be_leads_back():
    most = 2.0 * UNITS[LAW]
    variant = replace(SIGNATURE.variant, high=(most,))
    unit = fit.TestedUnit(
        library=plain_library(), values=np.zeros(FEATURES), conditions=CONDITIONS,
        simulator=lambda *given: features_of(given[3], given[6]))
    term = EffectTerm(variant=variant, signature=SIGNATURE, u=np.array([most]))
    model = LawFit(terms=(term,), z=np.zeros(SIZE), mean=BASE + 2.0 * ADDED[LAW], cost=1.0,
                   runs=1, slopes=np.zeros((FEATURES, 1 + SIZE)))
    found = law_slopes(unit.run_all, model, model.mean, unit.whitener(0), 1)
    assert found[:, 0] * UNITS[LAW] == pytest.approx(ADDED[LAW])
