"""A unit whose features are linear in tolerances and effects: the decision without a simulator."""

from types import SimpleNamespace

import numpy as np

from ema_identification.actuator.measure.tolerances import N_TOLERANCES, RecordConditions
from ema_identification.actuator.surrogate.catalogue import variants
from ema_identification.actuator.surrogate.evidence import RecordEvidence, evidence
from ema_identification.actuator.surrogate.fit import EffectTerm
from ema_identification.actuator.surrogate.library import Library, NullLibrary, Scale, design
from ema_identification.actuator.surrogate.library_runs import unpack
from ema_sim.model_file import load_model_file

FEATURES = 150
UNITS = {
    ("viscous_friction", "coefficient"): 2e-4, ("backlash", "increase"): 1e-3,
    ("load_dependent_friction", "coefficient"): 0.1, ("position_sensor_offset", "offset"): 5e-3,
    ("inverter_voltage_drop", "drop"): 1.5,
}
"""Sizes at which each feature is off by three standard deviations, rms."""
VARIANTS = tuple(v for v in variants() if v.effect in {name for name, _ in UNITS})
MODEL = load_model_file()
_rng = np.random.default_rng(7)
BASE = _rng.normal(size=FEATURES)
SLOPES = _rng.normal(scale=2.0, size=(FEATURES, N_TOLERANCES))
ADDED = {key: _rng.normal(scale=3.0, size=FEATURES) for key in UNITS}
STRANGE = _rng.normal(scale=3.0, size=FEATURES)
"""What no effect adds."""


def features_of(z, effects):
    """Return the features without noise."""
    added = sum(getattr(getattr(effects, e), f) / unit * ADDED[e, f]
                for (e, f), unit in UNITS.items())
    return BASE + SLOPES @ z + added


class LinearRunner:
    """Makes runs: features with noise of one standard deviation."""

    def run(self, _model, cases, _fmap):
        return np.array([
            features_of(c.z, MODEL.effects if c.effects is None else c.effects)
            + np.random.default_rng(c.seed).normal(size=FEATURES) for c in cases])


def term(name, u):
    variant = next(v for v in VARIANTS if v.name == name)
    (signature,) = (s for s in library().signatures if s.variant.name == name)
    return EffectTerm(variant=variant, signature=signature, u=np.array([u]))


def library():
    weights = np.zeros((design(np.zeros((1, N_TOLERANCES + 3))).shape[1], FEATURES))
    weights[0], weights[1:N_TOLERANCES + 1] = BASE, SLOPES.T
    rows = [features_of(np.zeros(N_TOLERANCES), v.effects(np.array([x]), MODEL.effects)) - BASE
            for v in VARIANTS for x in v.levels[0]]
    one = np.ones(FEATURES)
    return Library(
        model=MODEL, example=None, signatures=unpack(VARIANTS, np.array(rows)),
        null=NullLibrary(weights=weights, quiet=one, noisy=0.0 * one, correlation=np.eye(FEATURES),
                         misfit=0.0 * one),
        fmap=SimpleNamespace(
            plan=SimpleNamespace(segments=(), transitions=()), rate=20_000.0, profile=None,
            features=[SimpleNamespace(name=f"f{k}", place="record", signal="s", against="a")
                      for k in range(FEATURES)]),
        scale=Scale(factor=one, fit=(0.0, 0.1), gain=(5.0, 2.0)))


def unit(*, seed=1, strange=0.0, z=None, **sizes):
    """Return the evidence of a unit with effects, in units of `UNITS`."""
    rng = np.random.default_rng([seed, 99])
    if z is None:
        z = rng.uniform(-0.8, 0.8, N_TOLERANCES)
    effects = MODEL.effects
    for (name, field), size in UNITS.items():
        if name in sizes:
            values = getattr(effects, name)._replace(**{field: size * sizes[name]})
            effects = effects._replace(**{name: values})
    values = features_of(z, effects) + rng.normal(size=FEATURES) + strange * STRANGE
    record = SimpleNamespace(profile=SimpleNamespace(points=()))
    return evidence([RecordEvidence(
        record=record, library=library(), values=values,
        conditions=RecordConditions(measured=frozenset({"temperature", "bus"})))], LinearRunner())
