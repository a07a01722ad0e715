"""Numbers and sentences."""

import math
from dataclasses import replace

import pytest

from ema_identification.report import words
from ema_identification.result import Parameter, after_validation


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


def test_a_name_has_its_phase_and_mode(explained):
    finding = replace(explained.findings[0], effect="turn_short", equivalent=(),
                      choices={"turn_short.phase": "b", "turn_short.mode": "physical"})
    assert words.named(finding) == "turn short (phase b, mode physical)"


def test_closed_share(explained):
    made = replace(explained, gap_before=5.0, gap_after=2.0, noise_floor=1.0)
    assert words.closed_share(made) == pytest.approx(0.75)
    assert words.closed_share(replace(made, gap_before=1.0)) is None
    assert words.closed_share(replace(made, gap_after=6.0)) is None
    assert words.closed_share(replace(made, gap_after=0.9)) == 1.0


def test_sentence_of_each_verdict(explained, unknown):
    assert "falls from" in words.verdict_sentence(explained)
    partly = replace(explained, verdict="partly explained")
    assert "not sure enough" in words.verdict_sentence(partly)
    partly = replace(partly, unknown=unknown.unknown)
    assert "something is left" in words.verdict_sentence(partly)
    assert "does not hold" in words.verdict_sentence(unknown)
    against = words.verdict_sentence(replace(
        explained, verdict="contradicted", gap_before=6.1, gap_after=15.2))
    assert "their gap grew from 6.10 to 15.2" in against
    assert "falls" not in against
    noise = replace(explained, gap_before=2.0, gap_after=2.1)
    assert "grows from 2 to 2.10, within the noise," in words.verdict_sentence(noise)
    alone = words.verdict_sentence(replace(explained, held_out=False))
    assert "held-out" not in alone
    assert "the fitted data" in alone
    two = replace(explained, findings=explained.findings * 2)
    assert words.verdict_sentence(two).count("cogging torque or gear mesh ripple") == 2


@pytest.mark.parametrize(("verdict", "before", "after", "bound", "expected", "said"), [
    ("explained", 6.1, 15.2, 2.3, "contradicted", "grew from 6.1 to 15.2"),
    ("partly explained", 6.1, 6.2, 2.3, "contradicted", "grew"),
    ("explained", 1.0, 1.9, 2.3, "explained", "within the noise of the runs"),
    ("explained", 6.1, 5.0, 2.3, "explained", ""),  # it fell, though not into the noise
    ("explained", 1.9, 1.0, 2.3, "explained", ""),
    ("explained", 1.5, 1.5, 2.3, "explained", ""),
    ("explained", 6.1, 6.1, 2.3, "partly explained", "did not fall"),
    ("explained", 1.0, 1.1, math.nan, "contradicted", "grew"),  # no run says that it is noise
    ("no disagreement", 6.1, 6.1, 2.3, "no disagreement", ""),  # nothing was added
    ("unknown effect", 6.1, 6.1, 2.3, "unknown effect", ""),
])
def test_what_validation_leaves_of_a_verdict(verdict, before, after, bound, expected, said):
    found, reasons = after_validation(verdict, before, after, bound, "the runs")
    assert found == expected
    assert [said in r for r in reasons] == ([True] if said else [])


@pytest.mark.parametrize(("after", "expected"), [
    (3.0, "partly explained"), (3.1, "contradicted"), (6.0, "contradicted"), (2.3, "explained")])
def test_a_gap_may_have_to_fall_by_a_share(after, expected):
    assert after_validation("explained", 6.0, after, 2.3, "the runs", enough=3.0)[0] == expected


def test_no_name_where_a_gap_that_should_fall_grows_within_the_noise():
    found, reasons = after_validation("explained", 1.8, 2.2, 2.8, "healthy units", enough=1.7)
    assert found == "contradicted"
    assert "grew from 1.8 to 2.2" in reasons[0]
    found, _ = after_validation("explained", 2.2, 1.8, 2.8, "healthy units", enough=1.7)
    assert found == "explained"
