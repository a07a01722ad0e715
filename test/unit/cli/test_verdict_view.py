"""What a technician reads: every outcome says what it is, how sure, what to do, what next."""

import io
import json
from dataclasses import replace

import pytest
from rich.console import Console

from ema_cli.lines import wrapped
from ema_cli.main import run
from ema_cli.views.verdict import bar, percent, print_verdict, short
from ema_prognostics.verdict.report import verdict_of_error
from ema_prognostics.verdict.verdict import Fault, Symptom, Verdict
from ema_prognostics.words import feature_words, words
from ema_record.errors import RigRecordError

HEADING = {
    "serial_number": "SN-0042", "profile": "extended",
    "start_time": "2026-11-22T17:20:00.000+00:00",
    "checks": [{"name": "count", "level": 0, "message": "fine"},
               {"name": "saturation", "level": 1, "message": "3 s at the limit"}],
    "software_version": "0.1.0", "model": "c41a830bd99b7", "kit": "default kit 12345678",
}
PULSES = Symptom(feature="quarter_even_m2_re", measure="healthy", times=-23.8, value=-2.4,
                 unit="% of the mean torque", healthy=(-0.17, 0.17))
SHORT = Verdict(
    outcome="fault", bag="flights/one bag", alternatives=("rotor_eccentricity",),
    faults=(Fault(fault_class="turn_short", phase="b", severity=0.099, severity_unit="1",
                  severity_interval=(0.093, 0.106), level="medium"),),
    probabilities={"healthy": 0.001, "turn_short": 0.9991}, evidence=(PULSES,),
    reasons=("torque pulses twice a turn, at quarter speed: -23.8 healthy deviations",),
)

STRANGER = Verdict(
    outcome="unknown", bag="b", cause="unlike", probabilities={"unknown": 1.0},
    evidence=(Symptom(feature="stranger.weak_magnets", measure="bound", times=1.5),))


def printed(verdict, width=80, heading=HEADING, **options):
    text = io.StringIO()
    console = Console(file=text, width=width, markup=False, highlight=False, emoji=False)
    print_verdict(verdict.to_dict(), heading, console, **options)
    return text.getvalue()


def test_a_fault_is_told_in_the_order_that_a_technician_asks():
    text = printed(SHORT)
    parts = ["FAULT  SN-0042  2026-11-22 17:20 UTC  extended test, complete, 1 of 2 checks",
             "Shorted turns, phase b   9.9 % of the turns (9.3 to 10.6)   MEDIUM",
             "Sure?", "99 % sure", "off centre", "measure the resistance", "phase b lower",
             "Do", "Plan the replacement", "Why", "torque pulses twice a turn", "24 x",
             "Checks", "saturation: 3 s at the limit", "Next",
             "ema report 'flights/one bag' --out SN-0042.html", "ema explain turn_short",
             "Record  flights/one bag", "model c41a830bd99b, default kit"]
    places = [" ".join(text.split()).find(" ".join(part.split())) for part in parts]
    assert -1 not in places and places == sorted(places)
    assert "healthy deviations" not in text and "0.1 %" not in text


def test_verbose_tells_the_numbers_and_quiet_one_line():
    text = " ".join(printed(SHORT, verbose=True).split())
    assert "turn short 99.9 %" in text and "-2.4 % of the mean" in text and "count: fine" in text
    assert printed(SHORT, quiet=True).count("\n") == 1


@pytest.mark.parametrize("width", [60, 80, 200])
@pytest.mark.parametrize("language", ["en", "de"])
def test_no_line_is_wider_than_the_terminal(width, language, monkeypatch):
    monkeypatch.setenv("EMA_LANG", language)
    command = "ema report 'flights/one bag' --out SN-0042.html"
    for line in printed(SHORT, width, verbose=True).splitlines():
        assert len(line) <= width or command in line
        assert not line.rstrip().endswith(("24", "9.9"))  # a number without its unit


def test_in_a_pipe_each_statement_is_a_line():
    lines = printed(SHORT, 100_000).splitlines()
    assert len(lines) == 11  # each of the two commands too
    assert any(line.lstrip().startswith("Sure?") and line.endswith("short.") for line in lines)


@pytest.mark.parametrize(("verdict", "expected"), [
    (Verdict(outcome="healthy", bag="b", probabilities={"healthy": 0.92}, evidence=(PULSES,)),
     ["HEALTHY", "No fault found", "92 % sure", "Nothing. Keep", "ema report b"]),
    (Verdict(outcome="healthy", bag="b", probabilities={"healthy": 0.8},
             alternatives=("backlash", "friction")),
     ["does not rule out: backlash, friction", "Run the extended test"]),
    (Verdict(outcome="unknown", bag="b", cause="unlike", probabilities={"unknown": 1.0},
             evidence=(Symptom(feature="noise_speed", measure="bound", times=1.4),)),
     ["UNKNOWN", "unlike anything", "that sensor and its cable", "usual bound", "1.4 x",
      "ema lint b", "ema identify b"]),
    (STRANGER,
     ["UNKNOWN", "and not healthy either: most like weak magnets.", "look for that before",
      "ema identify b"]),
    (replace(STRANGER, cause="unlike_since_baseline"),
     ["since the baseline that is no fault that the test names: most like weak magnets."]),
    (Verdict(outcome="unknown", bag="b", cause="doubt", alternatives=("friction",),
             probabilities={"friction": 0.4, "healthy": 0.3}),
     ["No fault is certain", "Most like: friction 40 %", "--baseline"]),
    (Verdict(outcome="unknown", bag="b", cause="stuck_channel", reasons=("sensor fault: x",)),
     ["sensor fault: x", "Check that transducer", "ema explain stuck_channel"]),
    (Verdict(outcome="incomplete", bag="b", cause="gap", reasons=("b: cut at 3 s",)),
     ["INCOMPLETE", "cannot be judged: cut at 3 s", "Repeat the test", "ema explain gap"]),
    (Verdict(outcome="incomplete", bag="b", cause="record", reasons=("b: was cut",)),
     ["INCOMPLETE", "cannot be judged: was cut", "Repeat the test", "ema recover b"]),
    (Verdict(outcome="invalid", bag="b", cause="record", reasons=("no metadata",)),
     ["INVALID", "no metadata", "Correct what is named", "ema lint b"]),
    (verdict_of_error(RigRecordError("b: of a rig"), "b"),
     ["INVALID", "of a rig", "Identify this axis", "ema identify b --check"]),
])
def test_every_outcome_says_what_to_do_and_what_next(verdict, expected):
    text = " ".join(printed(verdict).split())
    assert [part for part in expected if part not in text] == []


@pytest.mark.parametrize("language", ["en", "de"])
@pytest.mark.parametrize("cause", ["unlike", "unlike_since_baseline"])
def test_what_says_what_the_reasons_say_where_a_record_is_most_like_something(
    cause, language, monkeypatch
):
    monkeypatch.setenv("EMA_LANG", language)
    say = words()
    known = say.below("feature.stranger")
    assert "weak_magnets" in known
    for kind in known:
        feature = f"stranger.{kind}"
        verdict = replace(STRANGER, cause=cause, evidence=(
            Symptom(feature=feature, measure="bound", times=1.5),
            Symptom(feature="noise_speed", measure="bound", times=1.2)))
        what, *_ = (line for line in printed(verdict, 400).splitlines()
                    if line.lstrip().startswith(say("label.what")))
        assert what.endswith(f": {feature_words(feature)}.")
        assert say(f"what.{cause}") not in what
    # A stranger that is no reason is not named.
    other = replace(STRANGER, evidence=(Symptom(feature="noise_speed", measure="bound", times=1.2),
                                        *STRANGER.evidence))
    assert say("what.unlike") in " ".join(printed(other).split())


def test_numbers():
    assert [percent(p) for p in (0.0, 0.5, 0.998)] == ["1", "50", "99"]
    assert [short(v) for v in (0.0123456, 9.876, 123.4, 12345.0)] == [
        "0.0123", "9.88", "123", "12345"]
    assert len(bar(1000.0)) == len(bar(101.0)) > len(bar(5.0)) > len(bar(0.0)) == 1
    assert wrapped("it is 12 % of it", 20) == ["it is 12 % of it"]
    assert wrapped("it was all about 12 % here", 20) == ["it was all about", "12 % here"]


def test_the_command_prints_it_with_the_structured_reasons_in_json(repository, capsys):
    bag = str(repository / "bags" / "sim_0001_step")
    assert run(["check", bag]) == 1
    text = capsys.readouterr().out
    assert text.startswith("FAULT  SIM-0001  2026-09-21 14:23 UTC  step test, complete, 8 of 8 c")
    assert "Shorted turns, phase b" in text and f"Record  {bag}" in text
    assert run(["check", bag, "--json", "--lang", "de"]) == 1
    verdict = json.loads(capsys.readouterr().out)
    first = verdict["evidence"][0]
    assert first["words"].startswith("torque pulses")  # programs read English
    assert abs(first["times"]) > 2.0
    low, high = first["healthy"]
    assert low < high and not low <= first["value"] <= high
    assert verdict["cause"] is None
