"""`ema import`: text, MAT and NPZ files through a map to a bag and back, and what is refused."""

import dataclasses
import gzip
import io
import pickle
import zipfile

import numpy as np
import pytest
import scipy.io
import yaml

from ema_cli.main import run
from ema_record.bag.read import read_bag, write_bag
from ema_record.channels import CHANNELS
from ema_record.errors import InvalidRecordError, OutputError, RigRecordError, UsageError
from ema_record.profile import load_profile
from ema_rig.bag import is_rig_bag, read_rig_bag, write_rig_bag
from ema_rig.import_file import import_file, read_table
from ema_rig.map import TextFormat, load_map, map_from
from ema_rig.record import RigRecord
from ema_rig.units import UNITS, unit_factor
from ema_sim.simulate import simulate

MAP = {
    "name": "bench", "axis": "rotary", "time": {"column": "t", "unit": "ms"},
    "input": {"column": "i", "unit": "mA"}, "position": {"column": "q", "unit": "deg"},
    "speed": {"column": "w", "unit": "rpm", "scale": -1.0},
}
N = 300


def columns():
    t = np.arange(N) * 2.0
    return {"t": t, "i": 100.0 * np.sin(t / 50), "q": 90.0 * np.cos(t / 70), "w": -t / 10.0}


def text(delimiter=",", head="t,i,q,w\n", comment=""):
    out = io.StringIO()
    np.savetxt(out, np.column_stack(list(columns().values())), delimiter=delimiter, fmt="%.10g")
    return comment + head.replace(",", delimiter) + out.getvalue()


def check(record):
    c = columns()
    assert isinstance(record, RigRecord)
    assert [channel.label for channel in record.channels] == [
        "time[s]", "input_current[A]", "position[rad]", "speed[rad/s]"]
    np.testing.assert_allclose(record.time, c["t"] * 1e-3)
    np.testing.assert_allclose(record.input, c["i"] * 1e-3)
    np.testing.assert_allclose(record.channel("position"), np.deg2rad(c["q"]), atol=1e-9)
    np.testing.assert_allclose(record.channel("speed"), -c["w"] * 2 * np.pi / 60, atol=1e-9)


@pytest.mark.parametrize(("name", "content"), [
    ("comma.csv", text()),
    ("semicolon.csv", text(";")),
    ("tab.txt", text("\t", comment="# made by a bench\n# 2020\n")),
    ("space.dat", text(" ", head="# t,i,q,w\n")),
    ("windows.csv", text().replace("\n", "\r\n")),
    ("blank.csv", "\n\n" + text() + "\n\n"),
    ("units.csv", text(";", head="t,i,q,w\n[ms],[mA],[deg],[rpm]\n")),
    ("bare_units.csv", text("\t", head="t,i,q,w\nms,mA,deg,-\n", comment="Bench 7\n")),
])
def test_text_in_many_layouts(tmp_path, name, content):
    (tmp_path / name).write_bytes(content.encode())
    check(import_file(tmp_path / name, map_from(MAP, "map")))


def test_gzip_mat_and_npz_hold_the_same(tmp_path):
    (tmp_path / "a.txt.gz").write_bytes(gzip.compress(text().encode()))
    scipy.io.savemat(tmp_path / "b.mat", {k: v[:, None] for k, v in columns().items()})
    scipy.io.savemat(tmp_path / "c.mat", {"run": columns()}, do_compression=True)
    np.savez_compressed(tmp_path / "d.npz", **columns())
    with zipfile.ZipFile(tmp_path / "d.npz", "a") as archive:
        archive.writestr("README", "not an array")
    for name in ("a.txt.gz", "b.mat", "d.npz"):
        check(import_file(tmp_path / name, map_from(MAP, "map")))
    np.savez(tmp_path / "e.npz", **{f"run.{k}": v for k, v in columns().items()})
    inside = {k: {**v, "column": f"run.{v['column']}"} if isinstance(v, dict) else v
              for k, v in MAP.items()}
    check(import_file(tmp_path / "c.mat", map_from(inside, "map")))
    check(import_file(tmp_path / "e.npz", map_from(inside, "map")))


def test_decimal_comma_columns_by_number_and_part_of_the_time(tmp_path):
    (tmp_path / "a.csv").write_text(
        text(";", head="").replace(".", ","), encoding="utf-8")
    numbered = {**MAP, "format": {"decimal": ","}, "start": 0.1, "end": 0.2}
    for key, column in (("time", 0), ("input", 1), ("position", 2), ("speed", 3)):
        numbered[key] = {**MAP[key], "column": column}
    record = import_file(tmp_path / "a.csv", map_from(numbered, "map"))
    assert len(record) == 51
    assert "51 of 300 samples" in record.axis.notes[0]


def test_a_gain_turns_volts_into_newtons(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {
        "t": np.arange(N) * 1e-3, "vir": np.ones(N) * 2.0 + np.arange(N), "gtau": 35.0,
        "qm": np.arange(N) * 1.0})
    data = {"name": "e", "axis": "linear", "time": {"column": "t", "unit": "s"},
            "input": {"column": "vir", "unit": "mV", "acts_as": "force", "gain": "gtau"},
            "position": {"column": "qm", "unit": "mm"}}
    record = import_file(tmp_path / "a.mat", map_from(data, "map"))
    assert record.channels[1].label == "input_force[N]"
    assert record.input[0] == pytest.approx(2e-3 * 35.0)
    data["input"]["gain"] = 35.0
    assert np.array_equal(import_file(tmp_path / "a.mat", map_from(data, "map")).samples,
                          record.samples)


def test_empty_cells_gaps_and_jitter_are_said(tmp_path):
    lines = text().split("\n")
    lines[5] = lines[5].replace(lines[5].split(",")[2], "")
    del lines[100:130]
    (tmp_path / "a.csv").write_text("\n".join(lines), encoding="utf-8")
    record = import_file(tmp_path / "a.csv", map_from(MAP, "map"))
    notes = " ".join(record.axis.notes)
    assert "1 row without a value left out" in notes
    assert "1 gap in time" in notes
    assert len(record) == N - 31


def test_the_bag_holds_it_bit_for_bit_and_is_never_overwritten(tmp_path):
    np.savez(tmp_path / "a.npz", **columns())
    record = import_file(tmp_path / "a.npz", map_from(MAP, "map"))
    write_rig_bag(record, tmp_path / "bag")
    back = read_rig_bag(tmp_path / "bag")
    assert np.array_equal(back.samples, record.samples)
    assert (back.channels, back.axis) == (record.channels, record.axis)
    assert is_rig_bag(tmp_path / "bag")
    write_rig_bag(record, tmp_path / "other" / "bag")
    names = ("bag_0.mcap", "metadata.yaml")
    assert [(tmp_path / "bag" / n).read_bytes() for n in names] == [
        (tmp_path / "other" / "bag" / n).read_bytes() for n in names]
    with pytest.raises(OutputError, match="never overwritten"):
        write_rig_bag(record, tmp_path / "bag")
    with pytest.raises(RigRecordError, match="ema identify"):
        read_bag(tmp_path / "bag")


@pytest.mark.parametrize("shift", [1e10, -1e10])
def test_times_that_no_bag_holds_are_refused(shift, tmp_path):
    np.savez(tmp_path / "a.npz", **columns())
    record = import_file(tmp_path / "a.npz", map_from(MAP, "map"))
    far = record.samples + shift * (np.arange(record.samples.shape[1]) == 0)
    with pytest.raises(UsageError, match="count them from the first sample"):
        write_rig_bag(dataclasses.replace(record, samples=far), tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize("command", ["check", "lint", "export"])
def test_a_command_for_the_actuator_names_the_one_for_a_rig(command, tmp_path, capsys):
    np.savez(tmp_path / "a.npz", **columns())
    write_rig_bag(import_file(tmp_path / "a.npz", map_from(MAP, "map")), tmp_path / "bag")
    assert run([command, str(tmp_path / "bag")]) == 2
    captured = capsys.readouterr()
    said = captured.out + captured.err
    assert "'ema identify'" in said
    assert "ema import" not in said


def test_other_tools_read_the_bag(tmp_path):
    from rosbags.rosbag2 import Reader

    np.savez(tmp_path / "a.npz", **columns())
    write_rig_bag(import_file(tmp_path / "a.npz", map_from(MAP, "map")), tmp_path / "bag")
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 1
        assert [c.topic for c in reader.connections] == ["/ema/samples"]


def test_all_channels_of_the_actuator_make_an_ordinary_bag(tmp_path):
    record = simulate(load_profile("step"), seed=3)
    np.savez(tmp_path / "a.npz", **{c.name: record.samples[:, k]
                                    for k, c in enumerate(CHANNELS)})
    data = {"name": "ours", "axis": "actuator", "profile": "step",
            "time": {"column": "time", "unit": "s"},
            "channels": {c.name: {"column": c.name, "unit": c.unit} for c in CHANNELS[1:]}}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    assert run(["import", str(tmp_path / "a.npz"), "--map", str(tmp_path / "map.yaml"),
                "--out", str(tmp_path / "bag")]) == 0
    assert np.array_equal(read_bag(tmp_path / "bag").samples, record.samples)
    write_bag(record, tmp_path / "direct")
    with pytest.raises(InvalidRecordError, match="does not describe a rig"):
        read_rig_bag(tmp_path / "direct")
    assert not is_rig_bag(tmp_path / "direct")
    data |= {"serial_number": "SN-7", "bus_voltage": 91.0, "winding_temperature": 40.0}
    measured = import_file(tmp_path / "a.npz", map_from(data, "map"))
    assert measured.provenance.serial_number == "SN-7"
    assert (measured.dc_bus[:, 1], measured.winding_temperature[:, 1]) == (91.0, 40.0)
    del data["channels"]["rotor_angle"]
    del data["channels"]["phase_current_a"]
    part = import_file(tmp_path / "a.npz", map_from(data, "map"))
    assert [CHANNELS[c].name for c in range(10) if c not in part.columns] == [
        "phase_current_a", "rotor_angle"]
    assert np.array_equal(part.samples[:, part.columns], record.samples[:, part.columns])
    del data["channels"]["motor_speed"]
    with pytest.raises(UsageError, match="lacks 'motor_speed'"):
        map_from(data, "map")


def actuator_map():
    return {"name": "ours", "axis": "actuator", "profile": "step",
            "time": {"column": "time", "unit": "s"},
            "channels": {c.name: {"column": c.name, "unit": c.unit} for c in CHANNELS[1:]}}


def test_what_is_left_out_of_a_test_of_the_actuator_is_said(tmp_path, capsys):
    record = simulate(load_profile("step"), seed=3)
    rows = [",".join(map(repr, row)) for row in record.samples.tolist()]
    rows[100] = rows[100].rpartition(",")[0] + ",null"
    text = "\n".join([",".join(c.name for c in CHANNELS), *rows])
    (tmp_path / "a.csv").write_text(text[:-60])
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(actuator_map()), encoding="utf-8")
    assert run(["import", str(tmp_path / "a.csv"), "--map", str(tmp_path / "map.yaml"),
                "--out", str(tmp_path / "bag")]) == 0
    said = capsys.readouterr().err
    assert f"line {len(rows) + 1} is cut and left out" in said
    assert "1 row without a value left out" in said


def test_an_encoder_on_the_shaft_gives_the_electrical_angle(tmp_path):
    record = simulate(load_profile("step"), seed=3)
    pairs, zero = 3, 23456.0  # of pole pairs; counts of 2^17 where phase a rises through 0
    given = {c.name: record.samples[:, k] for k, c in enumerate(CHANNELS)}
    turns = np.unwrap(given["rotor_angle"]) / (2.0 * np.pi * pairs)
    given["rotor_angle"] = (turns * 2**17 + zero) % 2**17
    np.savez(tmp_path / "a.npz", **given)
    data = {"name": "ours", "axis": "actuator", "profile": "step",
            "time": {"column": "time", "unit": "s"},
            "channels": {c.name: {"column": c.name, "unit": c.unit} for c in CHANNELS[1:]}}
    data["channels"]["rotor_angle"] = {
        "column": "rotor_angle", "unit": "turn", "zero": zero, "scale": pairs / 2**17}
    angle = import_file(tmp_path / "a.npz", map_from(data, "map")).channel("rotor_angle")
    assert angle.min() >= 0.0
    assert angle.max() < 2.0 * np.pi
    off = angle - record.channel("rotor_angle")
    assert np.abs((off + np.pi) % (2.0 * np.pi) - np.pi).max() < 1e-9


@pytest.mark.parametrize(("change", "match"), [
    ({"axis": "round"}, "axis: must be"),
    ({"input": None}, "'input' is missing"),
    ({"position": None, "speed": None}, "give 'position' or 'speed'"),
    ({"extra": 1}, "extra: no such key"),
    ({"input": {"column": "i", "unit": "mA", "gain": 2.0}}, "come together"),
    ({"input": {"column": "i", "unit": "mA", "scale": 0.0}}, "leaves nothing"),
    ({"time": {"unit": "s"}}, "either 'column' or 'rate'"),
    ({"start": 2.0, "end": 1.0}, "is not after 'start'"),
    ({"channels": {"motor_speed": {"column": "w", "unit": "rpm"}}}, "for 'axis: actuator'"),
    ({"bus_voltage": 96.0}, "'bus_voltage' is for 'axis: actuator'"),
])
def test_wrong_maps_say_where(change, match):
    data = {k: v for k, v in {**MAP, **change}.items() if v is not None}
    with pytest.raises(UsageError, match=match) as caught:
        map_from(data, "m.yaml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("key", "value", "match"), [
    ("input", {"column": "current", "unit": "mA"}, "unknown column 'current'"),
    ("input", {"column": 9, "unit": "mA"}, "no column 9"),
    ("input", {"column": "i", "unit": "rpm"}, "measures none of"),
    ("input", {"column": "i", "unit": "mA", "acts_as": "torque", "gain": "t"}, "holds 300"),
    ("speed", {"column": "w", "unit": "rmp"}, "did you mean 'rpm'"),
    ("speed", {"column": "w", "unit": "m/s"}, "measures linear speed, expected angular speed"),
    ("start", 5.0, "0 samples between start 5 s"),
    ("time", {"column": "w", "unit": "s"}, "time does not increase at sample 1"),
    ("position", {"column": "q[1]", "unit": "deg"}, "so no column 1"),
])
def test_wrong_columns_and_units_say_the_remedy(tmp_path, key, value, match):
    np.savez(tmp_path / "a.npz", **columns())
    with pytest.raises((UsageError, InvalidRecordError), match=match) as caught:
        import_file(tmp_path / "a.npz", map_from({**MAP, key: value}, "map"))
    assert "\n" not in str(caught.value)


def write_object_npz(path):
    np.savez(path, t=np.array([{}, 1], dtype=object), i=[1.0], q=[1.0], w=[1.0])


def write_mat_of_no_type(path):
    scipy.io.savemat(path, columns())
    data = bytearray(path.read_bytes())
    assert data[176] == 9  # the type of the numbers of the first variable: double
    path.write_bytes(data[:176] + b"\x00" + data[177:])


@pytest.mark.parametrize(("name", "make", "match"), [
    ("a.mat", write_mat_of_no_type, "what reads it crashed"),
    ("a.npz", write_object_npz, "would need pickle"),
    ("a.npz", lambda p: p.write_bytes(b"PK\x03\x04 no zip"), "no NPZ file"),
    ("a.mat", lambda p: p.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(600)), "no HDF5 file"),
    ("a.mat", lambda p: p.write_bytes(bytes(700)), "no MAT file"),
    ("a.mat", lambda p: scipy.io.savemat(p, {**columns(), "t": np.array(["x"], object)}),
     "is a MATLAB cell"),
    ("a.csv", lambda p: p.write_bytes(b"t,i\n1,2\n\x00\x01"), "not text"),
    ("a.csv", lambda p: p.write_bytes(b"a,b\nc,d\n"), "no row of numbers"),
    ("a.csv", lambda p: p.write_bytes(text().encode() + b"1,2,x,3\n"),
     "line 302, column 'q': 'x' is not a number"),
    ("a.csv", lambda p: p.write_bytes(text().encode() + b"1,2\n1,2,3,4\n"),
     "line 302: 2 columns, expected 4"),
    ("a.csv.gz", lambda p: p.write_bytes(gzip.compress(text().encode())[:-20]), "damaged gzip"),
    ("a.csv", lambda p: p.write_bytes(b""), "0 bytes, .*: it is empty, save it again"),
    ("a.csv", lambda p: p.write_text('t,i,"' + 140_000 * "x" + '"\n1,2,3\n'), "field larger"),
    ("a.npz", lambda p: np.savez(p, **{k: v[:0] for k, v in columns().items()}), "no samples"),
    ("a.parquet", lambda p: p.write_bytes(b"PAR1"), "no Parquet file"),
    ("a.ods", lambda p: p.write_bytes(b"PK"), "save it as XLSX or as CSV"),
    ("a.foo", lambda p: p.write_bytes(b"x"), "is not known: give one of .csv"),
    ("a.mcap", lambda p: p.write_bytes(b"x"), "no map but --topic and --joint"),
    ("a.csv", lambda p: None, "no such file"),
    ("a.npz", lambda p: np.savez(p, **{**columns(), "t": np.zeros(4)}), "different length"),
    ("a.npz", lambda p: np.savez(p, **{**columns(), "i": np.full(N, np.nan)}), "lack a value"),
])
def test_bad_files_are_one_line(tmp_path, name, make, match):
    make(tmp_path / name)
    with pytest.raises((UsageError, InvalidRecordError), match=match) as caught:
        import_file(tmp_path / name, map_from(MAP, "map"))
    assert "\n" not in str(caught.value)


def test_a_bomb_is_not_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr("ema_rig.text.MAX_TEXT_BYTES", 10_000)
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(b"1,2,3\n" * 100_000))
    with pytest.raises(InvalidRecordError, match="more than 10000 bytes"):
        read_table(tmp_path / "a.csv.gz", TextFormat(), [])
    monkeypatch.setattr("ema_rig.array_files.MAX_FILE_BYTES", 1000)
    np.savez_compressed(tmp_path / "a.npz", t=np.zeros(10_000))
    with pytest.raises(InvalidRecordError, match="once unpacked, at most 1000"):
        read_table(tmp_path / "a.npz", TextFormat(), ["t"])


def test_pickled_bytes_are_refused(tmp_path):
    (tmp_path / "a.npz").write_bytes(pickle.dumps({"t": [1.0]}))
    with pytest.raises(InvalidRecordError):
        read_table(tmp_path / "a.npz", TextFormat(), ["t"])


def test_every_unit_is_of_a_known_quantity():
    for unit, (quantity, factor) in UNITS.items():
        assert unit_factor(unit, quantity, "here") == factor > 0.0
    assert unit_factor("rev/min", "angular speed", "") == pytest.approx(0.104719755)
    assert unit_factor("°", "angle", "") == pytest.approx(np.pi / 180)


def test_the_command_prints_json_and_one_line_errors(tmp_path, capsys):
    (tmp_path / "a.csv").write_text(text(), encoding="utf-8")
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAP), encoding="utf-8")
    assert load_map(tmp_path / "map.yaml").name == "bench"
    arguments = ["import", str(tmp_path / "a.csv"), "--map", str(tmp_path / "map.yaml"),
                 "--out", str(tmp_path / "bag"), "--json"]
    assert run(arguments) == 0
    assert '"samples": 300' in capsys.readouterr().out
    assert run(arguments) == 2
    assert "never overwritten" in capsys.readouterr().err
    assert run(["import", str(tmp_path / "a.csv"), "--map", "none.yaml", "--out", "x"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "none.yaml" in error
