"""Whether each of two effects is needed: its size, and the band of its tolerance."""

from types import SimpleNamespace

import numpy as np
import pytest

from ema_identification.actuator.measure.tolerances import (
    TOLERANCES,
    RecordConditions,
    Tolerances,
    realise,
)
from ema_identification.actuator.naming.criteria import CLEARLY_THERE, Case, absorbed, needed
from ema_identification.actuator.naming.estimates import QUANTILE, covariance_of
from ema_identification.actuator.surrogate.catalogue import variants
from ema_identification.actuator.surrogate.fit import EffectTerm, Fit
from ema_sim.model_file import load_model_file

BY_NAME = {v.name: v for v in variants()}
ONE = SimpleNamespace(blocks=(None,), tolerances=Tolerances(1))


def term(name, *u):
    levels = tuple(np.array([*row, 0.0]) for row in BY_NAME[name].levels)
    return EffectTerm(variant=BY_NAME[name], signature=SimpleNamespace(levels=levels),
                      u=np.array(u))


def fit(terms, cost=100.0, deviation=0.05):
    n = sum(len(t.u) for t in terms)
    return Fit(terms=tuple(terms), z=np.zeros(18), covariance=deviation**2 * np.eye(n + 18),
               cost=cost, mean=(np.zeros(4),), runs=10, slopes=np.zeros((4, n + 18)))


@pytest.mark.parametrize(("name", "part", "field", "factor"), [
    ("surface_friction", "surface", "dynamic_friction", 1.02),
    ("motor_friction", "motor", "dynamic_friction", 1.02),
    ("torque_constant_drop", "motor", "back_emf_constant", 0.98),
    ("shaft_compliance", "shaft", "stiffness", 1.0 / 1.02),
    ("inertia_change motor", "motor", "inertia", 1.02),
    ("inertia_change surface", "surface", "inertia", 1.02),
])
def test_a_deviation_within_its_band_is_a_tolerance_of_the_same_number(name, part, field, factor):
    model, z = load_model_file(), np.zeros(18)
    found = absorbed(ONE, term(name, 0.02), z)
    assert found is not None
    plain, _ = realise(model, z, RecordConditions())
    instead, _ = realise(model, found, RecordConditions())
    assert getattr(getattr(instead, part), field) == pytest.approx(
        factor * getattr(getattr(plain, part), field))


def test_a_deviation_beyond_its_band_is_no_tolerance():
    z = np.zeros(18)
    assert absorbed(ONE, term("surface_friction", 0.3), z) is None
    assert absorbed(ONE, term("torque_constant_drop", 0.05), z) is None
    assert absorbed(ONE, term("surface_load", 10.0, 0.0), z) is not None
    assert absorbed(ONE, term("surface_load", 10.0, 80.0), z) is None
    assert absorbed(ONE, term("backlash", 1e-4), z) is None  # no tolerance is like it


def test_effect_and_tolerance_count_together():
    z = np.zeros(18)
    z[[t.name for t in TOLERANCES].index("surface.dry_friction")] = 0.9
    assert absorbed(ONE, term("surface_friction", 0.05), z) is None
    assert absorbed(ONE, term("surface_friction", -0.15), z) is not None


def test_an_effect_that_is_hardly_there_is_not_needed():
    assert needed(fit([term("backlash", 1.0), term("viscous_friction", 1.0)], 4.0), 4.0)
    assert not needed(fit([term("backlash", 1.0), term("viscous_friction", 0.06)], 4.0), 4.0)


def test_an_effect_within_its_error_of_none_is_not_needed():
    for size in (0.1, 0.3, 1.0):
        found = fit([term("backlash", 1.0), term("viscous_friction", size)], 4.0)
        covariance = covariance_of(found, 1, found.cost)
        above = size > CLEARLY_THERE * float(np.sqrt(covariance[0, 0]))
        assert needed(found, found.cost) == above


def test_an_effect_on_the_number_of_a_tolerance_has_the_width_of_that_in_its_error():
    wide = fit([term("backlash", 1.0), term("surface_friction", 1.0)], 4.0)
    error = float(np.sqrt(covariance_of(wide, 1, wide.cost)[0, 0]))
    for size in (1.2 * QUANTILE * error, 0.8 * QUANTILE * error):
        found = fit([term("backlash", 1.0), term("surface_friction", size)], 4.0)
        least = QUANTILE * float(np.sqrt(covariance_of(found, 1, found.cost)[0, 0]))
        assert needed(found, found.cost) == (size > least)


@pytest.mark.parametrize(("alone", "both"), [(150.0, False), (250.0, True)])
def test_what_either_effect_alone_leaves_shows_both_where_the_errors_do_not(alone, both):
    arena = SimpleNamespace(evidence=SimpleNamespace(blocks=ONE.blocks, tolerances=ONE.tolerances,
                                                     size=100, usual=100.0), null_cost=900.0)
    first, second = term("backlash", 1e-3), term("viscous_friction", 1e-4)
    pair = fit([first, second], 100.0, deviation=1.0)
    assert not needed(pair, 100.0)
    singles = [fit([first], alone), fit([second], 400.0)]
    assert Case(arena, None, 60.0, 1e-4, ()).distinct(pair, singles) == both
