"""Several records of one unit as one: each is what it is by itself, between them is nothing."""

from dataclasses import replace

import numpy as np
import pytest
from fleet_unit import CONDITIONS, FEATURES, SIZE, plain_library, run

from ema_identification.actuator.decision import fit
from ema_identification.actuator.decision.joint import DAYS, joint_unit


def records():
    """Return two records of tests whose noise and known laws are not alike."""
    quiet = plain_library()
    loud = replace(quiet, carried=0.5, repeat=quiet.repeat.scaled(2.0),
                   surrogate=quiet.surrogate.scaled(7.0), signatures=quiet.signatures[1:])
    return [fit.TestedUnit(library=library, values=np.zeros(FEATURES), conditions=CONDITIONS,
                           simulator=run, seed=seed)
            for seed, library in enumerate((quiet, loud))]


@pytest.mark.parametrize(("of", "variances"), [
    (lambda u: u.noise(), (1.0, 2.0)), (lambda u: u.covariance(0), (1.0, 7.0)),
    (lambda u: u.covariance(4), (1.25, 2.5 + 0.25 * 7.0))], ids=["run", "quadratic", "runs"])
def test_noise_of_one_record_is_nothing_to_another(of, variances):
    found = of(joint_unit(records()))
    assert found == pytest.approx(np.diag(np.repeat(variances, FEATURES)))


def test_runs_are_those_of_each_record_with_noise_of_their_own():
    one, other = records()
    both = joint_unit([one, other])
    z = np.random.default_rng(51).uniform(-1.0, 1.0, SIZE + DAYS)
    found = [both.run((), z, 2, salt) for salt in (3, 4)]
    for mean, salt in zip(found, (3, 4)):
        assert mean[:FEATURES] == pytest.approx(one.run((), z[both.places[0]], 2, salt))
        assert mean[FEATURES:] == pytest.approx(other.run((), z[both.places[1]], 2, salt))
    assert np.abs(found[0] - found[1]).min() > 0.0  # fresh noise


def test_a_law_is_a_candidate_where_every_test_knows_it():
    one, other = records()
    known = [s.variant.name for s in joint_unit([one, other]).library.signatures]
    assert known == [s.variant.name for s in other.library.signatures]
    assert len(known) == len(one.library.signatures) - 1
