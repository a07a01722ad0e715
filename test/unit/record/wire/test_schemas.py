"""Definitions and hashes from the type store against the installed ROS packages."""

import json
import re
import sys
from pathlib import Path

import pytest
import yaml
from rosbags.rosbag2.metadata import parse_qos

from ema_record.bag.metadata import channel_metadata
from ema_record.version import VERSION
from ema_record.wire.topics import BAG_TOPICS, TOPICS
from ema_record.wire.types import definition, type_hash

SHARE = Path(sys.prefix) / "share"
TYPES = sorted({topic.type for topic in TOPICS.values()})
SEPARATOR = "=" * 80


def fields_of(text):
    """Return the (type, name) pairs of a .msg text, constants and comments left out."""
    pairs = []
    for line in text.splitlines():
        words = line.split("#")[0].split()
        if len(words) >= 2 and "=" not in line.split("#")[0]:
            pairs.append((words[0].split("<=")[0], words[1]))
    return pairs


def constants_of(text):
    found = re.findall(r"^\s*(\w+)\s+(\w+)\s*=\s*([^#\n]+)", text, flags=re.MULTILINE)
    return {(kind, name, value.strip()) for kind, name, value in found}


def installed(message_type, suffix):
    package, _, name = message_type.split("/")
    return (SHARE / package / "msg" / f"{name}{suffix}").read_text()


def qualified(kind, package):
    """Return a field type with its package, as the joined definitions write it."""
    base = kind.split("[")[0]
    if base == "Header":
        return kind.replace("Header", "std_msgs/Header")
    return f"{package}/{kind}" if base[0].isupper() and "/" not in base else kind


@pytest.mark.parametrize("message_type", TYPES)
def test_hash_equals_the_installed_one(message_type):
    hashes = {
        entry["type_name"]: entry["hash_string"]
        for entry in json.loads(installed(message_type, ".json"))["type_hashes"]
    }
    assert type_hash(message_type) == hashes[message_type]


@pytest.mark.parametrize("message_type", TYPES)
def test_definition_equals_the_installed_one(message_type):
    """Every part: the same fields in the same order, the same constants; nothing missing."""
    main, *others = definition(message_type).split(SEPARATOR + "\n")
    parts = {message_type: main}
    for other in others:
        head, text = other.split("\n", 1)
        package, name = head.removeprefix("MSG: ").split("/")
        parts[f"{package}/msg/{name}"] = text
    for name, text in parts.items():
        package = name.split("/")[0]
        theirs = installed(name, ".msg")
        assert fields_of(text) == [(qualified(k, package), n) for k, n in fields_of(theirs)]
        assert constants_of(text) == constants_of(theirs)
    description = json.loads(installed(message_type, ".json"))["type_description_msg"]
    used = {d["type_name"] for d in description["referenced_type_descriptions"]}
    assert set(parts) == used | {message_type}


@pytest.mark.parametrize("topic", BAG_TOPICS, ids=lambda topic: topic.name)
def test_offered_qos_is_what_readers_expect(topic):
    text = channel_metadata(topic)["offered_qos_profiles"]
    assert len(yaml.safe_load(text)) == 1
    (parsed,) = parse_qos(text)
    assert parsed.reliability.name.lower() == topic.qos.reliability
    assert parsed.durability.name.lower() == topic.qos.durability
    assert parsed.history.name.lower() == topic.qos.history
    assert parsed.depth == topic.qos.depth


def test_version_is_that_of_the_package(repository):
    assert f"<version>{VERSION}</version>" in (repository / "package.xml").read_text()
    assert f'version="{VERSION}"' in (repository / "setup.py").read_text()
