"""Fuzzed input, a quick run: only our own errors, no hang."""

import pytest

from ema_record.errors import UsageError
from ema_sim.effects import parse_effects
from support.fuzz import MEMORY, all_targets, fuzz, in_fresh_process


@pytest.fixture(scope="module")
def targets(tmp_path_factory):
    return all_targets(tmp_path_factory.mktemp("fuzz"))


@pytest.mark.slow
def test_only_our_own_errors(targets):
    assert len(targets) == 16
    for target in targets:
        result = fuzz(target, 40, 1)
        assert result["inputs"] >= 20
        assert result["failures"] == [] and result["uncaught"] == result["hangs"] == 0


@pytest.mark.slow
def test_memory_of_a_fresh_process():
    """Every target once more, in a process of its own: what it needs at most."""
    tables = in_fresh_process(60, 2)
    assert len(tables) == 16
    assert sum(table["uncaught"] + table["hangs"] for table in tables) == 0
    assert 30 < max(table["peak_MiB"] for table in tables) <= MEMORY


@pytest.mark.parametrize("value", ["9" * 4000, "1e400", "nan", "-inf"])
def test_numbers_without_a_float(value):
    with pytest.raises(UsageError):
        parse_effects([f"turn_short.fraction={value}"])
