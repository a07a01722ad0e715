"""The synthetic panel of rigs: its truth, and the peers beside it."""

import numpy as np
import pytest

from benchmarks.rigs.kinds import MOTIONS, case_of, delayed
from benchmarks.rigs.peers import judged, stlsq
from benchmarks.rigs.wrong import SAYS, wrong_record
from support.rigs import RIGS


def test_half_have_nothing_beyond_coulomb_friction_and_the_seed_decides():
    cases = [case_of(k, 5) for k in range(32)]
    assert [bool(c.effect) for c in cases] == [True, False] * 16
    assert {c.kind for c in cases} == set(MOTIONS)
    for case in cases:
        assert (case.truth - {"coulomb_friction"} == {case.effect}) if case.effect else (
            case.truth <= {"coulomb_friction"})
    again = case_of(7, 5)
    assert np.array_equal(again.record.samples, cases[7].record.samples)
    assert not np.array_equal(case_of(7, 6).record.samples[:50], cases[7].record.samples[:50])


@pytest.mark.parametrize("kind", ["incommensurate sines", "several runs"])
def test_a_delay_is_of_the_whole_input_and_stays_in_its_run(kind):
    rig = RIGS["joint"]
    motion = MOTIONS[kind](rig, np.random.default_rng(1))
    total = np.sign(motion.speed) + motion.acceleration
    later, given = delayed(motion, total, 20 / rig.rate)
    place = np.searchsorted(motion.time, later.time)
    np.testing.assert_allclose(given, total[place + 20], atol=1e-9)
    runs = 4 if kind == "several runs" else 1
    assert len(total) - len(given) == 20 * runs


@pytest.mark.parametrize("kind", SAYS)
def test_a_wrong_record_differs_in_one_column_from_a_right_one(kind):
    record = wrong_record(kind, 3, 5)
    assert record.axis.motion == "rotary"
    assert np.isfinite(record.samples).all()
    if kind == "unsigned":
        assert record.input.min() >= 0.0
    if kind == "wrapped":
        assert np.abs(np.diff(record.channel("position"))).max() > 0.3 * np.ptp(
            record.channel("position"))


def test_sparse_regression_keeps_what_is_above_its_threshold():
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((4000, 5))
    target = columns @ [1.0, 0.0, 0.3, 0.04, 0.0]
    found = stlsq(columns, target, 0.1)
    assert list(np.nonzero(found)[0]) == [0, 2]
    np.testing.assert_allclose(found[[0, 2]], [1.0, 0.3], atol=0.02)


@pytest.mark.parametrize(("names", "truth", "one_way", "expected"), [
    (set(), set(), False, "right"),
    ({"spring"}, {"spring"}, False, "right"),
    ({"spring", "offset"}, {"spring"}, False, "wrong"),
    ({"coulomb_friction"}, {"coulomb_friction", "spring"}, False, "missed"),
    ({"offset"}, {"asymmetric_friction"}, False, "right"),
    ({"offset"}, {"coulomb_friction"}, False, "wrong"),
    ({"offset"}, {"coulomb_friction"}, True, "right"),
])
def test_peers_are_judged_as_we_are(names, truth, one_way, expected):
    assert judged(names, truth, one_way) == expected
