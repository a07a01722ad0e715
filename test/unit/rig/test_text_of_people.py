"""Text as people have it: words beside numbers, clocks, quotes, UTF-16, holes; the guessed map."""

import shutil
import subprocess
import sys

import numpy as np
import pytest
import yaml

from ema_cli.main import run
from ema_record.errors import InvalidRecordError, UsageError
from ema_rig.array_files import read_parquet
from ema_rig.guess import guess_map
from ema_rig.import_file import import_file
from ema_rig.map import map_from

MAP = {"name": "bench", "axis": "rotary", "time": {"column": "t", "unit": "s"},
       "input": {"column": "i", "unit": "A"}, "position": {"column": "q", "unit": "rad"}}
N = 60
T = 0.01 * np.arange(N)
Q, CURRENT = np.sin(5 * T), np.cos(7 * T)


def table(head="t,i,q,state", cells=None, form="{t:.4f},{i:.8f},{q:.8f},{s}"):
    rows = [form.format(t=T[k], i=CURRENT[k], q=Q[k], s=("IDLE", "RUN")[k % 2]) for k in range(N)]
    for row, text in (cells or {}).items():
        rows[row] = text
    return head + "\n" + "\n".join(rows) + "\n"


def write(path, text, encoding="utf-8"):
    path.write_bytes(text.encode(encoding))
    return path


def imported(path, **more):
    return import_file(path, map_from({**MAP, **more}, "map"))


def check(record):
    np.testing.assert_allclose(record.time, T, atol=1e-9)
    np.testing.assert_allclose(record.input, CURRENT, atol=1e-8)
    np.testing.assert_allclose(record.channel("position"), Q, atol=1e-8)


@pytest.mark.parametrize(("text", "encoding"), [
    (table(), "utf-8"),
    (table(), "utf-16"),
    (table(), "utf-16-le"),
    (table(), "utf-16-be"),
    (table().replace("\n", "\r\n"), "utf-8-sig"),
    (table(head='"t","i","q","state"', form='"{t:.4f}","{i:.8f}","{q:.8f}","{s}, now"'), "utf-8"),
    (table(head="t;i;q;state", form="{t:.4f};{i:.8f};{q:.8f};{s}").replace(".", ","), "utf-8"),
    (table(form='"{t:.4f}","{i:.8f}","{q:.8f}",{s}').replace(".", ","), "utf-8"),
    (table(head="t i q state", form="{t:.4f} {i:.8f}   {q:.8f} {s}"), "utf-8"),
    (table(head="t\ti\tq\tstate", form="{t:.4f}\t{i:.8f}\t{q:.8f}\t{s}"), "utf-8"),
    ("Bench 7, Monday\nRate: 100\n\n" + table(), "utf-8"),
    (table(head="t,i,q,state\ns,A,rad,wibble"), "utf-8"),
    ("# by a bench\n" + table(head="t,i,q,state\n[s],[A],[quux],[-]"), "utf-8"),
])
def test_words_quotes_encodings_and_rows_of_units(tmp_path, text, encoding):
    check(imported(write(tmp_path / "a.csv", text, encoding)))


@pytest.mark.parametrize(("cells", "match"), [
    ({7: "0.07,ERR,0.3,RUN"}, "line 9, column 'i': 'ERR' is not a number"),
    ({7: "0.07,1,0.3"}, "line 9: 3 columns, expected 4 as above it"),
    ({7: "0.07,1,0.3,RUN,5"}, "line 9: 5 columns, expected 4"),
    ({7: "0.07,1_0,0.3,RUN"}, "'1_0' is not a number"),
])
def test_the_cell_that_offends_is_named(tmp_path, cells, match):
    with pytest.raises(InvalidRecordError, match=match):
        imported(write(tmp_path / "a.csv", table(cells=cells)))


def test_a_cell_of_another_column_and_a_line_that_was_cut_do_not_matter(tmp_path):
    path = write(tmp_path / "a.csv", table(
        head="t,i,q,state,more", form="{t:.4f},{i:.8f},{q:.8f},{s},1",
        cells={7: f"{T[7]},{CURRENT[7]},{Q[7]},x,bad"}) + "0.6,1.0")
    record = imported(path)
    check(record)
    assert "line 62 is cut and left out" in record.axis.notes


@pytest.mark.parametrize("mark", [",", ";"])
@pytest.mark.parametrize(("head", "end"), [("", "X"), ("X", ""), ("X", "X"), ("X", "X X")])
def test_delimiters_at_the_end_do_not_cost_the_names(tmp_path, mark, head, end):
    text = table(head=f"t,i,q{head}", form="{t:.4f},{i:.8f},{q:.8f}" + end.replace(" ", ""))
    check(imported(write(tmp_path / "a.csv", text.replace("X", ",").replace(",", mark))))


@pytest.mark.parametrize(("unit", "form"), [
    ("iso", lambda t: f"2024-03-01T23:59:59.{int(1e9 * (0.9 + t)) % 10**9:09d}Z" if t < 0.0999
        else f"2024-03-02T00:00:00.{round(1e6 * (t - 0.1)):06d}+00:00"),
    ("iso", lambda t: f"2024-03-01 10:00:00.{round(1e3 * t):03d}"),
    ("h:m:s", lambda t: f"23:59:59.{round(1e4 * (0.9 + t)):04d}" if t < 0.0999
        else f"0:00:00.{round(1e4 * (t - 0.1)):04d}"),
    ("h:m:s", lambda t: f"59:01.{round(1e4 * t):04d}"),
])
def test_dates_and_clocks(tmp_path, unit, form):
    rows = "\n".join(f"{form(t)},{i:.9f},{q:.9f}" for t, i, q in zip(T, CURRENT, Q))
    path = write(tmp_path / "a.csv", f"t,i,q\n{rows}\n")
    record = imported(path, time={"column": "t", "unit": unit})
    np.testing.assert_allclose(record.time - record.time[0], T, atol=2e-6)
    with pytest.raises(UsageError, match=f"set unit: {unit}"):
        imported(path)
    write(tmp_path / "b.csv", f"t,i,q\n{rows}\n".replace(form(T[5]), "noon"))
    with pytest.raises(InvalidRecordError, match="line 7, column 't': 'noon' is no time"):
        imported(tmp_path / "b.csv", time={"column": "t", "unit": unit})


def test_equal_stamps_are_refused_dropped_or_averaged(tmp_path):
    path = write(tmp_path / "a.csv", table(cells={10: "0.0900,5,0.5,x"}))
    with pytest.raises(InvalidRecordError, match=r"1 time stamp equal .* sample 10 .* drop' or"):
        imported(path)
    dropped, mean = (imported(path, duplicates=how) for how in ("drop", "mean"))
    assert len(dropped) == len(mean) == N - 1
    assert dropped.input[9] == pytest.approx(CURRENT[9], abs=1e-8)
    assert mean.input[9] == pytest.approx((CURRENT[9] + 5) / 2, abs=1e-8)
    assert "1 row of a time stamp that was there averaged" in mean.axis.notes


def test_a_counter_that_starts_again_goes_on(tmp_path):
    count = 3000 * T**2 - 400 * T
    rows = "\n".join(f"{t:.4f},{i:.8f},{c % 100:.6f}" for t, i, c in zip(T, CURRENT, count))
    path = write(tmp_path / "a.csv", "t,i,q\n" + rows)
    column = {"column": "q", "unit": "turn", "scale": 0.01, "unwrap": 100.0}
    record = imported(path, position=column)
    np.testing.assert_allclose(np.diff(record.channel("position")),
                               2 * np.pi * np.diff(count) / 100, atol=1e-6)


def test_columns_of_other_rates(tmp_path):
    """Position each 10 ms, current each 30 ms between them: at the times of the current."""
    slow = np.arange(0.005, 0.58, 0.03)
    rows = sorted([*((t, "", f"{q:.9f}") for t, q in zip(T, Q)),
                   *((t, f"{np.cos(7 * t):.9f}", "") for t in slow)])
    path = write(tmp_path / "a.csv", "t,i,q\n" + "\n".join(f"{t:.4f},{i},{q}" for t, i, q in rows))
    with pytest.raises(InvalidRecordError, match="set 'mixed_rates: true'"):
        imported(path)
    record = imported(path, mixed_rates=True)
    np.testing.assert_allclose(record.time, slow, atol=1e-9)
    np.testing.assert_allclose(record.input, np.cos(7 * slow), atol=1e-8)
    np.testing.assert_allclose(record.channel("position"), np.sin(5 * slow), atol=25 * 0.01**2 / 8)
    np.savez(tmp_path / "b.npz", t=T, q=Q, ti=1e3 * slow, i=np.cos(7 * slow))
    with pytest.raises(InvalidRecordError, match="give each its own 'time"):
        imported(tmp_path / "b.npz")
    again = imported(tmp_path / "b.npz", input={
        "column": "i", "unit": "A", "time": {"column": "ti", "unit": "ms"}})
    np.testing.assert_allclose(again.samples, record.samples, atol=1e-8)


def test_runs_with_names(tmp_path):
    rows = [f"{name},{t:.3f},{np.cos(t + k):.9f},{t}"
            for k, name in enumerate(("up", "down", "up 2")) for t in T]
    path = write(tmp_path / "a.csv", "trial,t,i,q\n" + "\n".join(rows))
    record = imported(path, run={"column": "trial", "only": ["down", "up 2"]})
    assert len(record) == 2 * N
    np.testing.assert_allclose(record.input[:N], np.cos(T + 1), atol=1e-8)
    with pytest.raises(UsageError, match="no run left; the file has up, down, up 2"):
        imported(path, run={"column": "trial", "only": ["left"]})


def test_a_second_sensor_behind_the_gear(tmp_path):
    path = write(tmp_path / "a.csv", table(form="{t:.4f},{i:.8f},{q:.8f},0.5", head="t,i,q,out"))
    record = imported(path, output_position={"column": "out", "unit": "deg", "scale": 50.0})
    assert record.channels[-1].label == "output_position[rad]"
    np.testing.assert_allclose(record.channel("output_position"), np.radians(25.0))
    with pytest.raises(UsageError, match="compared with 'position'"):
        map_from({**MAP, "position": None, "speed": {"column": "q", "unit": "rpm"},
                  "output_position": {"column": "out", "unit": "deg"}}, "m")


def test_parquet(tmp_path):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    stamps = np.datetime64("2024-01-01", "ns") + np.rint(1e9 * T).astype("timedelta64[ns]")
    pq.write_table(pa.table({"t": stamps, "i": CURRENT.astype(np.float32), "q": Q,
                             "state": ["a"] * N}), tmp_path / "a.parquet")
    record = imported(tmp_path / "a.parquet")
    np.testing.assert_allclose(record.time, T, atol=1e-9)
    np.testing.assert_allclose(record.input, CURRENT, atol=1e-6)
    with pytest.raises(InvalidRecordError, match="line 1, column 'state': 'a' is not a number"):
        imported(tmp_path / "a.parquet", position={"column": "state", "unit": "rad"})
    assert guess_map(tmp_path / "a.parquet").data["time"] == {"column": "t", "unit": "s"}
    with pytest.raises(UsageError, match="unit 'ms', but 't' holds times, whose unit the file"):
        imported(tmp_path / "a.parquet", time={"column": "t", "unit": "ms"})
    dated = imported(tmp_path / "a.parquet", time={"column": "t", "unit": "iso"})
    np.testing.assert_allclose(dated.time, T, atol=1e-9)
    stamps[[0, 7]] = np.datetime64("NaT")
    pq.write_table(pa.table({"t": stamps, "i": CURRENT, "q": Q}), tmp_path / "b.parquet")
    record = imported(tmp_path / "b.parquet")
    kept = np.delete(np.arange(N), [0, 7])
    np.testing.assert_allclose(record.time, T[kept] - T[1], atol=1e-9)
    np.testing.assert_allclose(record.input, CURRENT[kept], atol=1e-9)


FLIPS = """
import sys
from pathlib import Path
from ema_record.errors import RecordError
from ema_rig.array_files import read_parquet
path = Path(sys.argv[1])
good = path.read_bytes()
for at in range(len(good) - 900, len(good) - 8):
    bad = bytearray(good)
    bad[at] ^= 8
    path.write_bytes(bad)
    try:
        read_parquet(path, ["t", "x"])
    except RecordError:
        pass
"""


def test_damaged_parquet_is_refused_and_ends_no_process(tmp_path):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "a.parquet"
    columns = pa.table({"t": T, "x": Q, "s": ["a"] * N})
    pq.write_table(columns, path)
    done = subprocess.run(
        [sys.executable, "-c", FLIPS, path], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-500:]
    pq.write_table(columns, path, write_page_checksum=True, compression="none")
    data = bytearray(path.read_bytes())
    data[data.index(T[5:9].tobytes())] ^= 1  # a number that is nearly the same
    path.write_bytes(data)
    with pytest.raises(InvalidRecordError, match="damaged"):
        read_parquet(path, ["t"])


def bench(head, scale=(1.0, 1.0, 1.0, 1.0)):
    """Return a run of 2 s with t, torque, position, speed, each times its scale."""
    t = np.arange(0.0, 2.0, 0.005)
    columns = [t, np.sin(t), np.sin(4 * t), 4 * np.cos(4 * t)]
    rows = zip(*(c * s for c, s in zip(columns, scale)))
    return head + "\n" + "\n".join(",".join(f"{x:.9g}" for x in row) for row in rows) + "\n"


RPM, DEG = 60 / (2 * np.pi), 180 / np.pi


@pytest.mark.parametrize(("head", "scale", "units"), [
    ("time [ms],torque [mNm],angle [deg],speed [rpm]", (1e3, 1e3, DEG, RPM),
     ("ms", "mNm", "deg", "rpm")),
    ("t_ms,iq_mA,pos_rad,vel_deg/s", (1e3, 1e3, 1, DEG), ("ms", "mA", "rad", "deg/s")),
    ("Time (s),Motor Torque (Nm),Position,Speed (RPM)", (1, 1, DEG, RPM),
     ("s", "Nm", "deg", "rpm")),
    ("t,tau,q,w\ns,Nm,deg,what", (1, 1, DEG, RPM), ("s", "Nm", "deg", "rpm")),
    ("zeit,drehmoment moment,winkel,drehzahl\ns,Nm,rad,rpm", (1, 1, 1, RPM),
     ("s", "Nm", "rad", "rpm")),
])
def test_a_guess_reads_names_and_units_and_tries_what_agrees(tmp_path, head, scale, units):
    guess = guess_map(write(tmp_path / "run 1.csv", bench(head, scale)))
    assert guess.supposed == []
    assert guess.data["name"] == "run-1"
    assert tuple(guess.data[k]["unit"] for k in ("time", "input", "position", "speed")) == units
    record = import_file(tmp_path / "run 1.csv", map_from(guess.data, "g"))
    np.testing.assert_allclose(record.channel("speed"), 4 * np.cos(4 * record.time), atol=1e-6)
    np.testing.assert_allclose(record.channel("position"), np.sin(4 * record.time), atol=1e-6)


@pytest.mark.parametrize(("head", "axis", "column", "units"), [
    ("t_s,tau_Nm,theta_m,omega_m", "rotary", "theta_m", ("rad", "rad/s")),
    ("t_s,tau_Nm,angle_in,speed_in", "rotary", "angle_in", ("rad", "rad/s")),
    ("t_s,force_N,pos_m,v_m/s", "linear", "pos_m", ("m", "m/s")),
    ("t_s,tau_a,position_in,speed", "rotary", "position_in", ("rad", "rad/s")),
    ("t_s,torque_n,theta,omega", "rotary", "theta", ("rad", "rad/s")),
])
def test_the_end_of_a_name_is_a_unit_where_it_can_be(tmp_path, head, axis, column, units):
    """The m of theta_m is the motor's, and an angle has no inches."""
    data = guess_map(write(tmp_path / "a.csv", bench(head))).data
    assert (data["axis"], data["position"]["column"]) == (axis, column)
    assert (data["position"]["unit"], data["speed"]["unit"]) == units


def test_what_drives_is_not_what_was_asked_for(tmp_path):
    path = write(tmp_path / "a.csv", bench("t [s],iq_ref [A],iq [A],speed [rad/s]"))
    assert guess_map(path).data["input"]["column"] == "iq [A]"
    path = write(tmp_path / "b.csv", bench(
        "t [s],torque [Nm],position_load [rad],position_motor [rad]"))
    assert guess_map(path).supposed == ["position.column: position_load [rad], not "
                                        "position_motor [rad]"]


def test_a_time_in_another_unit_is_refused(tmp_path):
    path = write(tmp_path / "a.csv", bench("time [ns],torque [Nm],angle [rad],speed [rad/s]"))
    with pytest.raises(InvalidRecordError, match="samples a second, at most 200000: check the"):
        import_file(path, map_from(guess_map(path).data, "g"))


def test_what_is_supposed_has_to_be_confirmed(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "a.csv", bench("t [s],u,q,w"))
    assert run(["import", "a.csv", "--out", "bag"]) == 2
    error = capsys.readouterr().err
    assert "position.unit: rad and speed.unit: rad/s, or deg and deg/s, or rev and rev/s" in error
    assert "say --set axis=... --set position.unit=... --set input.unit=..., or write" in error
    assert error.count("\n") == 1
    assert run(["import", "a.csv", "--set", "input.unit=N m", "--set", "position.unit=rad",
                "--set", "axis=rotary", "--set", "position.scale=1e0", "--out", "bag"]) == 0
    capsys.readouterr()
    assert run(["import", "a.csv", "--set", "start=2024-13-45", "--out", "other"]) == 2
    assert "the value is no YAML" in capsys.readouterr().err
    assert run(["import", "a.csv", "--guess"]) == 0
    odd = shutil.copy("a.csv", "\udcff.csv")
    assert run(["import", odd, "--guess", "--out", "odd.yaml"]) == 0
    assert "# supposed: input.unit: V" in capsys.readouterr().out
    written = yaml.safe_load((tmp_path / "a.map.yaml").read_text())
    assert map_from(written, "m").position.unit == "rad"
    assert run(["import", "a.csv", "--map", "a.map.yaml", "--out", "again"]) == 0
    assert run(["import", "a.csv", "--guess"]) == 2
    assert "never overwritten" in capsys.readouterr().err


def test_a_preview_shows_rows_in_si_the_map_and_a_picture(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "a.csv", bench("time [ms],torque [mNm],angle [deg],speed [rpm]",
                                    (1e3, 1e3, DEG, RPM)))
    assert run(["import", "a.csv", "--preview"]) == 0
    out = capsys.readouterr().out
    assert "time[s]  input_torque[N m]  position[rad]  speed[rad/s]" in out
    assert "unit: mNm" in out
    assert (tmp_path / "a-preview.png").read_bytes()[:4] == b"\x89PNG"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a-preview.png", "a.csv"]


@pytest.mark.parametrize(("arguments", "match"), [
    (["--set", "axis"], "write KEY=VALUE"),
    (["--set", "axis=round"], "axis: must be"),
    (["--set", "input.unit=furlong"], "unknown unit 'furlong'"),
    (["--topic", "/a"], "are for bags of ROS 2"),
    (["--guess", "--map", "m.yaml"], "leave one of them out"),
])
def test_wrong_use_is_one_line(tmp_path, capsys, monkeypatch, arguments, match):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "a.csv", bench("time [s],torque [Nm],angle [rad],speed [rad/s]"))
    assert run(["import", "a.csv", *arguments]) == 2
    error = capsys.readouterr().err
    assert match in error
    assert error.count("\n") == 1


def test_a_file_without_such_columns_says_which_it_has(tmp_path):
    write(tmp_path / "a.csv", "alpha,beta\n1,2\n3,4\n5,6\n")
    with pytest.raises(UsageError, match=r"looks like the input .* \(it has alpha, beta"):
        guess_map(tmp_path / "a.csv")
    given = {"input.column": "alpha", "position.column": "beta", "position.unit": "mm",
             "input.unit": "N"}
    guess = guess_map(tmp_path / "a.csv", given=given)
    assert guess.data["position"] == {"column": "beta", "unit": "mm"}
    assert guess.data["axis"] == "linear"


def test_a_name_of_two_columns_is_asked_for_by_number(tmp_path):
    form = "{t:.4f},{i:.8f},{q:.8f},0"
    path = write(tmp_path / "a.csv", table(head="t,i,q,i", form=form))
    with pytest.raises(UsageError, match=r"input: 'i' is columns 1, 3"):
        imported(path)
    check(imported(path, input={"column": 1, "unit": "A"}))
