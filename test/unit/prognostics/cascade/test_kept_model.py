"""The model that is kept in the cache: the same numbers as the file's, and only for that file."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from ema_prognostics.cascade import kept_model as kept
from ema_prognostics.cascade.kept_model import kept_model
from ema_prognostics.cascade.model_body import DiscrepancyPart
from ema_prognostics.cascade.model_file import load_model
from ema_record.array_cache import load, save
from ema_record.errors import ModelError
from ema_record.kit import CASCADE, kit_path, using_kit


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "ema_phm"


@pytest.fixture
def unread(monkeypatch):
    def refuse(*_args):
        raise AssertionError("the file was read")

    return lambda: monkeypatch.setattr(kept, "load_model", refuse)


def test_a_kept_model_says_what_the_file_says(cache, unread):
    first = kept_model()
    assert len(list(cache.glob("*.npz"))) == 1
    unread()
    again = kept_model()
    assert again.sha256 == first.sha256 and again.training == first.training
    assert set(again.cascades) == set(first.cascades)
    rng = np.random.default_rng(3)
    for name, cascade in first.cascades.items():
        other = again.cascades[name]
        assert other is again.cascades[name]  # built once
        x = rng.normal(size=(40, len(cascade.view.names)))
        for one, two in zip(cascade.find(x), other.find(x), strict=True):
            assert one.outputs == two.outputs and one.severity == two.severity
            assert one.known == two.known and one.stranger_kind == two.stranger_kind
            for part in ("probability", "margin", "guard"):
                np.testing.assert_array_equal(getattr(one, part), getattr(two, part))
    for name, network in first.paper.ann_b.items():
        np.testing.assert_array_equal(network.hidden_weights,
                                      again.paper.ann_b[name].hidden_weights)


def test_the_body_of_a_type_with_a_discrepancy_and_without_the_paper(cache):
    model = load_model()
    left = DiscrepancyPart(names=["a", "b"], mean=[0.5, -1.0], spread=[1.0, 2.0])
    body = model.body.model_copy(
        update={"paper": None, "actuator": "0" * 16, "discrepancy": {"step": left}})
    save("model_x", kept._packed(replace(model, body=body), "file"))
    found = kept._unpacked("model_x", "file")
    assert found.paper is None and found.body.actuator == "0" * 16
    assert found.body.discrepancy["step"].names == left.names
    assert list(found.body.discrepancy["step"].mean) == left.mean
    assert kept._unpacked("model_x", "another file") is None


def test_a_file_that_is_named_is_read_itself(cache):
    assert kept_model(kit_path(CASCADE)).sha256 == load_model().sha256
    assert not cache.exists()


def test_what_is_kept_holds_for_the_very_file(cache, tmp_path):
    kit = tmp_path / "kit"
    shutil.copytree(kit_path(CASCADE).parent, kit)
    with using_kit(kit):
        kept_model()
        model = kit / CASCADE
        text = model.read_text()
        model.write_text(text.replace('"sha256":"', '"sha256":"0', 1))
        with pytest.raises(ModelError, match="changed or damaged"):
            kept_model()
        model.unlink()
        with pytest.raises(ModelError, match=f"has no {CASCADE}"):
            kept_model()
        model.symlink_to(CASCADE)  # which leads nowhere but to itself
        with pytest.raises(ModelError, match=f"has no {CASCADE}"):
            kept_model()


def spoil_tree(arrays, change):
    tree = json.loads(arrays["tree"].tobytes())
    change(tree)
    return arrays | {"tree": np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8)}


SPOILT = {
    "other software": lambda a: spoil_tree(a, lambda t: t.update(layout=["x", "0"])),
    "no body": lambda a: spoil_tree(a, lambda t: t.pop("body")),
    "a field less": lambda a: spoil_tree(a, lambda t: t["body"].pop("views")),
    "a field more": lambda a: spoil_tree(a, lambda t: t["body"].update(more=1)),
    "numbers cut": lambda a: a | {"numbers": a["numbers"][:1000]},
    "whole numbers": lambda a: a | {"numbers": a["numbers"].astype(int)},
    "no numbers": lambda a: {"tree": a["tree"]},
    "no JSON": lambda a: a | {"tree": a["tree"][:-5]},
    "a scalar": lambda a: a | {"tree": np.frombuffer(b"7", dtype=np.uint8)},
}


@pytest.mark.parametrize("how", SPOILT)
def test_what_is_spoilt_counts_as_absent_and_is_kept_anew(how, cache, unread):
    expected = kept_model().sha256
    (file,) = cache.glob("*.npz")
    save(file.stem, SPOILT[how](load(file.stem)))  # of the hash that it says
    assert kept_model().sha256 == expected
    unread()
    assert kept_model().sha256 == expected  # whole again


@pytest.mark.parametrize("change", [lambda x: x * np.nan, lambda x: x[::-1]])
def test_other_numbers_than_were_kept_are_never_judged_with(change, cache):
    expected = kept_model().cascades["step/fleet"].view.center
    (file,) = cache.glob("*.npz")
    with np.load(file) as whole:
        arrays = dict(whole)
    np.savez(file, **arrays | {"numbers": change(arrays["numbers"])})
    assert list(kept_model().cascades["step/fleet"].view.center) == list(expected)


def test_a_damaged_file_of_the_cache_is_no_error(cache):
    expected = kept_model().sha256
    (file,) = cache.glob("*.npz")
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1  # caught by the checksum of the archive
    file.write_bytes(data)
    assert kept_model().sha256 == expected


def test_where_nothing_can_be_kept_the_file_serves(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert kept_model().sha256 == load_model().sha256


def test_only_the_newest_are_kept(cache):
    for number in range(20):
        save(f"model_{number:032d}", {"tree": np.zeros(1)})
    kept_model()
    names = {file.stem for file in cache.glob("*.npz")}
    assert len(names) == kept.MOST_KEPT
    assert f"model_{19:032d}" in names and f"model_{0:032d}" not in names
