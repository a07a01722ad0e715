"""The numbers that decide: fourteen, each with a source, as the code has them."""

import re

import pytest

from ema_identification.actuator.decision.decide import EDGE, MOST
from ema_identification.actuator.decision.fit import LAW_ERROR
from ema_identification.actuator.decision.intervals import RUNS, WIDER
from ema_identification.actuator.decision.models import LARGEST_SET
from ema_identification.actuator.decision.ranks import LEVEL
from ema_identification.actuator.fleet.surrogate import BEND, SETTLED_RUNS, WORST
from ema_identification.actuator.fleet.units import FULL
from ema_identification.actuator.laws.terms import SURE

IN_WORDS = {"a tenth": 0.1, "three quarters": 0.75}
CODE = (LEVEL, SURE, LARGEST_SET, BEND, LAW_ERROR, WORST, FULL.units, FULL.repeated, FULL.scaled,
        SETTLED_RUNS, RUNS, WIDER, EDGE, MOST)
SOURCES = ("requirement", "statistic", "budget", "choice: ")


def value_of(text):
    """Return what a cell of the table says."""
    if text in IN_WORDS:
        return IN_WORDS[text]
    number, unit = re.fullmatch(r"([\d.]+)(.*)", text).groups()
    return float(number) * (0.01 if unit.startswith(" %") else 1.0)


def test_fourteen_numbers_decide_each_with_its_source(repository):
    page = (repository / "docs/identification-method.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines()
            if re.match(r"\| \d+ \|", line)]
    assert [int(row[0]) for row in rows] == list(range(1, len(CODE) + 1))
    assert [value_of(row[2]) for row in rows] == pytest.approx(CODE)
    assert all(row[4].startswith(SOURCES) for row in rows)
