"""Paths and names inside of bags and settings lead nowhere but where they belong."""

import shutil
from dataclasses import replace

import pytest
import yaml

from ema_monitor.recorder import new_bag_path
from ema_record.bag.any_topic import list_topics
from ema_record.bag.read import read_bag, write_bag
from ema_record.bag.recover import recover_bag
from ema_record.bag.writer import BagWriter
from ema_record.errors import InvalidRecordError, UsageError
from ema_record.profile import load_profile, load_profile_dict
from ema_record.record import Provenance


def everything(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def with_files(copy, *names):
    """Let ``metadata.yaml`` name other files."""
    place = copy / "metadata.yaml"
    data = yaml.safe_load(place.read_text())
    data["rosbag2_bagfile_information"]["relative_file_paths"] = list(names)
    place.write_text(yaml.safe_dump(data))


@pytest.mark.parametrize("kind", ["parent", "deep", "absolute", "link", "folder link", "nothing"])
def test_paths_of_a_bag_stay_in_the_bag(bag, tmp_path, kind):
    (tmp_path / "in").mkdir()
    copy = shutil.copytree(bag, tmp_path / "in" / "bag")
    outside = tmp_path / "outside"
    outside.mkdir()
    shutil.copy(bag / "healthy_0.mcap", outside / "other.mcap")
    if kind == "link":
        (copy / "other.mcap").symlink_to(outside / "other.mcap")
    elif kind == "folder link":
        (copy / "sub").symlink_to(outside)
    with_files(copy, {
        "parent": "../../outside/other.mcap", "deep": "a/../../../outside/other.mcap",
        "absolute": str(outside / "other.mcap"), "link": "other.mcap",
        "folder link": "sub/other.mcap", "nothing": "..",
    }[kind])
    before = everything(tmp_path)
    with pytest.raises(InvalidRecordError, match=r"missing|link out of the bag"):
        read_bag(copy)
    assert everything(tmp_path) == before


def test_a_link_to_a_bag_is_a_bag(bag, tmp_path, record):
    (tmp_path / "link").symlink_to(bag)
    assert len(read_bag(tmp_path / "link")) == len(record)


@pytest.mark.parametrize("serial", ["../../evil", "/etc/cron.d/x", "..", "a/b", "a\0b", "",
                                    "C:\\x", "~root", "x" * 500, "$(reboot)", "-rf"])
def test_names_from_outside_make_no_path(tmp_path, serial):
    folder = tmp_path / "records"
    path = new_bag_path(folder, serial, 10**18, load_profile("step").name)
    assert path.parent == folder
    assert path.resolve().parent == folder.resolve()
    assert len(path.name) < 100
    with BagWriter(path, profile=load_profile("step"),
                   provenance=Provenance(serial_number=serial.replace("\0", ""))) as writer:
        writer.close()
    assert {p.parent for p in tmp_path.rglob("*") if p.is_file()} == {path}


@pytest.mark.parametrize("name", ["../x", "/abs", "a/b", "a\\b", "", "x" * 65, "a\nb"])
def test_names_of_profiles_are_plain(name):
    with pytest.raises(UsageError, match="name"):
        load_profile_dict({"name": name, "points": [[0.1, 0.0]]}, "here")


def test_recovery_writes_beside_the_bag_whatever_the_bag_says(tmp_path, make):
    (tmp_path / "in").mkdir()
    record = replace(make(2000), provenance=Provenance(serial_number="../../evil"))
    bag = write_bag(record, tmp_path / "in" / "bag")
    (bag / "metadata.yaml").unlink()
    before = everything(tmp_path)
    report = recover_bag(bag)
    new = everything(tmp_path)
    assert before.items() <= new.items()
    made = {path.parent for path in new.keys() - before.keys()}
    assert made == {tmp_path / "in" / "bag_recovered"}
    assert read_bag(report.bag).provenance.serial_number == "../../evil"


@pytest.mark.parametrize("read", [read_bag, list_topics])
def test_a_file_that_metadata_do_not_name_is_not_left_out_unseen(bag, tmp_path, read):
    copy = shutil.copytree(bag, tmp_path / "copy")
    own, = copy.glob("*.mcap")
    (copy / f"._{own.name}").touch()
    (copy / f"{own.name}.zstd").touch()  # what a player has unpacked beside itself
    read(copy)
    shutil.copy(own, copy / "second_1.mcap")
    with pytest.raises(InvalidRecordError, match=r"second_1.mcap: not named by metadata.yaml: m"):
        read(copy)


@pytest.mark.parametrize("copies", [2, 3])
def test_files_joined_to_one_are_not_left_out_unseen(bag, tmp_path, copies):
    joined = tmp_path / "joined.mcap"
    joined.write_bytes(copies * (bag / "healthy_0.mcap").read_bytes())
    with pytest.raises(InvalidRecordError, match="another file is joined to its end"):
        read_bag(joined)
