"""`ema check`, `ema train` and `ema paper` as commands, on real bags."""

import json
import math
from dataclasses import replace

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from ema_cli.commands.bit import print_result
from ema_cli.main import run
from ema_monitor.moves import ramp
from ema_prognostics.cascade.model_file import load_model
from ema_prognostics.features.extract import extract
from ema_prognostics.verdict import diagnose as diagnosis
from ema_prognostics.verdict import judge as judging
from ema_prognostics.verdict.judge import Judge
from ema_record.actuator import load_actuator
from ema_record.bag.read import write_bag
from ema_record.errors import UsageError
from ema_record.profile import load_profile
from ema_record.record import Provenance, Record
from ema_sim.effects import parse_effects
from ema_sim.session import ActuatorSession
from ema_sim.simulate import simulate


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags")
    made = {}
    for name, effects in (
        ("healthy", []), ("short", ["turn_short.fraction=0.1", "turn_short.phase=b"]),
        ("worn", ["motor_friction.increase=1.0"]),
    ):
        record = simulate(load_profile("step"), effects=parse_effects(effects), seed=77_031)
        made[name] = str(write_bag(record, folder / name))
    return made


def check(capsys, *arguments):
    status = run(["check", *arguments, "--json"])
    lines = capsys.readouterr().out.splitlines()
    return status, [json.loads(line) for line in lines]


@pytest.mark.parametrize(
    ("name", "status", "outcome"), [("healthy", 0, "healthy"), ("short", 1, "fault"),
                                    ("worn", 1, "fault")],
)
def test_one_bag(bags, capsys, name, status, outcome):
    found, (verdict,) = check(capsys, bags[name])
    assert (found, verdict["verdict"], verdict["bag"]) == (status, outcome, bags[name])


def test_a_step_is_judged_alike_whatever_moved_the_actuator_before():
    """Surface and shaft stand as the last move or hold has left them."""
    step, nominal, outcomes = load_profile("step"), load_actuator(), []
    back = ramp(step.points[-1][1], step.start, 0.5 * nominal.slew_speed)
    for seed in range(5):
        session = ActuatorSession(nominal, seed=seed, position=step.start)
        for _ in range(4):
            session.command(step)
            record = Record(samples=session.advance(session.samples_left), profile=step,
                            provenance=Provenance(start_time=0))
            outcomes.append(Judge().of_record(record, "step").verdict.outcome)
            session.command(back)
            session.advance(session.samples_left)
    assert "fault" not in outcomes
    assert outcomes.count("unknown") <= 1


def test_several_bags_give_one_line_each_and_the_worst_status(bags, capsys, tmp_path):
    status, verdicts = check(capsys, bags["healthy"], bags["worn"], bags["short"])
    assert status == 1
    assert [v["verdict"] for v in verdicts] == ["healthy", "fault", "fault"]
    assert verdicts[1]["fault_class"] == "friction"
    assert (verdicts[2]["fault_class"], verdicts[2]["phase"]) == ("turn_short", "b")
    status, verdicts = check(capsys, str(tmp_path / "none"), bags["short"])
    assert status == 2
    assert [v["verdict"] for v in verdicts] == ["invalid", "fault"]


def test_for_a_person(bags, capsys):
    assert run(["check", bags["short"]]) == 1
    text = capsys.readouterr().out
    assert "FAULT" in text
    assert "Shorted turns, phase b" in text
    assert "MEDIUM" in text


def test_what_cannot_be_told_apart_does_not_contradict_the_probabilities(bags, capsys):
    """A static eccentricity along the axis of the phase is judged as that short, and said so."""
    run(["check", bags["short"]])
    text = capsys.readouterr().out
    assert "A rotor off centre in a fixed direction would look the same: measure the" in text
    _, (verdict,) = check(capsys, bags["short"])
    assert verdict["alternatives"] == ["rotor_eccentricity"]
    assert any("the probability of turn short is that of either" in r for r in verdict["reasons"])
    record = simulate(load_profile("extended"), seed=77_032, effects=parse_effects(
        ["rotor_eccentricity.zeta=-0.067", "rotor_eccentricity.mode=static",
         f"rotor_eccentricity.angle={2.0 * math.pi / 3.0}"]))
    alike = diagnosis.diagnose(record, load_model())
    assert [(f.fault_class, f.phase) for f in alike.faults] == [("turn_short", "b")]
    assert alike.probabilities["turn_short"] > 0.9 > 0.1 > alike.probabilities[
        "rotor_eccentricity"]


def test_what_is_no_bag_is_not_judged(bags, capsys, tmp_path):
    (tmp_path / "README.md").write_text("# Bags\n")
    paths = [str(tmp_path / "README.md"), str(tmp_path / "none"), bags["healthy"]]
    assert run(["check", *paths]) == 2
    out, err = capsys.readouterr()
    assert "INVALID" not in out
    assert out.startswith("HEALTHY  ") and f"  Record  {bags['healthy']}\n" in out
    assert [line.split(": ")[1:3] for line in err.splitlines()] == [
        [paths[0], "a text file, no bag"], [paths[1], "no such file or directory"]]
    status, verdicts = check(capsys, *paths)
    assert (status, [v["verdict"] for v in verdicts]) == (2, ["invalid", "invalid", "healthy"])
    assert run(["trend", paths[0]]) == 2
    assert "a text file, no bag" in capsys.readouterr().err


HOSTILE = "[/] x [rad] y\x1b[2J\nHEALTHY $\\frac$"


@pytest.mark.slow
def test_a_hostile_serial_number_and_name_are_shown_as_they_are(tmp_path, capsys):
    name = HOSTILE.replace("/", "")
    folder = tmp_path / "flights"
    record = simulate(load_profile("step"), serial_number=HOSTILE, seed=77_041,
                      effects=parse_effects(["turn_short.fraction=0.1"]), start_time=10**18)
    bag = str(write_bag(record, folder / name))
    shown = {text: text.replace("\x1b", r"\u001b").replace("\n", r"\u000a")
             for text in (HOSTILE, name)}
    plot = str(tmp_path / "a.png")
    result = {
        "record": bag, "heading": {
            "serial_number": HOSTILE, "profile": HOSTILE, "start_time": "", "kit": "",
            "model": "", "software_version": "",
            "checks": [{"name": HOSTILE, "level": 1, "message": HOSTILE}]},
        "verdict": check(capsys, bag)[1][0],
        "times": {"start": 1.0, "test": 1.0, "after_record_closed": 0.1, "total": 3.0},
    }
    assert result["verdict"]["bag"] == bag
    for command, expected in (
        (["check", bag], [name]), (["check", str(folder), "--plot", plot], [HOSTILE, name]),
        (["lint", bag], [name]), (["trend", str(folder)], [HOSTILE]), (None, [HOSTILE, name]),
        (["export", bag, "--plot", str(tmp_path / "plots")], []),
    ):
        if command is None:
            print_result(result)
        else:
            assert run(command) in (0, 1, 3)
        out, _ = capsys.readouterr()
        assert "\x1b" not in out
        assert not any(line.lstrip().startswith("HEALTHY") for line in out.splitlines())
        for text in expected:
            assert shown[text] in out, command


def test_another_profile_than_the_bag_has(bags, capsys):
    _, (verdict,) = check(capsys, bags["healthy"], "--profile", "extended")
    assert verdict["verdict"] == "incomplete"


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [("--mode", "paprr", "did you mean 'paper'"), ("--profile", "stepp", "did you mean 'step'"),
     ("--model", "none.json", "ema train")],
)
def test_wrong_options(bags, capsys, option, value, message):
    assert run(["check", bags["healthy"], option, value]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_train_never_overwrites(tmp_path, capsys):
    path = tmp_path / "model.json"
    path.write_text("mine")
    assert run(["train", "--quick", "--out", str(path)]) == 2
    assert path.read_text() == "mine"
    assert "exists" in capsys.readouterr().err


def test_validation_of_the_shipped_model_is_good_enough():
    held_out = load_model().training["held_out"]
    for kind, views in held_out.items():
        for view, found in views.items():
            false = found["false alarms"]
            assert false["count"] / false["total"] <= 0.015, (kind, view)
            for name in ("turn_short", "rotor_eccentricity", "friction", "backlash"):
                holds = found[name]["interval coverage"]
                assert holds["upper"] >= 0.87, (kind, view, name)
    for view, most in (("fleet", 0.03), ("baseline", 0.02)):
        assert held_out["extended"][view]["turn_short"]["a90/95"] <= most


def test_a_baseline_sharpens_and_is_checked(tmp_path, capsys):
    bags = {}
    for name, seed, effects in (
        ("new", 77_051, []), ("worn", 77_052, ["motor_friction.increase=0.1"]),
        ("again", 77_053, []), ("short", 77_054, ["turn_short.fraction=0.2"]),
    ):
        record = simulate(load_profile("extended"), effects=parse_effects(effects), seed=seed,
                          serial_number="SN-7")
        bags[name] = str(write_bag(record, tmp_path / name))
    status, (verdict,) = check(capsys, bags["worn"])
    assert (status, verdict["verdict"]) == (0, "healthy")
    status, (verdict, again) = check(capsys, bags["worn"], bags["again"], "--baseline",
                                     bags["new"])
    assert (status, verdict["fault_class"], again["verdict"]) == (1, "friction", "healthy")
    assert run(["check", bags["worn"], "--baseline", bags["new"]]) == 1
    assert "(--baseline)" not in capsys.readouterr().out  # advises no comparison that was made
    judged = Judge(baseline=bags["new"]).of_bag(bags["worn"])  # what the node does
    assert verdict | json.loads(json.dumps(judged.verdict.to_dict())) == verdict
    assert judged.serial_number == verdict["serial_number"] == "SN-7"
    assert run(["check", bags["worn"], "--baseline", bags["short"]]) == 2
    assert "not healthy itself" in capsys.readouterr().err
    other = simulate(load_profile("extended"), seed=77_055, serial_number="SN-8")
    foreign = str(write_bag(other, tmp_path / "foreign"))
    status, (verdict,) = check(capsys, bags["worn"], "--baseline", foreign)
    assert (status, verdict["verdict"]) == (2, "invalid")
    assert "SN-8" in verdict["reasons"][0]
    assert Judge(baseline=foreign).of_bag(bags["worn"]).verdict.reasons
    nobody = str(write_bag(replace(other, provenance=replace(
        other.provenance, serial_number="unknown")), tmp_path / "nobody"))
    status, (verdict,) = check(capsys, bags["worn"], "--baseline", nobody)
    assert "the baseline tells no serial number" in verdict["reasons"][-1]
    with pytest.raises(UsageError, match="not healthy itself"):
        Judge(baseline=bags["short"])


def test_a_record_is_judged_by_one_thread(bags, monkeypatch):
    threads = []

    def diagnose(*arguments, **options):
        threads.extend(library["num_threads"] for library in threadpool_info())
        return diagnosis.diagnose(*arguments, **options)

    monkeypatch.setattr(judging, "diagnose", diagnose)
    with threadpool_limits(2):
        assert Judge().of_bag(bags["worn"]).verdict.outcome == "fault"
    assert set(threads) == {1}


def test_features_of_a_baseline_are_taken_once(bags, capsys, monkeypatch):
    calls = []
    monkeypatch.setattr(diagnosis, "extract", lambda *a: calls.append(a) or extract(*a))
    check(capsys, bags["healthy"], "--baseline", bags["healthy"])
    one = len(calls)
    check(capsys, *[bags["healthy"]] * 3, "--baseline", bags["healthy"])
    assert len(calls) - one == one + 2
