"""A quick run of the fuzzing benchmark: only our own errors, no hang."""

import pytest

from benchmarks.reliability.fuzz import all_targets, fuzz
from ema_record.errors import UsageError
from ema_sim.effects import parse_effects


@pytest.fixture(scope="module")
def targets(tmp_path_factory):
    return all_targets(tmp_path_factory.mktemp("fuzz"))


def test_only_our_own_errors(targets):
    assert len(targets) == 14
    for target in targets:
        result = fuzz(target, 40, 1)
        assert result["inputs"] >= 20
        assert result["failures"] == [] and result["uncaught"] == result["hangs"] == 0


@pytest.mark.parametrize("value", ["9" * 4000, "1e400", "nan", "-inf"])
def test_numbers_without_a_float(value):
    with pytest.raises(UsageError):
        parse_effects([f"turn_short.fraction={value}"])
