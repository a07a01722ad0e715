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


def broken(shipped, change):
    """Return the text of a file whose body `change` has altered, with the right hash."""
    data = json.loads(model_text(shipped))
    change(data["body"])
    body = json.dumps(data["body"], sort_keys=True, separators=(",", ":"))
    data["sha256"] = hashlib.sha256(body.encode()).hexdigest()
    return json.dumps(data)


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


def test_one_changed_digit_is_noticed(shipped):
    text = model_text(shipped)
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


def fleet_of(body):
    return body["views"]["extended/fleet"]


def drop_network(body):
    fleet_of(body)["members"].pop("short")


def drop_part(body):
    fleet_of(body).pop("center")


def shorten_row(body):
    fleet_of(body)["members"]["short"]["network"]["hidden_weights"][0].pop()


def shorten_all(body):
    fleet_of(body)["severity"]["short"]["network"]["input_mean"].pop()


def add_field(body):
    fleet_of(body)["surprise"] = 1


def zero_scale(body):
    fleet_of(body)["members"]["short"]["network"]["input_scale"][0] = 0.0


def zero_spread(body):
    fleet_of(body)["spread"][0] = 0.0


def other_names(body):
    fleet_of(body)["members"]["short"]["inputs"][0] = "luck"


def guard_of_others(body):
    fleet_of(body)["guard"]["checked"][0] = "luck"


def text_for_number(body):
    fleet_of(body)["families"]["backlash"]["threshold"] = "many"


def other_view(body):
    body["views"]["sideways/fleet"] = body["views"].pop("step/fleet")


def zero_width(body):
    fleet_of(body)["severity"]["short"]["factors"][0] = 0.0


def lose_limit(body):
    fleet_of(body)["guard"]["limits"]["healthy"]["limit"].pop()


def lose_filter(body):
    fleet_of(body)["lines"]["weight"].pop()


def paper_of_others(body):
    body["paper"]["ann_a"] = fleet_of(body)["members"]["short"]["network"]


@pytest.mark.parametrize(
    "change",
    [drop_network, drop_part, shorten_row, shorten_all, add_field, zero_scale, zero_spread,
     other_names, guard_of_others, text_for_number, other_view, zero_width, lose_limit,
     lose_filter, paper_of_others],
)
def test_bodies_of_the_wrong_form(shipped, change):
    with pytest.raises(ModelError) as error:
        parse_model(broken(shipped, change), "model.json")
    assert str(error.value).startswith("model.json: ")
    assert "\n" not in str(error.value)


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
