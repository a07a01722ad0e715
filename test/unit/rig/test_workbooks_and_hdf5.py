"""XLSX, HDF5 and MATLAB 7.3 files by other people's writers; what a hostile one may not do."""

import datetime as dt
import gzip
import re
import struct
import sys
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pandas as pd
import pytest

from ema_record.errors import InvalidRecordError, UsageError
from ema_rig import hdf5
from ema_rig.guess import guess_map
from ema_rig.import_file import import_file, read_table
from ema_rig.map import TextFormat, map_from

MAP = {"name": "bench", "axis": "rotary", "time": {"column": "t", "unit": "s"},
       "input": {"column": "i", "unit": "A"}, "position": {"column": "q", "unit": "rad"}}
N = 60
T = 0.01 * np.arange(N)
Q, CURRENT = np.round(np.sin(5 * T), 8), np.round(np.cos(7 * T), 8)
FRAME = pd.DataFrame({"t": T, "i": CURRENT, "q": Q, "state": ["IDLE", "RUN"] * (N // 2)})
START = pd.Timestamp("2024-01-31T23:59:59.75").to_pydatetime()
V73 = Path(__file__).with_name("tables_v73.mat.gz")  # by mat-io 1.0.2


def imported(path, **more):
    return import_file(path, map_from({**MAP, **more}, "map"))


def check(record):
    np.testing.assert_allclose(record.time - record.time[0], T, atol=1e-6)
    np.testing.assert_allclose(record.input, CURRENT, atol=1e-12)
    np.testing.assert_allclose(record.channel("position"), Q, atol=1e-12)


def workbook(path, rows, before=()):
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.title = "data"
    for name in before:
        book.create_sheet(name, 0).append(["a cover page"])
    for row in rows:
        sheet.append(row)
    book.save(path)
    return path


def rows(times=T, head=("t", "i", "q", "state")):
    return [list(head), *([a, b, c, "RUN"] for a, b, c in zip(times, CURRENT, Q))]


def test_a_sheet_of_pandas(tmp_path):
    FRAME.to_excel(tmp_path / "a.xlsx", index=False)
    check(imported(tmp_path / "a.xlsx"))


def test_titles_units_dates_and_clocks_of_a_workbook(tmp_path):
    units = [["Bench 7"], [], ["t", "i", "q", "state"], ["s", "mA", "quux", "-"]]
    path = workbook(tmp_path / "a.xlsx", units + rows()[1:])
    assert read_table(path, TextFormat(), None).units["i"] == "mA"
    check(imported(path))
    dates = [START + dt.timedelta(seconds=float(s)) for s in T]
    path = workbook(tmp_path / "b.xlsx", rows(dates))
    check(imported(path, time={"column": "t", "unit": "iso"}))
    path = workbook(tmp_path / "c.xlsx", rows([date.time() for date in dates]))
    check(imported(path, time={"column": "t", "unit": "h:m:s"}))
    for seconds in (30 * 3600.0, 24 * 3600.0 - 0.25):  # and from one day to the next
        path = workbook(tmp_path / "d.xlsx", rows([dt.timedelta(seconds=seconds + float(s))
                                                   for s in T]))
        check(imported(path, time={"column": "t", "unit": "h:m:s"}))


def test_the_sheet_with_numbers_is_found_or_named(tmp_path):
    path = workbook(tmp_path / "a.xlsx", rows(), before=("cover", "notes"))
    check(imported(path))
    check(imported(path, format={"sheet": "data"}))
    assert "sheet 'data' of 3" in read_table(path, TextFormat(), None).notes
    with pytest.raises(UsageError, match=r"unknown sheet 'dat'.*notes, cover, data"):
        imported(path, format={"sheet": "dat"})
    with pytest.raises(InvalidRecordError, match="no row of numbers"):
        imported(path, format={"sheet": "cover"})


def test_a_cell_that_is_no_number_is_named_by_its_row(tmp_path):
    changed = rows()
    changed[17][2] = "#N/A!"
    with pytest.raises(InvalidRecordError, match="line 18, column 'q': '#N/A!' is not a number"):
        imported(workbook(tmp_path / "a.xlsx", changed))


def test_what_a_cell_shows_is_read_whatever_it_holds(tmp_path):
    """Truth values as numbers, the last result of a formula, a title of two lines."""
    head = ("t", "i", "q", "a title\n of two lines", "f")
    path = workbook(tmp_path / "a.xlsx", [[], [*head], *(
        [a, b, c, bool(k % 3), f"=A{k + 3}*2"] for k, (a, b, c) in enumerate(
            zip(T, CURRENT, Q)))])
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, re.sub(rb"</f><v ?/>|</f><v></v>", b"</f><v>0.5</v>", content))
    check(imported(path))
    found = read_table(path, TextFormat(), None).columns
    assert found["a title of two lines"] == pytest.approx((np.arange(N) % 3 > 0).astype(float))
    assert (found["f"] == 0.5).all()


def test_a_workbook_is_unpacked_to_a_bound(tmp_path, monkeypatch):
    path = workbook(tmp_path / "a.xlsx", rows())
    monkeypatch.setattr("ema_rig.xlsx.MAX_TEXT_BYTES", 2000)
    with pytest.raises(InvalidRecordError, match="bytes once unpacked, at most 2000"):
        imported(path)


def test_datasets_groups_fields_and_matrices_of_hdf5(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        group = file.create_group("run 1")
        group["t"], group["i"] = T, CURRENT
        group.create_dataset("q", data=Q, compression="gzip").attrs["units"] = "rad"
        file["all"] = np.column_stack([T, CURRENT, Q])
        file["rows"] = np.rec.fromarrays([T, CURRENT, Q], names="t,i,q")
        file["note"] = "a bench"
    for t, i, q in (("run 1.t", "run 1.i", "run 1.q"), ("rows.t", "rows.i", "rows.q"),
                    ("all[0]", "all[1]", "all[2]")):
        check(imported(tmp_path / "a.h5", time={"column": t, "unit": "s"},
                       input={"column": i, "unit": "A"}, position={"column": q, "unit": "rad"}))
    found = guess_map(tmp_path / "a.h5").data
    assert found["input"]["column"] == "run 1.i"  # one group, the one with a unit
    assert found["position"] == {"column": "run 1.q", "unit": "rad"}


def test_groups_within_groups_are_listed_and_links_that_lead_nowhere_are_not(
        tmp_path, monkeypatch):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        group = file
        for k in range(4):
            group[f"x{k}"] = k + T
            group = group.create_group("g")
        file["lost"] = h5py.SoftLink("/nowhere")
        file["x0"].attrs["unit"] = "rad"
    found = read_table(path, TextFormat(), None)
    assert list(found.columns) == ["x0", "g.x1", "g.g.x2", "g.g.g.x3"]
    assert found.columns["g.g.x2"] == pytest.approx(2.0 + T)
    assert found.units == {"x0": "rad"}
    monkeypatch.setattr(hdf5, "MAX_DEPTH", 2)
    assert list(read_table(path, TextFormat(), None).columns) == ["x0", "g.x1", "g.g.x2"]
    monkeypatch.setattr(hdf5, "MAX_NAMES", 3)
    with pytest.raises(InvalidRecordError, match="more than 3 datasets"):
        read_table(path, TextFormat(), None)


def test_only_what_is_needed_must_be_numbers(tmp_path):
    """Of a name that begins another one nothing is read."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["t2"], file["i2"], file["q2"] = T, CURRENT, Q
        file["t"], file["q"] = "a bench", np.zeros((N, 2, 2))
        file["i"], file["none"] = CURRENT * 1j, np.zeros((0, 3))
    names = {"time": {"column": "t2", "unit": "s"}, "input": {"column": "i2", "unit": "A"}}
    check(imported(path, **names, position={"column": "q2", "unit": "rad"}))
    for name, match in (("q", "has 3 dimensions"), ("i", "dimensions of complex128"),
                        ("none", "is empty"), ("t", "expected one or two of real numbers")):
        with pytest.raises(InvalidRecordError, match=match):
            imported(path, **names, position={"column": name, "unit": "rad"})


def test_a_matrix_of_matlab_lies_the_other_way(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["all"] = np.array([T, CURRENT, Q])
        file["all"].attrs["MATLAB_class"] = np.bytes_("double")
    check(imported(tmp_path / "a.h5", time={"column": "all[0]", "unit": "s"},
                   input={"column": "all[1]", "unit": "A"},
                   position={"column": "all[2]", "unit": "rad"}))


def test_rows_of_a_timetable_at_an_even_rate_or_step_begin_at_its_origin():
    class Objects:
        """Objects that stand for themselves."""

        def read(self, stored):
            return stored

    def duration(*milliseconds):
        return "duration", {"millis": np.array([milliseconds]).T}

    at = {"origin": duration(5000.0), "specifiedAsRate": np.array([[1]]),
          "sampleRate": np.array([[50.0]]), "stepSize": duration(250.0)}
    assert hdf5._row_times(Objects(), at, 4) == pytest.approx([5.0, 5.02, 5.04, 5.06])
    at["specifiedAsRate"] = np.array([[0]])
    assert hdf5._row_times(Objects(), at, 3) == pytest.approx([5.0, 5.25, 5.5])
    at["origin"] = "datetime", {"data": np.array([[1.7e12]])}
    assert hdf5._row_times(Objects(), at, 3) == pytest.approx([0.0, 0.25, 0.5])
    with pytest.raises(ValueError, match="rows every calendarDuration"):
        hdf5._row_times(Objects(), {**at, "stepSize": ("calendarDuration", {})}, 3)


def test_a_date_is_the_sum_of_two_numbers_to_less_than_a_microsecond():
    """Milliseconds since 1970 alone hold a quarter of one."""
    steps = np.array([0.0, 1e-4, 0.5, 3600.0])
    stored = np.zeros((4, 1), dtype=[("real", "f8"), ("imag", "f8")])
    stored["real"][:, 0] = 1.7e12 + 1e3 * np.round(steps)
    stored["imag"][:, 0] = 0.125 + 1e3 * (steps - np.round(steps))
    found = hdf5._seconds("datetime", {"data": stored})
    assert found.ravel() == pytest.approx(steps, abs=1e-9)
    one = hdf5._seconds("datetime", {"data": 1.7e12 + np.array([[0.0], [2000.0]])})
    assert one.ravel() == pytest.approx([0.0, 2.0])


@pytest.mark.parametrize(("table", "time"), [
    ("bench", "bench.Time"), ("dated", "dated.When"), ("plain", "plain.t")])
def test_tables_and_timetables_of_matlab(tmp_path, table, time):
    path = tmp_path / "a.mat"
    path.write_bytes(gzip.decompress(V73.read_bytes()))
    check(imported(path, time={"column": time, "unit": "s"},
                   input={"column": f"{table}.iq", "unit": "A"},
                   position={"column": f"{table}.q", "unit": "rad"}))
    check(imported(path, time={"column": time, "unit": "s"},
                   input={"column": f"{table}.iq", "unit": "A"},
                   position={"column": "run.q", "unit": "rad"}))
    assert guess_map(path).data["time"] == {"column": "bench.Time", "unit": "s"}
    with pytest.raises(InvalidRecordError, match=r"bench\.state is a MATLAB string, expected"):
        imported(path, time={"rate": 100.0}, input={"column": "bench.state", "unit": "A"},
                 position={"column": "run.q", "unit": "rad"})


def opaque(packed):
    """Return a file of level 5 with one object in it, as MATLAB saves a table."""
    head = struct.pack("<II", 6, 8) + struct.pack("<II", 17, 0)
    element = struct.pack("<II", 14, len(head)) + head
    if packed:
        element = zlib.compress(element)
        element = struct.pack("<II", 15, len(element)) + element
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + element


@pytest.mark.parametrize("packed", [False, True])
def test_a_table_in_an_older_file_says_how_to_save_it(tmp_path, packed):
    (tmp_path / "a.mat").write_bytes(opaque(packed))
    with pytest.raises(InvalidRecordError, match=r"a timetable, a string.*'-v7\.3'"):
        imported(tmp_path / "a.mat")


def test_a_missing_library_is_one_line(tmp_path, monkeypatch):
    FRAME.to_excel(tmp_path / "a.xlsx", index=False)
    (tmp_path / "a.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    for name, module in (("a.xlsx", "openpyxl"), ("a.h5", "h5py")):
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(UsageError, match=rf"package {module}, which is not installed: pip"):
            imported(tmp_path / name)


def test_a_shape_that_is_only_claimed_is_not_allocated(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"], file["i"] = T, CURRENT
        file.create_dataset("q", shape=(1 << 40,), chunks=(1024,), dtype="f8")
    with pytest.raises(InvalidRecordError, match="q claims 1099511627776 values and stores"):
        imported(tmp_path / "a.h5")


def test_the_bounds_hold_for_what_is_stored(tmp_path, monkeypatch):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"], file["i"], file["q"] = T, CURRENT, Q
    monkeypatch.setattr("ema_rig.hdf5.MAX_FILE_BYTES", 1000)
    with pytest.raises(InvalidRecordError, match="1440 bytes once read, at most 1000"):
        imported(tmp_path / "a.h5")
    monkeypatch.setattr("ema_rig.table.MAX_ROWS", N - 1)
    with pytest.raises(InvalidRecordError, match="60 rows and 1 columns, at most 59"):
        imported(tmp_path / "a.h5")


def test_other_files_are_not_shown(tmp_path):
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["q"] = Q
    (tmp_path / "secret.bin").write_bytes(Q.tobytes())
    layout = h5py.VirtualLayout(shape=(N,), dtype="f8")
    layout[:] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "q", shape=(N,))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"], file["i"] = T, CURRENT
        file["linked"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "/q")
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("raw", shape=(N,), dtype="f8",
                            external=[(str(tmp_path / "secret.bin"), 0, 8 * N)])
    for name, match in (("linked", "unknown column 'linked'"), ("virtual", "in another file"),
                        ("raw", "in another file")):
        with pytest.raises((UsageError, InvalidRecordError), match=match):
            imported(tmp_path / "a.h5", position={"column": name, "unit": "rad"})


@pytest.mark.slow
def test_a_workbook_that_unpacks_to_too_much_is_refused(tmp_path):
    path = tmp_path / "a.xlsx"
    FRAME.to_excel(path, index=False)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive, archive.open(
            "xl/more.xml", "w") as member:
        for _ in range(513):
            member.write(bytes(1 << 20))
    with pytest.raises(InvalidRecordError, match="bytes once unpacked, at most"):
        imported(path)


@pytest.mark.parametrize(("name", "content", "match"), [
    ("a.xlsx", b"PK\x03\x04", "no XLSX file, or damaged"),
    ("a.xlsx", b"t,i,q\n1,2,3\n", "no XLSX file, or damaged"),
    ("a.h5", b"\x89HDF\r\n\x1a\n" + bytes(600), "no HDF5 file, or damaged"),
    ("a.hdf5", b"t,i,q\n1,2,3\n", "no HDF5 file, or damaged"),
])
def test_damaged_files_are_one_line(tmp_path, name, content, match):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InvalidRecordError, match=match) as caught:
        imported(tmp_path / name)
    assert "\n" not in str(caught.value)
