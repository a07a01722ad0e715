"""Runs in threads: the same bits, in the order asked for, and errors are not lost."""

import numpy as np
import pytest

from ema_identification.actuator.measure.features import feature_map
from ema_identification.actuator.measure.runs import Runner, UnitRun
from ema_identification.actuator.measure.tolerances import N_TOLERANCES, RecordConditions
from ema_record.profile import load_profile
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate


@pytest.fixture(scope="module")
def cases():
    model, profile = load_model_file(), load_profile("step")
    fmap = feature_map(profile, model.actuator, simulate(profile, actuator=model.actuator))
    return model, [UnitRun(z=np.full(N_TOLERANCES, 0.2 * k), conditions=RecordConditions(), seed=k)
                   for k in range(12)], fmap


@pytest.mark.parametrize("workers", [2, 5])
def test_runs_are_the_same_in_threads(cases, workers):
    here, shared = Runner().run(*cases), Runner(workers)
    assert np.isfinite(here).all()
    assert len(np.unique(here[:, 0])) > 1  # so that an order would be noticed
    for _ in range(5):
        assert np.array_equal(shared.run(*cases), here)


def test_a_run_out_of_the_domain_is_nan_and_the_others_are_made(cases):
    model, good, fmap = cases
    bad = UnitRun(z=np.full(N_TOLERANCES, np.nan), conditions=RecordConditions(), seed=0)
    found = Runner(2).run(model, [good[0], bad, good[1]], fmap)
    assert np.array_equal(np.isfinite(found).all(axis=1), [True, False, True])


def test_an_error_in_a_thread_reaches_the_caller(cases):
    model, good, fmap = cases
    short = UnitRun(z=np.zeros(2), conditions=RecordConditions(), seed=0)
    with pytest.raises(KeyError):
        Runner(2).run(model, [good[0], short, good[1]], fmap)
