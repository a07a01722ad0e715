"""The tables of words: complete, translated without touching code, never a broken text."""

import re

import pytest

from ema_cli.main import run
from ema_prognostics.cascade.guard_groups import GROUPS
from ema_prognostics.cascade.model_file import load_model
from ema_prognostics.words import (
    ENVIRONMENT,
    class_name,
    feature_words,
    languages,
    name_of,
    next_step,
    words,
)
from ema_record.checks.guard import OUTCOMES, RULES
from ema_record.checks.live import CHECKS
from ema_record.checks.live import GROUPS as CHECK_GROUPS
from ema_record.errors import UsageError

PLACE = re.compile(r"\{(\w*)\}")


def test_german_is_there_and_takes_the_same_values():
    assert languages() == ["de", "en"]
    english, german = words("en").table, words("de").table
    assert set(german) <= set(english)
    assert set(english) - set(german) <= {f"next_steps.{k}" for k in ("repeat", "sensor", "drive")}
    for key, text in german.items():
        assert sorted(PLACE.findall(text)) == sorted(PLACE.findall(english[key])), key


def test_what_a_table_lacks_is_english(tmp_path, monkeypatch):
    own = tmp_path / "own.yaml"
    own.write_text('fault:\n  backlash: {name: jeu}\n')
    monkeypatch.setenv(ENVIRONMENT, str(own))
    assert (class_name("backlash"), class_name("friction")) == ("jeu", "friction")
    assert name_of("backlash", "en") == "backlash"


@pytest.mark.parametrize(("text", "problem"), [
    ("fault: [1]\n", "expected texts"), ('phase: "{nothing}"\n', "expected the places"),
    ("a: [\n", "malformed YAML"), ('a: "{percent:>999999999}"\n', "a name in braces"),
    ('a: "{percent.__class__}"\n', "a name in braces"), ('a: "{"\n', "a name in braces"),
])
def test_a_broken_table_is_one_line(tmp_path, monkeypatch, text, problem):
    own = tmp_path / "own.yaml"
    own.write_text(text)
    monkeypatch.setenv(ENVIRONMENT, str(own))
    with pytest.raises(UsageError, match=f"^{own}: .*{problem}"):
        class_name("turn_short", "a")


def test_an_unknown_language_is_wrong_use(capsys):
    assert run(["explain", "gap", "--lang", "dee"]) == 2
    assert "did you mean 'de'?" in capsys.readouterr().err


def test_every_feature_group_and_rule_has_words():
    inputs = {n for c in load_model().cascades.values() for n in c.inputs.input_names}
    bare = [n for n in inputs if not n.startswith("absolute_")]
    hidden = ("amplitude_", "short_", "odd_", "winding_like", "lines_and", "third_", "first_")
    for name in bare:
        assert feature_words(name) != name.replace("_", " ") or name.startswith(hidden) or (
            name in {"temperature", "inertia"}), name
    assert all(words("en").has(f"group.{name}") for name in GROUPS)
    for rule in {*OUTCOMES, *(part for parts in CHECK_GROUPS.values() for part in parts)}:
        assert words("en").has(f"check.{rule}"), rule
    assert len(CHECKS) + 1 == sum(" " in n or n in {
        "counters", "count", "finite", "range", "saturation"} for n in words("en").below("check")
    ) and RULES


def test_lines_of_the_torque_in_words():
    assert feature_words("quarter_even_m2_im") == "torque pulses twice a turn, at quarter speed"
    assert feature_words("full_odd_m5_re") == "speed sensor ripples 5 times a turn, at full speed"
    assert feature_words("quarter_even_m2_im", "de").startswith("Drehmoment pulsiert zweimal")
    assert feature_words("inductance_m1_im") == feature_words("inductance_spread")
    assert "sensor" in next_step("noise_speed") and "ema identify" in next_step("inertia")


@pytest.mark.parametrize(("name", "said"), [
    (["turn_short"], "resistance between each two phases"), (["Shorted", "turns"], "turn_short"),
    (["gap"], "Verdict: INCOMPLETE"), (["current", "sum"], "sensor_scale"),
    (["unknown"], "Repeat"),
    (["torque needed at full speed"], "N m"), (["interval"], "nine times in ten"),
    (["weak_magnets"], "No fault that the test names"),
    (["most like weak magnets"], "weak_magnets"),
])
def test_explain(name, said, capsys):
    assert run(["explain", *name]) == 0
    assert said in capsys.readouterr().out


def test_explain_lists_and_guesses(capsys):
    assert run(["explain"]) == 0
    assert "backlash" in capsys.readouterr().out
    assert run(["explain", "turnshort"]) == 2
    assert "did you mean 'turn_short'?" in capsys.readouterr().err
