"""Which paths are bags, and which folders hold them."""

from pathlib import Path

import pytest

from ema_record.bag.find import bags_of, is_sequence, natural, what_else


def test_names_sort_by_their_numbers():
    names = ["f10", "f9", "f_2b", "f_10a", "10", "9"]
    assert sorted(names, key=natural) == ["9", "10", "f9", "f10", "f_2b", "f_10a"]


def test_what_is_a_sequence(tmp_path):
    def touch(name):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()

    touch("bag/metadata.yaml")
    touch("cut/cut_0.mcap")
    touch("cut_split/cut_split_0.mcap")
    touch("cut_split/cut_split_1.mcap")
    touch("cut_renamed/rosbag2_0.mcap")
    touch("flights/one/one_0.mcap")
    touch("files/a.mcap")
    touch("files/b.mcap")
    touch("other/notes.txt")
    (tmp_path / "empty").mkdir()
    found = {p.name for p in tmp_path.iterdir() if is_sequence(p)}
    assert found == {"flights", "files"}
    assert not is_sequence(tmp_path / "none")


@pytest.mark.parametrize(("name", "content", "expected"), [
    ("README.md", b"# Bags", "a text file, no bag"), ("empty.txt", b"", "empty, no bag"),
    ("image.png", b"\x89PNG\r\n\x1a\n\0\0", "a file of another kind, no bag"),
    ("damaged.mcap", b"nothing", None), ("renamed", b"\x89MCAP0\r\n\0", None),
])
def test_what_a_file_is_that_is_no_bag(tmp_path, name, content, expected):
    (tmp_path / name).write_bytes(content)
    assert what_else(tmp_path / name) == expected


def test_what_a_directory_is_that_is_no_bag(tmp_path):
    assert what_else(tmp_path) == "an empty directory"
    assert what_else(tmp_path / "none") == "no such file or directory"
    assert what_else(Path("/dev/null")) == "neither file nor directory"
    (tmp_path / "notes.txt").touch()
    assert what_else(tmp_path) == "a directory that is no bag"
    (tmp_path / "cut_0.mcap").touch()
    assert what_else(tmp_path) is None


def test_damaged_bags_are_flights_and_other_things_are_named(tmp_path):
    for name in ("f2/metadata.yaml", "f10/f10_0.mcap", "notes/a.txt", ".hidden/metadata.yaml"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).touch()
    (tmp_path / "f3").mkdir()
    (tmp_path / "readme.txt").touch()
    found, others = bags_of(tmp_path)
    assert [p.name for p in found] == ["f2", "f3", "f10"]
    assert [p.name for p in others] == ["notes", "readme.txt"]
