"""`--kit` and $EMA_KIT on every command."""

import json
import os
import shutil

import pytest
from typer.main import get_command

from ema_cli.main import COMMANDS, build_app, run
from ema_cli.options import with_common
from ema_prognostics.verdict.contract import kit_sha256
from ema_record.actuator import load_actuator
from ema_record.actuator_type import actuator_hash
from ema_record.bag.read import read_bag
from ema_record.errors import UsageError
from ema_record.kit import ENVIRONMENT, using_kit
from support.simulations import second_kit


@pytest.fixture(scope="module")
def kit(tmp_path_factory):
    return second_kit(tmp_path_factory.mktemp("kit") / "second", cascade=False)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_it_and_says_so(name, capsys):
    options = {option for p in get_command(build_app(name)).params for option in p.opts}
    assert "--kit" in options
    assert run([name, "--help"]) == 0
    assert "--kit" in capsys.readouterr().out


@pytest.mark.parametrize(("arguments", "hint"), [
    (["effects", "--kit", "/nowhere"], "no such folder"),
    (["effects", "--kit", __file__], "is a file, give the folder"),
    (["check", "--kit", "/tmp", "bag"], "holds no actuator.yaml"),
    (["check", "bag", "--kit"], "requires an argument"),
])
def test_a_folder_that_is_no_kit_is_one_line(arguments, hint, capsys):
    assert run(arguments) == 2
    error = capsys.readouterr().err
    assert hint in error and error.count("\n") == 1 and error.startswith("ema: ")


@pytest.mark.parametrize("arguments", [
    ["simulate", "--profile", "step", "--out", "bag"], ["effects"],
])
def test_what_the_environment_names_is_one_line_too(arguments, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(ENVIRONMENT, str(tmp_path))
    assert run(arguments) == 2
    error = capsys.readouterr().err
    assert "holds no actuator.yaml" in error and error.count("\n") == 1


def test_it_holds_inside_the_command_alone(kit):
    seen = []

    def command(name: str = "x") -> int:
        seen.append((name, load_actuator().gear.ratio, os.environ.get(ENVIRONMENT)))
        return 0

    before = os.environ.get(ENVIRONMENT)
    wrapped = with_common(command)
    wrapped(name="a", kit=kit)
    wrapped(name="b", kit=None)
    assert seen[0] == ("a", 300.0, str(kit.resolve()))
    assert seen[1] == ("b", load_actuator().gear.ratio, before)
    assert os.environ.get(ENVIRONMENT) == before


def test_a_command_with_a_kit_of_its_own_keeps_it():
    def command(kit: str) -> str:
        return kit

    assert with_common(command)(kit="mine") == "mine"


def test_simulate_lint_and_check_with_a_kit(kit, tmp_path, capsys):
    bag = tmp_path / "bag"
    assert run(["simulate", "--kit", str(kit), "--profile", "step", "--out", str(bag)]) == 0
    with using_kit(kit):
        assert read_bag(bag).provenance.actuator == actuator_hash()
    assert read_bag(bag).rate == pytest.approx(10_000.0)
    assert run(["lint", "--kit", str(kit), str(bag)]) == 0
    assert run(["lint", str(bag)]) == 1
    out = capsys.readouterr().out
    assert "other_actuator" in out and "--kit DIR" in out
    assert run(["check", str(bag), "--json"]) == 2
    verdict = json.loads(capsys.readouterr().out)
    assert verdict["verdict"] == "invalid" and len(verdict["reasons"]) == 1
    assert run(["check", "--kit", str(kit), str(bag)]) == 2
    error = capsys.readouterr().err
    assert "has no cascade.json" in error and error.count("\n") == 1
    assert run(["identify", str(bag), "--out", str(tmp_path / "report")]) == 2
    assert "give the kit that it was recorded with" in capsys.readouterr().err
    assert not (tmp_path / "report").exists()


def test_a_file_of_any_name_is_of_the_kit(kit, tmp_path):
    copy = shutil.copytree(kit, tmp_path / "kit")
    with using_kit(kit):
        before = kit_sha256()
    with using_kit(copy):
        assert kit_sha256() == before
        (copy / "profiles" / os.fsdecode(b"\xff.yaml")).touch()
        assert kit_sha256() != before


def test_a_campaign_names_the_kit(kit, tmp_path):
    plan = tmp_path / "plan.yaml"
    plan.write_text("name: two\nprofile: step\nruns: 2\nkeep: bags\n"
                    "parameters: {noise: {uniform: [0.5, 1.0]}}\n", encoding="utf-8")
    assert run(["simulate", "--kit", str(kit), "--campaign", str(plan), "--jobs", "1",
                "--out", str(tmp_path / "c")]) == 0
    bags = sorted((tmp_path / "c" / "bags").iterdir())
    with using_kit(kit):
        assert [read_bag(bag).provenance.actuator for bag in bags] == [actuator_hash()] * 2


def test_the_papers_experiment_is_the_default_actuators(kit, monkeypatch, capsys):
    """With another kit it is run all the same, of the default one, and that is said."""
    seen = []

    def experiment(*_):
        seen.append(load_actuator().gear.ratio)
        raise UsageError("enough")

    monkeypatch.setattr("ema_prognostics.paper.experiment.run_experiment", experiment)
    assert run(["paper", "--quick", "--kit", str(kit)]) == 2
    said, error = capsys.readouterr().err.splitlines()
    assert said.endswith("is left aside: the paper's experiment is of the default actuator")
    assert str(kit) in said and error == "ema: enough"
    assert seen == [load_actuator().gear.ratio]
    assert run(["paper", "--quick"]) == 2
    assert capsys.readouterr().err == "ema: enough\n"
