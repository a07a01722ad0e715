"""The model file: round trip, and every way in which it can be wrong."""

import hashlib
import json
import re

import pytest

from ema_prognostics.cascade.model_file import (
    MAX_BYTES,
    load_model,
    model_text,
    parse_model,
    save_model,
)
from ema_record.errors import ModelError, OutputError


@pytest.fixture(scope="module")
def shipped():
    return load_model()


@pytest.fixture(scope="module")
def text(shipped):
    return model_text(shipped)


def test_round_trip_keeps_the_bytes(shipped, tmp_path):
    first = save_model(shipped, tmp_path / "a.json")
    again = save_model(load_model(first), tmp_path / "b.json")
    assert first.read_bytes() == again.read_bytes()
    assert load_model(first).sha256 == shipped.sha256


def test_the_shipped_file_is_a_full_training(shipped):
    assert set(shipped.cascades) == {
        f"{kind}/{view}" for kind in ("step", "extended") for view in ("fleet", "baseline")
    }
    assert shipped.paper is not None
    assert shipped.training["quick"] is False


def test_an_existing_file_is_not_touched(shipped, tmp_path):
    path = tmp_path / "model.json"
    path.write_text("mine")
    with pytest.raises(OutputError, match="exists and is never overwritten"):
        save_model(shipped, path)
    assert path.read_text() == "mine"


def test_one_changed_digit_is_noticed(text):
    at = re.search(r'"hidden_bias":\[-?\d', text).end() - 1
    changed = text[:at] + ("1" if text[at] != "1" else "2") + text[at + 1:]
    with pytest.raises(ModelError, match="hash"):
        parse_model(changed, "model.json")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "not JSON"), ("{", "not JSON"),
        ("[]", "not a model file"), ("{}", "not a model file"),
        ('{"format": "ema_phm model", "version": 99}', "version 99"),
        ('{"format": "ema_phm model", "version": 3, "body": {}, "sha256": "0"}', "hash"),
        ('{"format": "ema_phm model", "version": 3, "body": NaN}', "not JSON"),
        ("[" * 100_000, "not JSON"),
    ],
)
def test_foreign_files(text, match):
    with pytest.raises(ModelError, match=match) as error:
        parse_model(text, "model.json")
    assert "\n" not in str(error.value)


WRONG = {  # changes of a cascade
    "a network less": lambda c: c["members"].pop("short"),
    "a part less": lambda c: c.pop("center"),
    "a short row": lambda c: c["members"]["short"]["network"]["hidden_weights"][0].pop(),
    "a mean less": lambda c: c["severity"]["short"]["network"]["input_mean"].pop(),
    "a field more": lambda c: c.update(surprise=1),
    "a scale of zero": lambda c: c["members"]["short"]["network"]["input_scale"].__setitem__(0, 0),
    "a spread of zero": lambda c: c["spread"].__setitem__(0, 0.0),
    "an unknown input": lambda c: c["members"]["short"]["inputs"].__setitem__(0, "luck"),
    "a guard of others": lambda c: c["guard"]["checked"].__setitem__(0, "luck"),
    "text for a number": lambda c: c["families"]["backlash"].update(threshold="many"),
    "a width of zero": lambda c: c["severity"]["short"]["factors"].__setitem__(0, 0.0),
    "a limit less": lambda c: c["guard"]["limits"]["healthy"]["limit"].pop(),
    "a weight less": lambda c: c["lines"]["weight"].pop(),
}


def refused(text, change):
    """Expect one line on a file whose body `change` has altered, with the right hash."""
    data = json.loads(text)
    change(data["body"])
    body = json.dumps(data["body"], sort_keys=True, separators=(",", ":"))
    data["sha256"] = hashlib.sha256(body.encode()).hexdigest()
    with pytest.raises(ModelError) as error:
        parse_model(json.dumps(data), "model.json")
    assert str(error.value).startswith("model.json: ")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", WRONG)
def test_a_cascade_of_the_wrong_form(text, name):
    refused(text, lambda body: WRONG[name](body["views"]["extended/fleet"]))


def test_a_view_and_a_network_of_others(text):
    refused(text, lambda body: body["views"].update(
        {"sideways/fleet": body["views"].pop("step/fleet")}))
    refused(text, lambda body: body["paper"].update(
        ann_a=body["views"]["extended/fleet"]["members"]["short"]["network"]))


def test_missing_large_and_binary_files(tmp_path):
    with pytest.raises(ModelError, match="ema train"):
        load_model(tmp_path / "none.json")
    with pytest.raises(ModelError):
        load_model(tmp_path)
    large = tmp_path / "large.json"
    with large.open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    with pytest.raises(ModelError, match="at most"):
        load_model(large)
    binary = tmp_path / "binary.json"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ModelError, match="UTF-8"):
        load_model(binary)
