"""Bags of ROS 2 through `ema import`: both storages, joints, any message, and what is refused."""

import sqlite3
import struct
from contextlib import closing

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ema_cli.main import run
from ema_record.errors import IncompleteRecordError, InvalidRecordError, UsageError
from ema_rig.bag import read_rig_bag
from ema_rig.guess import guess_map
from ema_rig.import_file import import_file
from ema_rig.map import map_from

N, RATE, EPOCH = 400, 100.0, 1_700_000_000_000_000_000
STORAGES = [StoragePlugin.MCAP, StoragePlugin.SQLITE3]
DYNAMIC = """std_msgs/Header header
string[] joint_names
control_msgs/InterfaceValue[] interface_values
"""
INTERFACE = "string[] interface_names\nfloat64[] values\n"
MOTOR = "builtin_interfaces/Time when\nDrive[2] drive\nfloat32 bus\n"
DRIVE = "int16 current\nfloat64[] more\n"


def store():
    """Return the types of Jazzy, of control_msgs and of a maker."""
    types = get_typestore(Stores.ROS2_JAZZY)
    for name, text in {"control_msgs/msg/InterfaceValue": INTERFACE,
                       "control_msgs/msg/DynamicJointState": DYNAMIC,
                       "maker_msgs/msg/Drive": DRIVE, "maker_msgs/msg/Motor": MOTOR}.items():
        types.register(get_types_from_msg(text, name))
    return types


TYPES = store()


def make(kind, **values):
    return TYPES.types[kind](**values)


def time_of(ns):
    return make("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)


def header(ns):
    return make("std_msgs/msg/Header", stamp=time_of(ns), frame_id="")


def motion():
    t = np.arange(N) / RATE
    return t, np.sin(3 * t), 3 * np.cos(3 * t), 0.4 * np.sign(np.cos(3 * t))


def joint_state(ns, row, names=("wrist", "elbow"), **more):
    values = {f: np.array([7.0, x]) for f, x in zip(("position", "velocity", "effort"), row)}
    return make("sensor_msgs/msg/JointState", header=header(ns), name=list(names),
                **{**values, **more})


def dynamic(ns, row, kinds=("position", "velocity", "current")):
    inner = [make("control_msgs/msg/InterfaceValue", interface_names=list(kinds),
                  values=np.array(row) * scale) for scale in (0.0, 1.0)]
    return make("control_msgs/msg/DynamicJointState", header=header(ns),
                joint_names=["wrist", "elbow"], interface_values=inner)


def motor(ns, row):
    drives = [make("maker_msgs/msg/Drive", current=int(c), more=np.array([c, 2 * c]))
              for c in (0, 1000 * row[2])]
    return make("maker_msgs/msg/Motor", when=time_of(ns), drive=drives, bus=24.0)


def bag(path, storage, messages, late=0):
    """Write (topic, type, log time, message) as a bag by the library of others."""
    with Writer(path, version=9, storage_plugin=storage) as writer:
        connections = {}
        for topic, kind, ns, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            writer.write(connections[topic], ns + late, TYPES.serialize_cdr(message, kind))
    return path


def joints(make_message=joint_state, kind="sensor_msgs/msg/JointState", topic="/joint_states"):
    t, *signals = motion()
    return [(topic, kind, EPOCH + round(1e9 * at),
             make_message(EPOCH + round(1e9 * at), [s[k] for s in signals]))
            for k, at in enumerate(t)]


def check(record, drive="input_torque"):
    t, q, v, e = motion()
    assert [c.name for c in record.channels] == ["time", drive, "position", "speed"]
    np.testing.assert_allclose(record.time, t, atol=2e-9)
    np.testing.assert_array_equal(record.channel("position"), q)
    np.testing.assert_array_equal(record.channel("speed"), v)
    np.testing.assert_array_equal(record.input, e)


@pytest.mark.parametrize("storage", STORAGES)
def test_a_joint_of_a_joint_state_needs_no_map(tmp_path, storage, capsys):
    path = bag(tmp_path / "run", storage, joints(), late=5_000_000)
    assert run(["import", str(path), "--topic", "/joint_states", "--joint", "elbow", "--out",
                str(tmp_path / "elbow")]) == 0
    said = capsys.readouterr()
    assert "time is that of the headers" in said.err
    assert "a rotary joint in rad, rad/s and N m" in said.err
    check(read_rig_bag(tmp_path / "elbow"))


def test_a_sliding_joint_is_in_metres_and_newtons(tmp_path, capsys):
    path = bag(tmp_path / "run", StoragePlugin.MCAP, joints())
    assert run(["import", str(path), "--joint", "elbow", "--set", "axis=linear", "--out",
                str(tmp_path / "slide")]) == 0
    record = read_rig_bag(tmp_path / "slide")
    assert [c.label for c in record.channels] == [
        "time[s]", "input_force[N]", "position[m]", "speed[m/s]"]
    assert run(["import", str(path), "--joint", "elbow", "--set", "input.unit=A", "--out",
                str(tmp_path / "amps")]) == 0
    assert read_rig_bag(tmp_path / "amps").channels[1].label == "input_current[A]"


@pytest.mark.parametrize("storage", STORAGES)
def test_a_dynamic_joint_state_with_a_current(tmp_path, storage):
    path = bag(tmp_path / "run", storage,
               joints(dynamic, "control_msgs/msg/DynamicJointState", "/dynamic_joint_states"))
    check(import_file(path, map_from(guess_map(path, None, "elbow").data, "g")), "input_current")


def test_a_dynamic_joint_state_that_lists_a_joint_without_values(tmp_path):
    def empty(ns, row):
        message = dynamic(ns, row)
        message.interface_values = message.interface_values[:1]
        return message

    path = bag(tmp_path / "run", StoragePlugin.MCAP,
               joints(empty, "control_msgs/msg/DynamicJointState", "/dynamic_joint_states"))
    with pytest.raises((UsageError, InvalidRecordError)):
        guess_map(path, None, "elbow")


def test_a_sqlite_bag_of_before_iron_holds_no_definitions(tmp_path):
    path = bag(tmp_path / "run", StoragePlugin.SQLITE3,
               joints(dynamic, "control_msgs/msg/DynamicJointState", "/dynamic_joint_states"))
    file = next(path.glob("*.db3"))
    with closing(sqlite3.connect(file)) as database:
        database.execute("DROP TABLE message_definitions")
    check(import_file(file, map_from(guess_map(file, None, "elbow").data, "g")), "input_current")
    path = bag(tmp_path / "own", StoragePlugin.SQLITE3, [
        ("/motor", "maker_msgs/msg/Motor", EPOCH, motor(EPOCH, (1, 2, 3)))])
    file = next(path.glob("*.db3"))
    with closing(sqlite3.connect(file)) as database:
        database.execute("DROP TABLE message_definitions")
    with pytest.raises(UsageError, match="no definition of 'maker_msgs/msg/Motor'"):
        guess_map(file, "/motor")


@pytest.mark.parametrize("storage", STORAGES)
def test_fields_of_any_message_and_of_another_topic_at_another_rate(tmp_path, storage):
    t, q, v, e = motion()
    slow = [("/motor", "maker_msgs/msg/Motor", EPOCH + round(1e9 * t[k]),
             motor(EPOCH + round(1e9 * t[k]), (q[k], v[k], e[k]))) for k in range(0, N, 4)]
    both = sorted([*joints(), *slow], key=lambda row: row[2])
    path = bag(tmp_path / "run", storage, both)
    data = {**guess_map(path, "/joint_states", "elbow").data,
            "input": {"column": "/motor:drive[1].current", "unit": "mA"}}
    record = import_file(path, map_from(data, "map"))
    np.testing.assert_allclose(record.time, t[::4], atol=2e-9)
    np.testing.assert_allclose(record.input, np.trunc(1000 * e[::4]) / 1000, atol=1e-12)
    np.testing.assert_allclose(record.channel("position"), q[::4], atol=1e-6)
    rates = "columns of different rates (input_current 25, position 100, speed 100 1/s)"
    assert f"{rates} taken at the times of input_current" in record.axis.notes
    assert "time is that of the recorder" in record.axis.notes  # /motor has no header
    data["input"]["column"] = "/motor:drive[1].more[1]"
    np.testing.assert_allclose(import_file(path, map_from(data, "m")).input, 2 * e[::4])


def test_other_joints_on_the_topic_and_unfilled_fields_are_left_out(tmp_path):
    gripper = [(topic, kind, ns + 1, joint_state(ns + 1, (1, 2, 3), names=("left", "right")))
               for topic, kind, ns, _ in joints()]
    nothing = np.full(2, np.nan)
    path = bag(tmp_path / "run", StoragePlugin.MCAP, sorted([
        *gripper, *((t, k, ns, joint_state(ns, (m.position[1], 0, m.effort[1]), velocity=nothing))
                    for t, k, ns, m in joints())], key=lambda row: row[2]))
    guess = guess_map(path, None, "elbow")
    assert "speed" not in guess.data
    assert "/joint_states has no velocity of elbow" in guess.remarks
    record = import_file(path, map_from(guess.data, "g"))
    np.testing.assert_array_equal(record.channel("position"), motion()[1])
    assert "400 of 800 messages on /joint_states are of other joints" in record.axis.notes


def test_equal_stamps_of_a_publisher_that_is_faster_than_its_hardware(tmp_path):
    rows = joints()
    path = bag(tmp_path / "run", StoragePlugin.MCAP, [
        row for t, k, ns, m in rows for row in ((t, k, ns, m), (t, k, ns + 1000, m))])
    record = import_file(path, map_from(guess_map(path, None, "elbow").data, "g"))
    check(record)
    assert "400 rows of a time stamp that was there left out" in record.axis.notes


def spoiled(path):
    """Cut the last message of an MCAP bag of rosbags in its middle."""
    file = next(path.glob("*.mcap"))
    file.write_bytes(file.read_bytes()[:-4000])
    return path


def wrong_bytes(path):
    file = path / "wrong.mcap"
    path.mkdir()
    with file.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        text = TYPES.generate_msgdef("sensor_msgs/msg/JointState", ros_version=2)[0]
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", text.encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        writer.add_message(channel, 1, b"\x00\x01\x00\x00" + struct.pack("<II", 1, 2**31) * 3, 1)
        writer.finish()
    return file


def json_bag(path):
    path.mkdir()
    with (path / "a.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        schema = writer.register_schema("x", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/j", "json", schema), 1, b"{}", 1)
        writer.finish()
    return path / "a.mcap"


@pytest.mark.parametrize(("make_path", "topic", "joint", "error", "match"), [
    (lambda p: bag(p, STORAGES[0], joints()), None, "elbwo", UsageError, "did you mean 'elbow'"),
    (lambda p: bag(p, STORAGES[0], joints()), None, None, UsageError, "one of elbow, wrist"),
    (lambda p: bag(p, STORAGES[1], joints()), "/joints", "x", UsageError, "did you mean '/joint_"),
    (lambda p: bag(p, STORAGES[1], joints(motor, "maker_msgs/msg/Motor", "/motor")), None, None,
     UsageError, r"give --topic, one of /motor \(maker_msgs/msg/Motor, 400\)"),
    (lambda p: bag(p, STORAGES[1], joints(motor, "maker_msgs/msg/Motor", "/motor")), "/motor",
     None, UsageError, "no column looks like the position or speed"),
    (lambda p: spoiled(bag(p, STORAGES[0], joints())), None, "elbow", IncompleteRecordError,
     "was cut"),
    (wrong_bytes, None, "elbow", InvalidRecordError, "are no sensor_msgs/msg/JointState"),
    (json_bag, "/j", None, UsageError, "'json', expected 'cdr'"),
])
def test_bags_that_cannot_be_used_are_one_line(tmp_path, make_path, topic, joint, error, match):
    path = make_path(tmp_path / "run")
    with pytest.raises(error, match=match) as caught:
        guess_map(path, topic, joint)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("content", "match"), [
    (b"no database", "no sqlite3 file"), (b"SQLite format 3\x00" + bytes(200), "sqlite3"),
    (b"", "no sqlite3 file")])
def test_damaged_databases(tmp_path, content, match):
    (tmp_path / "a.db3").write_bytes(content)
    with pytest.raises(InvalidRecordError, match=match):
        guess_map(tmp_path / "a.db3")


def test_a_joint_without_effort_and_a_wrong_field_say_what_to_do(tmp_path):
    rows = [(t, k, ns, joint_state(ns, (1.0, 2.0, 0.0), effort=np.empty(0)))
            for t, k, ns, _ in joints()]
    path = bag(tmp_path / "run", StoragePlugin.MCAP, rows)
    with pytest.raises(UsageError, match=r"an effort .* needed"):
        guess_map(path, None, "elbow")
    other = {"input.column": "wrist.position", "input.unit": "A"}
    assert guess_map(path, None, "elbow", other).data["input"] == {
        "column": "wrist.position", "unit": "A"}
    data = {"name": "a", "axis": "rotary", "bag": {"topic": "/joint_states", "joint": "elbow"},
            "time": {"column": "stamp"}, "input": {"column": "effort", "unit": "N m"},
            "position": {"column": "position", "unit": "rad"}}
    with pytest.raises(UsageError, match="has no 'effort' in any message"):
        import_file(path, map_from(data, "m"))
    data["input"]["column"] = "/motor:current"
    with pytest.raises(UsageError, match="unknown topic '/motor'"):
        import_file(path, map_from(data, "m"))


def test_identify_leads_to_import_and_import_to_identify(tmp_path, capsys):
    path = bag(tmp_path / "run", StoragePlugin.SQLITE3, joints())
    (tmp_path / "a.csv").write_text("t,i,q\n1,2,3\n")
    for given, match in ((path, f"'ema import {path} --topic /joint_states --joint NAME"),
                         (tmp_path / "a.csv", "'ema import")):
        assert run(["identify", str(given), "--out", str(tmp_path / "r")]) == 2
        error = capsys.readouterr().err
        assert match in error
        assert error.count("\n") == 1
    assert not (tmp_path / "r").exists()
