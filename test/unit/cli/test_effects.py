"""`ema effects`: the whole catalogue, with units, bounds, defaults and references."""

import json

import pytest

from ema_cli.main import run
from ema_sim.effects import EFFECTS, Choice, parse_effects


def test_table_has_every_effect_and_parameter(capsys):
    assert run(["effects"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name, effect in EFFECTS.items():
        at = lines.index(f"  {name} ({effect.port})")
        assert lines[at + 1].strip() == effect.summary
        for k, field in enumerate(effect.fields, start=at + 2):
            assert lines[k].split("=")[0].strip() == f"{name}.{field.name}"
    assert sum("=" in line and "." in line.split("=")[0] for line in lines) >= sum(
        len(effect.fields) for effect in EFFECTS.values())


def test_json_is_one_object_an_effect_and_its_names_can_be_set(capsys):
    assert run(["effects", "--json"]) == 0
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [effect["name"] for effect in found] == list(EFFECTS)
    settings = []
    for effect in found:
        assert effect["equation"]
        assert effect["reference"]
        for parameter in effect["parameters"]:
            value = parameter["options"][-1] if "options" in parameter else parameter["upper"]
            settings.append(f"{parameter['name']}={value}")
    effects = parse_effects(settings)
    for name, effect in EFFECTS.items():
        assert not effect.is_neutral(getattr(effects, name))


@pytest.mark.parametrize("name", list(EFFECTS))
def test_one_is_explained_with_its_equation(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    assert run(["effects", name]) == 0
    printed = capsys.readouterr().out
    effect = EFFECTS[name]
    for text in (effect.summary, effect.equation, effect.reference, effect.port):
        assert text in printed
    for field in effect.fields:
        assert f"{name}.{field.name}" in printed
        if not isinstance(field.kind, Choice):
            assert f"{field.kind.lower:g} to {field.kind.upper:g}" in printed


def test_an_unknown_name_gets_the_nearest(capsys):
    assert run(["effects", "turn_shot"]) == 2
    assert "did you mean 'turn_short'?" in capsys.readouterr().err
