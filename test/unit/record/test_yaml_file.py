"""YAML that people write: bounded, one clear line with the place of the error."""

import re

import pytest

from ema_record.actuator import load_actuator
from ema_record.errors import UsageError
from ema_record.yaml_file import load_yaml


def written(tmp_path, text):
    path = tmp_path / "a.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_what_is_written_is_read(tmp_path):
    path = written(tmp_path, "name: step\npoints: [[0.0, -0.4], [1e-3, 0.4]]\nwindow: null\n")
    assert load_yaml(path) == {
        "name": "step", "points": [[0.0, -0.4], [1e-3, 0.4]], "window": None,
    }


def test_a_number_with_an_exponent_is_one_however_it_is_written(tmp_path):
    path = written(tmp_path, "[1e9, 1.0e9, -.5E3, 1.e-3, +2e+5, '1e9', 1e, e5, 0x1e3]")
    assert load_yaml(path) == [1e9, 1e9, -500.0, 1e-3, 2e5, "1e9", "1e", "e5", 0x1e3]


def test_one_name_in_several_places_is_no_key_twice(tmp_path):
    path = written(tmp_path, "a: {b: a, c: {a: b, b: b}}\nb: [a, a, {a: b}, {a: b}]\nc: a\n")
    assert load_yaml(path) == {"a": {"b": "a", "c": {"a": "b", "b": "b"}},
                               "b": ["a", "a", {"a": "b"}, {"a": "b"}], "c": "a"}


def test_a_text_in_quotes_and_zeros_are_no_numbers_of_another_base(tmp_path):
    assert load_yaml(written(tmp_path, f"'{'9' * 500}'")) == "9" * 500
    path = written(tmp_path, "['010', \"1:30\", 0, 0.0, -0, 00.5, 2026-11-30, a:1, 1:x, 1.2.3]")
    assert load_yaml(path)[:6] == ["010", "1:30", 0, 0.0, 0, 0.5]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("a: [1, 2\nb: 3", "line 2: malformed YAML"),
        ("a: 1\n  b: 2", "line 2: malformed YAML: mapping values are not allowed"),
        ("a: &x [1]\nb: *x\n", "line 2: malformed YAML: aliases are not allowed"),
        ("a: !!python/object/apply:os.system [ls]", "the tag .*os.system. is not allowed"),
        ("[" * 5000, "malformed YAML"),
        ("[" * 60 + "]" * 60, "nested deeper than 50 levels"),
        ("a:\n  b: 1\n  c: 2\n  b: 3\n", "line 4: malformed YAML: 'b' stands there twice"),
        ("[{a: 1, 'a': 2}]", "line 1: malformed YAML: 'a' stands there twice"),
        ("b: 1\na: {1: 2, 0x1: 3}", "line 2: malformed YAML: '0x1' stands there twice"),
        ("1: a\n1.0: b", "line 2: malformed YAML: '1.0' stands there twice"),
        ("[1: a, {1: a, '1': b}]", "line 1: malformed YAML: '1' stands there twice"),
        ("a: 1\n---\nb: 2\n", "but found another document"),
        ("a: 2026-13-45", "malformed YAML"),
        *((f"b: 0.5\na: {x}", f"line 2: malformed YAML: '{re.escape(x)}' could be a number")
          for x in ("1:30", "010", "-1:30:30.5", "+0_7")),
        *((f"b: 1\na: {x}", f"line 2: malformed YAML: a number of {len(x)} characters, at")
          for x in ("9" * 5000, "-0x" + "f" * 5000, "0b" + "1" * 9000, "1" + "0" * 400)),
        (b"\xff\xfe\xfa", "not UTF-8"),
        ("a: \x00", "malformed YAML"),
        ("a: !!bool foo", "the tag .*bool' is not allowed"),
        ("a: !!timestamp foo", "the tag .*timestamp' is not allowed"),
        ('a: !!int ""', "the tag .*int' is not allowed"),
        ("x" * (2 << 20), "at most 1048576"),
    ],
)
def test_errors_are_one_line(tmp_path, text, match):
    with pytest.raises(UsageError, match=match) as caught:
        load_yaml(written(tmp_path, text))
    assert "\n" not in str(caught.value) and str(tmp_path / "a.yaml") in str(caught.value)


def test_missing_file(tmp_path):
    with pytest.raises(UsageError, match="No such file"):
        load_yaml(tmp_path / "nothing.yaml")
    with pytest.raises(UsageError, match="a zero byte in the name"):
        load_yaml(tmp_path / "a\0.yaml")


def test_the_description_of_an_actuator_keeps_the_nominal_values_that_it_does_not_name(tmp_path):
    path = written(tmp_path, "gear: {ratio: 300}\neffects: {backlash: {increase: 0.01}}\n")
    changed, nominal = load_actuator(path), load_actuator()
    assert changed.gear.ratio == 300.0
    assert changed._replace(gear=nominal.gear) == nominal
    assert changed.slew_speed == pytest.approx(nominal.slew_speed * nominal.gear.ratio / 300.0)


@pytest.mark.parametrize(("text", "match"), [
    ("gears: {ratio: 300}", "did you mean 'gear'"),
    ("gear: {ration: 300}", "did you mean 'ratio'"),
    ("gear: {ratio: 0.5}", "gear: ratio.*greater than or equal to 1"),
    ("motor: {pole_pairs: 1.5}", "pole_pairs"),
    ("acquisition: {rate: .nan}", "rate"),
    ("gear: 300", "gear: expected parameters and values"),
    ("- 1", "expected sections"),
])
def test_a_wrong_description_is_one_line(tmp_path, text, match):
    with pytest.raises(UsageError, match=match) as caught:
        load_actuator(written(tmp_path, text))
    assert "\n" not in str(caught.value)
