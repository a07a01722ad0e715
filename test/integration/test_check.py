"""`ema check`, `ema train` and `ema paper` as commands, on real bags."""

import json

import pytest

from ema_cli.main import run
from ema_prognostics.model_file import load_model
from ema_record.bag import write_bag
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects
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
                                    ("worn", 3, "unknown")],
)
def test_one_bag(bags, capsys, name, status, outcome):
    found, (verdict,) = check(capsys, bags[name])
    assert (found, verdict["verdict"], verdict["bag"]) == (status, outcome, bags[name])


def test_several_bags_give_one_line_each_and_the_worst_status(bags, capsys, tmp_path):
    status, verdicts = check(capsys, bags["healthy"], bags["worn"], bags["short"])
    assert status == 1
    assert [v["verdict"] for v in verdicts] == ["healthy", "unknown", "fault"]
    assert (verdicts[2]["fault_class"], verdicts[2]["phase"]) == ("turn_short", "b")
    status, verdicts = check(capsys, str(tmp_path / "none"), bags["short"])
    assert status == 2
    assert [v["verdict"] for v in verdicts] == ["invalid", "fault"]


def test_for_a_person(bags, capsys):
    assert run(["check", bags["short"]]) == 1
    text = capsys.readouterr().out
    assert "FAULT" in text
    assert "turn short in phase b" in text
    assert "medium" in text


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


def test_held_out_results_of_the_shipped_model_are_good_enough():
    for kind, result in load_model().training["held_out"].items():
        confusion = result["confusion"]
        healthy = confusion["healthy"]
        assert healthy["healthy"] / sum(healthy.values()) >= 0.975, kind
        for label in ("motor_friction.increase", "surface_friction.increase"):
            assert confusion[label].get("healthy", 0) / sum(confusion[label].values()) <= 0.03
        for name, bound in (("turn_short", 0.012), ("rotor_eccentricity", 0.05)):
            severity = result["severity"][name]
            assert severity["largest_called_healthy"] <= bound, (kind, name)
            assert severity["interval_coverage"] >= 0.90, (kind, name)
        assert result["severity"]["turn_short"]["phase_right"] >= 0.99
