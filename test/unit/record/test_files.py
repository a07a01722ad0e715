"""Output files never replace anything; input files are read with a bound, whatever they are."""

import contextlib
import errno
import os

import pytest

from ema_prognostics.cascade.model_file import load_model
from ema_record.errors import ModelError, OutputError, UsageError
from ema_record.files import new_file, read_bounded
from ema_record.yaml_file import load_yaml
from ema_sim.campaign.store import MANIFEST, read_manifest


def test_a_name_that_is_taken_meanwhile_stays_as_it_is(tmp_path):
    path = tmp_path / "a.csv"
    with pytest.raises(OutputError, match="never overwritten"), new_file(path) as temporary:
        temporary.write_text("ours")
        path.write_text("of somebody else")
    assert path.read_text() == "of somebody else"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("taken", [False, True])
def test_nothing_is_replaced_where_files_have_no_second_name(tmp_path, monkeypatch, taken):
    """As on FAT, which knows no links."""
    def refused(*_):
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "link", refused)
    path = tmp_path / "a.csv"
    with contextlib.suppress(OutputError), new_file(path) as temporary:
        temporary.write_text("ours")
        if taken:
            path.write_text("of somebody else")
    assert path.read_text() == ("of somebody else" if taken else "ours")
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_that_points_nowhere_is_not_replaced(tmp_path):
    path = tmp_path / "a.csv"
    path.symlink_to(tmp_path / "nowhere")
    with pytest.raises(OutputError, match="never overwritten"), new_file(path):
        pass
    assert path.is_symlink() and not path.exists()


def test_a_folder_that_is_missing_is_told_as_that(tmp_path):
    with pytest.raises(OutputError, match=r"No such file or directory\): make its folder first"), (
            new_file(tmp_path / "none" / "a.csv")):
        pass


def test_a_name_that_is_too_long_is_told_as_that(tmp_path):
    with pytest.raises(OutputError, match=r"File name too long\): choose a shorter name"), (
            new_file(tmp_path / ("x" * 250))):
        pass


def test_a_planted_link_is_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / f".a.csv.{os.getpid()}.tmp").symlink_to(victim)
    with new_file(tmp_path / "a.csv") as temporary:
        temporary.write_text("ours")
    assert victim.read_text() == "precious" and (tmp_path / "a.csv").read_text() == "ours"


def test_a_new_file_has_the_usual_permissions(tmp_path):
    with new_file(tmp_path / "a") as temporary:
        temporary.write_text("")
    (tmp_path / "b").write_text("")
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode


def test_what_fails_leaves_nothing_behind(tmp_path):
    with pytest.raises(RuntimeError), new_file(tmp_path / "a") as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_the_bound_is_exact(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_bounded(path, 5) == b"12345"
    with pytest.raises(OSError, match="at most 4 bytes"):
        read_bounded(path, 4)


@pytest.fixture(params=["device", "pipe", "folder"])
def endless(request, tmp_path):
    """Something that is no file: it has no end, or keeps its reader waiting."""
    place = tmp_path / "a.yaml"
    if request.param == "pipe":
        os.mkfifo(place)
    elif request.param == "folder":
        place.mkdir()
    else:
        place.symlink_to("/dev/zero")
    return place


@pytest.mark.timeout(20)
def test_what_is_no_file_is_refused_at_once(endless, tmp_path):
    why = "not a regular file|Is a directory"
    with pytest.raises(UsageError, match=why):
        load_yaml(endless)
    with pytest.raises(ModelError, match=why):
        load_model(endless)
    (tmp_path / MANIFEST).symlink_to(endless)
    with pytest.raises(UsageError, match=why):
        read_manifest(tmp_path)
