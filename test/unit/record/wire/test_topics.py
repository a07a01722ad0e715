"""Names of topics under the namespace of an actuator, and records from there."""

import dataclasses

import pytest

from ema_prognostics.verdict.judge import Judge
from ema_record.bag.read import read_bag, write_bag
from ema_record.bag.recover import recover_bag
from ema_record.bag.writer import BagWriter, RawBag
from ema_record.errors import InvalidRecordError, UsageError
from ema_record.profile import load_profile
from ema_record.record import Provenance
from ema_record.wire.samples import encode_block
from ema_record.wire.topics import (
    SAMPLES,
    TOPICS,
    WEIGHT_ON_WHEELS,
    checked_namespace,
    name_on_graph,
    relative_name,
    split_name,
)
from ema_sim.simulate import simulate

LEFT = "/left_aileron"


@pytest.mark.parametrize("topic", TOPICS)
@pytest.mark.parametrize("namespace", ["", LEFT, "/ema", "/aircraft/wing_2/left"])
def test_names_go_there_and_back(topic, namespace):
    name = name_on_graph(topic, namespace)
    shared = topic in (WEIGHT_ON_WHEELS, "/diagnostics")
    assert split_name(name) == ("" if shared else namespace, topic)
    assert relative_name(topic).startswith("/") == shared


def test_other_names_are_left_alone():
    for name in ("/left/ema/other", "/samples", "/emax/samples", "/left_aileron/aircraft/x"):
        assert split_name(name) == ("", name)


@pytest.mark.parametrize(("name", "namespace"), [
    ("left_aileron", LEFT), (LEFT, LEFT), ("", ""), ("/", ""), ("wing/left", "/wing/left"),
])
def test_a_name_is_a_namespace(name, namespace):
    assert checked_namespace(name) == namespace


@pytest.mark.parametrize("name", [
    "left aileron", "2nd", "a//b", "a__b", "é", "a/", "x" * 90, "a;b", "../x", "a\n",
])
def test_what_ros_refuses_is_refused(name):
    with pytest.raises(UsageError, match="not the name of a ROS namespace"):
        checked_namespace(name)


@pytest.fixture(scope="module")
def record():
    found = simulate(load_profile("step"), seed=2)
    return dataclasses.replace(
        found, provenance=dataclasses.replace(found.provenance, namespace=LEFT))


def test_a_record_under_a_namespace_reads_as_any_and_keeps_its_name(record, tmp_path):
    bag = write_bag(record, tmp_path / "bag")
    found = read_bag(bag)
    assert (found.samples == record.samples).all()
    assert found.provenance.name == "left_aileron"
    assert "name: /left_aileron/ema/samples\n" in (bag / "metadata.yaml").read_text()
    verdict = Judge().of_bag(bag).verdict.to_dict()
    assert (verdict["actuator"], verdict["verdict"]) == ("left_aileron", "healthy")


def test_a_record_without_one_is_written_as_ever(record, tmp_path):
    plain = dataclasses.replace(
        record, provenance=dataclasses.replace(record.provenance, namespace=""))
    bag = write_bag(plain, tmp_path / "bag")
    assert "left_aileron" not in (bag / "metadata.yaml").read_text()
    assert "actuator" not in Judge().of_bag(bag).verdict.to_dict()


def test_a_cut_record_is_recovered_under_its_namespace(record, tmp_path):
    writer = BagWriter(
        tmp_path / "cut", profile=record.profile, provenance=Provenance(namespace=LEFT))
    for first in range(0, 9000, 400):
        writer.write_raw(SAMPLES, encode_block(record.samples[first:first + 400]), 5 + first)
    writer.flush()
    assert recover_bag(tmp_path / "cut").samples == 9000
    assert read_bag(tmp_path / "cut_recovered").provenance.namespace == LEFT
    writer.close()


def test_a_bag_of_two_actuators_is_refused_by_their_names(record, tmp_path):
    both = [dataclasses.replace(TOPICS[SAMPLES], name=name_on_graph(SAMPLES, namespace))
            for namespace in (LEFT, "/right_aileron")]
    bag = RawBag(tmp_path / "both", topics=both, records={})
    for topic in both:
        bag.write_raw(topic.name, encode_block(record.samples[:400]), 5)
    bag.finish({}, {})
    with pytest.raises(InvalidRecordError, match=r"\(/left_aileron, /right_aileron\)"):
        read_bag(tmp_path / "both")
