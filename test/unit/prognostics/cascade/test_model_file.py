"""The model file: round trip, and every way in which it can be wrong."""

import hashlib
import json
import re

import numpy as np
import pytest

from ema_prognostics.cascade.find import Cascade
from ema_prognostics.cascade.model_body import ViewPart
from ema_prognostics.cascade.model_file import (
    MAX_BYTES,
    load_model,
    model_of,
    model_text,
    parse_model,
    save_model,
)
from ema_record.actuator_type import actuator_hash
from ema_record.errors import ModelError, OutputError
from ema_record.kit import ACTUATOR, CASCADE, shipped_kit, using_kit
from support.simulations import make_kit


@pytest.fixture(scope="module")
def shipped():
    return load_model()


def of_type(model, name):
    """Return a model that says for which actuator it was trained."""
    return model_of(model.body.model_copy(update={"actuator": name}))


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


def test_the_hash_of_the_shipped_file_is_that_of_the_loaded_model(shipped):
    file = json.loads((shipped_kit() / CASCADE).read_text(encoding="utf-8"))
    assert shipped.sha256 == file["sha256"]


def test_a_file_that_does_not_say_its_actuator_is_accepted(shipped, tmp_path):
    """One of before the entry: it is written as it was read."""
    file = save_model(of_type(shipped, ""), tmp_path / "model.json")
    assert "actuator" not in json.loads(file.read_text(encoding="utf-8"))["body"]
    with using_kit(make_kit(tmp_path / "kit", {"gear": {"ratio": 501.0}}, cascade=False)):
        assert load_model(file).body.actuator == ""


def test_a_cascade_of_another_actuator_is_refused(shipped, tmp_path):
    own = save_model(of_type(shipped, actuator_hash()), tmp_path / "model.json")
    assert load_model(own).body.actuator == actuator_hash()
    kit = make_kit(tmp_path / "kit", {"gear": {"ratio": 501.0}}, cascade=False)
    (kit / CASCADE).write_bytes(own.read_bytes())
    trained_for = actuator_hash()
    with using_kit(kit):
        for path in (None, own):
            with pytest.raises(ModelError) as error:
                load_model(path)
            line = str(error.value)
            assert trained_for in line and actuator_hash() in line and "--kit" in line
            assert "\n" not in line
        # A description that was corrected after the training names what it was.
        with (kit / ACTUATOR).open("a", encoding="utf-8") as file:
            file.write(f"formerly: ['{trained_for}']\n")
        assert load_model().body.actuator == trained_for


def test_a_file_written_in_another_manner_holds_the_same_model(shipped, text):
    other = parse_model(json.dumps(dict(reversed(json.loads(text).items())), indent=1), "m")
    assert (other.sha256, other.body) == (shipped.sha256, shipped.body)


@pytest.mark.parametrize("change", [
    lambda text: text.rstrip()[:-1] + "]", lambda text: text.rstrip() + "}",
    lambda text: with_hash(text.replace('"training":{', '"training":{"a":NaN,')),
], ids=["another bracket", "a bracket more", "no number"])
def test_what_is_no_json_is_no_model_whatever_its_hash(text, change):
    with pytest.raises(ModelError, match="not JSON"):
        parse_model(change(text), "model.json")


def test_a_number_beyond_all_numbers_is_one_line(text):
    changed = re.sub(r'"threshold":[-.0-9e]+', '"threshold":1e999', text, count=1)
    assert changed != text
    with pytest.raises(ModelError, match="changed or damaged"):
        parse_model(changed, "model.json")


def with_hash(text):
    """Return the text of a model file with the hash of its body as it stands."""
    body = text.partition('"body":')[2].rstrip()[:-1]
    found = hashlib.sha256(body.encode()).hexdigest()
    return re.sub('"sha256":"[0-9a-f]{64}"', f'"sha256":"{found}"', text, count=1)


def test_a_body_that_is_no_json_is_one_line(text):
    changed = with_hash(text.rstrip()[:-2] + "]}")
    with pytest.raises(ModelError) as error:
        parse_model(changed, "model.json")
    assert str(error.value).startswith("model.json: ") and "\n" not in str(error.value)


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
        ('{"format": "ema_phm model", "version": 6, "body": {}, "sha256": "0"}', "hash"),
        ('{"format": "ema_phm model", "version": 6, "body": NaN}', "not JSON"),
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


@pytest.mark.parametrize("name", ["0123", "0123456789ABCDEF", 12, None])
def test_an_actuator_that_is_no_hash(text, name):
    refused(text, lambda body: body.update(actuator=name))


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


@pytest.mark.parametrize("name", ["input_scale", "spread", "template_re"])
def test_networks_that_give_no_number_do_not_call_a_record_healthy(shipped, name):
    """Finite, above 0, and of the right shape, but what comes out is none of it."""
    small = 0.0 if "template" in name else 5e-324

    def changed(value):
        if isinstance(value, dict):
            return {k: changed(v) if k != name else [small] * len(v)
                    for k, v in value.items()}
        return value

    body = changed({"views": shipped.body.views["step/fleet"].model_dump()})["views"]
    if name == "template_re":
        body["lines"]["template_im"] = body["lines"]["template_re"]
    cascade = Cascade(ViewPart.model_validate(body))
    with pytest.raises(ModelError, match="no number"):
        cascade.find(np.full((1, len(cascade.view.names)), 0.1))
