"""Numbers and sentences."""

import math
from dataclasses import replace

import pytest

from ema_identification.report import words
from ema_identification.result import Parameter


@pytest.mark.parametrize(("value", "text"), [
    (0.0, "0"), (12.0, "12"), (-3.0, "−3"), (0.0301, "0.0301"), (123.456, "123"),
    (1.2e-5, "1.20 × 10⁻⁵"), (math.nan, "not known"), (math.inf, "∞"), (0.9996, "1.000"),
])
def test_number(value, text):
    assert words.number(value) == text


def test_probability():
    assert words.probability(2e-7) == "< 0.001"
    assert words.probability(0.31) == "0.31"
    assert words.probability(math.nan) == "–"


def test_a_ratio_has_no_unit_and_a_choice_no_interval():
    p = Parameter(name="x", value=2.5, low=2.5, high=2.5, unit="1")
    assert words.quantity(p) == "2.50"
    assert words.interval(p) == "–"
    assert words.interval(replace(p, high=2.75, unit="V")) == "2.50 to 2.75 V"


def test_closed_share(explained):
    made = replace(explained, gap_before=5.0, gap_after=2.0, noise_floor=1.0)
    assert words.closed_share(made) == pytest.approx(0.75)
    assert words.closed_share(replace(made, gap_before=1.0)) is None


def test_sentence_of_each_verdict(explained, unknown):
    assert "falls from" in words.verdict_sentence(explained)
    partly = replace(explained, verdict="partly explained")
    assert "something is left" in words.verdict_sentence(partly)
    assert "does not hold" in words.verdict_sentence(unknown)
    two = replace(explained, findings=explained.findings * 2)
    assert words.verdict_sentence(two).count("cogging torque or gear mesh ripple") == 2
