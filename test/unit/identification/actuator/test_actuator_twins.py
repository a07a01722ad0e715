"""A short and an eccentricity along its phase: a fit of one gives the start of the other."""

from types import SimpleNamespace

import numpy as np
import pytest

from ema_identification.actuator.measure.tolerances import (
    N_TOLERANCES,
    RecordConditions,
    Tolerances,
    realise,
)
from ema_identification.actuator.naming.next_test import phase_constants
from ema_identification.actuator.naming.proposal import ECCENTRIC, twins
from ema_identification.actuator.surrogate.catalogue import variants
from ema_sim.model_file import load_model_file

MODEL = load_model_file()
VARIANTS = variants()


def evidence():
    library = SimpleNamespace(
        model=MODEL, signatures=[SimpleNamespace(variant=v) for v in VARIANTS])
    return SimpleNamespace(tolerances=Tolerances(1), blocks=[SimpleNamespace(
        library=library, conditions=RecordConditions())])


def fit_of(name, *u, seed=0):
    variant = next(v for v in VARIANTS if v.name == name)
    z = np.random.default_rng(seed).uniform(-0.3, 0.3, N_TOLERANCES)
    return SimpleNamespace(
        terms=(SimpleNamespace(variant=variant),), z=z,
        effects=lambda base: variant.effects(np.array(u), base))


def constants(z, effects):
    """Return the back-EMF constants of the phases of a unit (V s/rad)."""
    actuator, effects = realise(MODEL, z, RecordConditions(), effects)
    motor = actuator.motor
    deviations = [motor.back_emf_deviation_a, motor.back_emf_deviation_b,
                  motor.back_emf_deviation_c]
    return motor.back_emf_constant * (1.0 + np.array(deviations)) * phase_constants(effects)


def effects_of(start):
    (term,) = start.terms
    return term.variant.effects(term.u, MODEL.effects)


@pytest.mark.parametrize("phase", "abc")
@pytest.mark.parametrize("mode", ["paper", "physical"])
def test_the_eccentricity_of_a_short_has_its_constants(phase, mode):
    fit = fit_of(f"turn_short {phase} {mode}", 0.04)
    (start,) = twins(evidence(), fit)
    assert start.terms[0].variant.name == ECCENTRIC
    assert constants(start.z, effects_of(start)) == pytest.approx(
        constants(fit.z, fit.effects(MODEL.effects)), rel=1e-4)


def test_the_shorts_of_an_eccentricity_near_a_phase_have_its_constants():
    fit = fit_of(ECCENTRIC, -0.03, 0.001)
    starts = twins(evidence(), fit)
    assert {s.terms[0].variant.name for s in starts} == {
        "turn_short a paper", "turn_short a physical"}
    for start in starts:
        assert constants(start.z, effects_of(start)) == pytest.approx(
            constants(fit.z, fit.effects(MODEL.effects)), rel=1e-4)


def test_no_other_effect_has_one_and_a_hidden_effect_is_none():
    assert twins(evidence(), fit_of("torque_constant_drop", 0.1)) == []
    assert twins(evidence(), fit_of("turn_short b paper", 0.04),
                 without=["rotor_eccentricity"]) == []
