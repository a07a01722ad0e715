"""A fleet: bags found however deep, judged once, units worst first, tables that others read."""

import csv
import hashlib
import json
import os
import re
import shutil
import subprocess
from importlib.resources import files
from io import StringIO
from pathlib import Path
from urllib.parse import unquote

import pytest
from pydantic import TypeAdapter

from ema_cli.main import run
from ema_cli.pages.fleet_files import open_metrics
from ema_prognostics.fleet import judging, verdict_store
from ema_prognostics.fleet.fleet import fleet_of, read_fleet
from ema_prognostics.fleet.tables import COLUMNS, write_parquet
from ema_prognostics.fleet.verdict_store import FILE, FORM, NEEDED, VerdictStore
from ema_prognostics.verdict import contract, schema
from ema_record.bag.content_hash import content_hash
from ema_record.bag.find import bags_below
from ema_record.errors import InvalidRecordError, OutputError

BAGS = ("sim_0000_step", "sim_0001_step")


@pytest.fixture(scope="module")
def place(repository, tmp_path_factory):
    """Return folders of two units, one healthy and one with a short, and a cut bag."""
    folder = tmp_path_factory.mktemp("fleet")
    for depth, name in zip(("a", "b/c"), BAGS):
        shutil.copytree(repository / "bags" / name, folder / depth / name)
    (folder / "b/cut").mkdir()
    (folder / "b/cut/cut_0.mcap").write_bytes(b"\x89MCAP0\r\n")
    (folder / "b/notes.txt").write_text("no bag")
    old = 1_700_000_000
    for path in folder.rglob("*"):
        os.utime(path, (old, old))
    return folder


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def found(place, cache):
    return read_fleet([place], jobs=1, folder=cache)


def test_bags_are_found_however_deep(place):
    names = [str(p.relative_to(place)) for p in bags_below([place])]
    assert names == ["a/sim_0000_step", "b/c/sim_0001_step", "b/cut"]
    assert bags_below([place / "a/sim_0000_step"]) == [place / "a/sim_0000_step"]
    with pytest.raises(InvalidRecordError, match="no bag"):
        bags_below([place / "a/sim_0000_step/metadata.yaml"])
    with pytest.raises(InvalidRecordError, match="no such file"):
        bags_below([place / "nowhere"])


def test_nothing_that_was_given_is_left_out(place, tmp_path):
    """Folders without a bag, links, whole bags beside a cut one, a unit's folder of files."""
    (tmp_path / "empty").mkdir()
    assert bags_below([place / "a", tmp_path / "empty"])[-1] == tmp_path / "empty"
    with pytest.raises(InvalidRecordError, match="no bag: give a folder"):
        bags_below([tmp_path / "empty"])
    unit = tmp_path / "SN-1"
    (unit / "f1").mkdir(parents=True)
    (unit / "f1/f1_0.mcap").touch()
    (unit / "SN-1_0.mcap").touch()
    (unit / "linked").symlink_to(place / "a/sim_0000_step")
    (unit / "round").symlink_to(unit)
    assert [p.name for p in bags_below([unit])] == ["SN-1_0.mcap", "f1", "linked"]
    (unit / "metadata.yaml").touch()
    assert [p.name for p in bags_below([unit])] == ["SN-1", "f1", "linked"]
    own = shutil.copytree(place / "a/sim_0000_step", tmp_path / "own")
    (own / "plots").mkdir()
    assert bags_below([own]) == [own]
    assert bags_below([place, place / "a", place / "a/sim_0000_step"]) == bags_below([place])
    files = tmp_path / "SN-2"
    files.mkdir()
    for name in ("SN-2_202617.mcap", "SN-2_202618.mcap"):
        (files / name).touch()
    assert len(bags_below([files])) == 2
    deep = tmp_path / "deep" / "/".join("x" * 30)
    deep.mkdir(parents=True)
    with pytest.raises(InvalidRecordError, match="more than 20 folders deep"):
        bags_below([tmp_path / "deep"])


def test_a_bag_that_is_written_meanwhile_is_judged_again(place, tmp_path, monkeypatch):
    """What was judged then is not what the bag holds now."""
    bag = shutil.copytree(place / "b/c/sim_0001_step", tmp_path / "bag")
    metadata = (bag / "metadata.yaml").read_bytes()
    (bag / "metadata.yaml").unlink()
    of_bag = judging.Judge.of_bag

    def late(self, path):
        judged = of_bag(self, path)
        (bag / "metadata.yaml").write_bytes(metadata)
        return judged

    monkeypatch.setattr(judging.Judge, "of_bag", late)
    read_fleet([bag], jobs=1, folder=tmp_path)
    monkeypatch.setattr(judging.Judge, "of_bag", of_bag)
    assert read_fleet([bag], jobs=1, folder=tmp_path).units[0].state == "suspected"


def test_bags_without_a_serial_number_do_not_clear_each_other(found):
    short = dict(found.units[0].objects[0], serial_number=None)
    healthy = dict(found.units[2].objects[0], serial_number=None)
    day = 86_400 * 10**9
    objects = [short, *(dict(healthy, bag=f"h{n}", start_time=short["start_time"] + n * day,
                             probabilities=healthy["probabilities"] | {"friction": n / 1e6})
                        for n in range(1, 6))]
    (unit,) = fleet_of(objects).units
    assert (unit.state, unit.finding().split(",")[0]) == ("suspected", "turn short")


def test_numbers_of_a_reason_are_not_taken_for_the_bag(tmp_path):
    reasons = ["1: no metadata.yaml", "+1.1 healthy deviations"]
    moved = judging._of_path({"bag": "1", "reasons": reasons}, tmp_path)
    assert moved["reasons"] == [f"{tmp_path}: no metadata.yaml", "+1.1 healthy deviations"]


def test_units_are_worst_first(found):
    assert [(u.serial_number, u.state) for u in found.units] == [
        ("SIM-0001", "suspected"), ("", "no answer"), ("SIM-0000", "healthy")]
    assert found.units[0].finding().startswith("turn short, phase b 9.68 %")
    assert "no metadata.yaml" in found.units[1].finding()
    assert repr(found) == "<Fleet of 3 units, 3 bags: 1 suspected, 1 no answer, 1 healthy>"


def test_a_fault_that_another_test_confirms_comes_first(found):
    again = dict(found.units[0].objects[0], bag="other", start_time=2 * 10**18)
    unit = fleet_of([*found.objects, again]).units[0]
    assert (unit.state, len(unit.objects)) == ("fault", 2)


def test_a_bag_is_judged_once(found, place, cache, monkeypatch):
    def never(_task):
        raise AssertionError("judged again")

    shutil.copytree(place / "a/sim_0000_step", place / "again/copied")
    monkeypatch.setattr(judging, "judge_bags", never)
    objects = read_fleet([place], jobs=1, folder=cache).objects
    shutil.rmtree(place / "again")
    by_bag = {o["bag"]: o for o in objects}
    assert all(by_bag[o["bag"]]["record_sha256"] == o["record_sha256"] for o in found.objects)
    assert str(place / "again/copied") in by_bag  # the same content, another path


def test_a_changed_bag_or_judge_is_judged_again(place, cache, tmp_path, monkeypatch):
    bag = tmp_path / "sim_0000_step"
    shutil.copytree(place / "a/sim_0000_step", bag)
    asked = []
    monkeypatch.setattr(judging, "judge_bags", lambda task: asked.append(task.bags) or
                        judging.BagsDone(task.software, []))
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text() + "# changed\n")
    with pytest.raises(Exception, match="was written while it was judged"):
        read_fleet([bag], jobs=1, folder=cache)
    settings = judging.JudgeSettings.of(None, None)
    assert asked == [(str(bag),)]
    assert settings.key() == settings.key()
    before = settings.key()
    with monkeypatch.context() as other:
        other.setattr(judging, "kit_sha256", lambda: "another kit")
        assert settings.key() != before
    (tmp_path / "en.yaml").write_bytes((judging.FOLDER / "en.yaml").read_bytes() + b"# other")
    monkeypatch.setattr(judging, "FOLDER", tmp_path)  # the words that a verdict is kept with
    assert settings.key() != before


def test_the_store_knows_what_changed(tmp_path):
    bag = tmp_path / "a.mcap"
    bag.write_bytes(b"one")
    os.utime(bag, ns=(1, 1))
    with VerdictStore("j", tmp_path) as store:
        first = store.sha256(bag)
        assert first == hashlib.sha256(b"one").hexdigest()
        said = dict.fromkeys(NEEDED, "") | {"record_sha256": first}
        store.put([(first, said)])
        bag.write_bytes(b"two")
        assert store.sha256(bag) != first
    with VerdictStore("j", tmp_path) as again, VerdictStore("other", tmp_path) as other:
        assert again.get(first) == said
        assert other.get(first) is None
        assert again.get(None) is None
        other._write("INSERT OR REPLACE INTO verdicts VALUES (?, ?, ?)", [("other", "aa", "{")])
    with VerdictStore("other", tmp_path) as damaged:
        assert damaged.get("aa") is None
    (tmp_path / f"v{FORM}_{FILE}").write_bytes(b"damaged" * 1000)
    with VerdictStore("j", tmp_path) as damaged:
        assert damaged.get(first) is None
        damaged.put([(first, said)])
        assert damaged.get(first) == said


def test_a_bag_that_has_not_changed_is_not_read_again(tmp_path, monkeypatch):
    bag = tmp_path / "a.mcap"
    bag.write_bytes(b"one")
    monkeypatch.setattr(verdict_store, "TICK", -1)  # the file is old enough
    with VerdictStore("j", tmp_path) as store:
        first = store.sha256(bag)
    monkeypatch.setattr(verdict_store, "content_hash", lambda _bag: "read again")
    with VerdictStore("j", tmp_path) as store:
        assert store.sha256(bag) == first
        bag.write_bytes(b"longer")
        assert store.sha256(bag) == "read again"


def test_the_hash_is_that_of_sha256sum(place):
    bag = place / "a/sim_0000_step"
    printed = subprocess.run("sha256sum *", cwd=bag, shell=True, check=True, capture_output=True)
    assert content_hash(bag) == hashlib.sha256(printed.stdout).hexdigest()


def test_the_hash_is_of_a_hidden_file_too_that_is_part_of_the_record(repository, tmp_path):
    bag = shutil.copytree(repository / "bags/sim_0000_step", tmp_path / "sim_0000_step")
    file, metadata = bag / "sim_0000_step_0.mcap", bag / "metadata.yaml"
    (bag / ".DS_Store").write_bytes(b"of a desktop")
    usual = content_hash(bag)
    (bag / ".DS_Store").write_bytes(b"changed")
    assert content_hash(bag) == usual
    metadata.write_text(metadata.read_text().replace(file.name, f"'.{file.name}'"))
    hidden = file.rename(bag / f".{file.name}")
    whole = content_hash(bag)
    hidden.write_bytes(hidden.read_bytes()[:1000])
    assert content_hash(bag) != whole


def test_parts_of_a_recorder_that_died_are_one_bag_from_within_too(tmp_path, monkeypatch):
    (tmp_path / "parts").mkdir()
    for k in (0, 1):
        (tmp_path / "parts" / f"parts_{k}.mcap").write_bytes(b"")
    assert bags_below([tmp_path / "parts"]) == [tmp_path / "parts"]
    monkeypatch.chdir(tmp_path / "parts")
    assert bags_below([Path()]) == [tmp_path / "parts"]  # by its name


def test_every_object_keeps_the_contract(found):
    text = (files("ema_prognostics.verdict") / "verdict.schema.json").read_text("utf-8")
    assert text == schema.schema_text()
    for one in found.objects:
        said = json.loads(json.dumps(one))
        checked = schema.VerdictObject.model_validate(said, strict=False)
        assert checked.schema_ == contract.SCHEMA
        assert set(json.loads(text)["required"]) <= set(said)
        assert set(said) - {"flight", "repeat_of", "start_time"} <= set(
            json.loads(text)["properties"])
        assert [s.times for s in checked.evidence] == [s["times"] for s in said["evidence"]]
    assert any(one["evidence"] for one in found.objects)
    with pytest.raises(ValueError, match="verdict"):
        schema.VerdictObject.model_validate(said | {"verdict": "fine"})
    fault = found.units[0].objects[0]
    assert (fault["time"], fault["profile"]) == ("2026-09-21T14:23:20.000Z", "step")
    assert found.units[1].objects[0]["serial_number"] is None


def test_tables_for_others(found, tmp_path):
    import pandas as pd
    import pyarrow.parquet as pq

    write_parquet(found.objects, tmp_path / "f.parquet")
    read = pd.read_parquet(tmp_path / "f.parquet")
    assert list(read.columns) == list(COLUMNS)
    assert read.severity.dropna().tolist() == [found.units[0].objects[0]["severity"]]
    assert str(read.time.dt.tz) == "UTC"
    assert pq.read_schema(tmp_path / "f.parquet").metadata[b"written_by"] == b"ema fleet"
    assert found.to_pandas().shape == read.shape


def test_metrics_are_open_metrics(found):
    lines = open_metrics(found).splitlines()
    assert lines[-1] == "# EOF"
    sample = re.compile(r'^[a-z_]+\{([a-z_]+="(\\.|[^"\\])*"(,|(?=\})))*\} [0-9.e+-]+$')
    families = [line.split()[2] for line in lines if line.startswith("# TYPE")]
    for line in lines[:-1]:
        assert line.startswith("# ") or (sample.match(line) and line.split("{")[0] in families)
    assert 'ema_unit_state{serial_number="SIM-0001",ema_unit_state="suspected"} 1' in lines
    assert len(families) == len(set(families))


@pytest.fixture
def command(place, cache, monkeypatch, tmp_path):
    monkeypatch.setattr("ema_prognostics.fleet.verdict_store.cache_directory", lambda: cache)
    return lambda *options: run(["fleet", str(place), "--jobs", "1", *map(str, options)])


def test_the_command(found, command, capsys, tmp_path):
    files = [tmp_path / "f.html", tmp_path / "f.parquet", tmp_path / "f.prom"]
    options = [x for pair in zip(("--html", "--parquet", "--metrics"), files) for x in pair]
    assert command(*options) == 3
    printed = capsys.readouterr().out
    assert printed.index("SIM-0001") < printed.index("SIM-0000")
    assert command(*options) == 3  # its own files are replaced
    page = files[0].read_text()
    assert not re.search(r'(src|href)="(?!data:)', page)  # needs no other file, no report yet
    assert page.index("SIM-0001") < page.index("SIM-0000")
    mine = "<!doctype html><!-- mine, on ema fleet: # TYPE ema_unit_state gauge -->"
    for file in files:
        file.write_text(mine)
        capsys.readouterr()
        assert command(f"--{'metrics' if file.suffix == '.prom' else file.suffix[1:]}", file) == 2
        assert "never overwritten" in capsys.readouterr().err
        assert file.read_text() == mine
    os.mkfifo(tmp_path / "pipe")  # nobody writes to it
    for option in ("--html", "--parquet", "--metrics"):
        assert command(option, tmp_path / "pipe") == 2
        assert "never overwritten" in capsys.readouterr().err
    assert command("--profile", os.fsdecode(b"\xff")) == 2


def test_a_folder_whose_name_is_not_utf_8(place, monkeypatch, tmp_path):
    monkeypatch.setattr(verdict_store, "TICK", 0)
    monkeypatch.setattr("ema_prognostics.fleet.verdict_store.cache_directory", lambda: tmp_path)
    odd = shutil.copytree(place, tmp_path / os.fsdecode(b"\xff"))
    files = [tmp_path / "f.html", tmp_path / "f.parquet", tmp_path / "f.prom"]
    options = [str(x) for pair in zip(("--html", "--parquet", "--metrics"), files) for x in pair]
    for _ in range(2):  # the second out of the store
        assert run(["fleet", str(odd), "--jobs", "1", *options]) == 3
    assert "\\udcff" in files[0].read_text(encoding="utf-8")
    with VerdictStore("any", tmp_path) as store:
        assert len(store._states) == 3


def test_the_command_for_machines(found, command, capsys):
    assert command("--format", "csv") == 3
    rows = list(csv.DictReader(StringIO(capsys.readouterr().out)))
    assert [r["verdict"] for r in rows] == ["fault", "incomplete", "healthy"]
    assert float(rows[0]["severity"]) == found.units[0].objects[0]["severity"]
    assert command("--json") == 3
    units = json.loads(capsys.readouterr().out)["units"]
    assert [u["state"] for u in units] == ["suspected", "no answer", "healthy"]
    assert command("--format", "xml") == 2
    assert "give one of text, json, csv" in capsys.readouterr().err
    assert command("--json", "--format", "csv") == 2
    assert "--json and --format csv exclude each other" in capsys.readouterr().err


def test_the_page_links_a_report_and_shows_no_markup_of_a_bag(found, tmp_path):
    from ema_cli.pages.fleet_files import page

    bag = tmp_path / "deep" / "<b>bag"
    bag.parent.mkdir()
    Path(f"{bag}.html").write_text("report")
    one = dict(found.units[0].objects[0], bag=str(bag), serial_number="<script>x</script>")
    text = page(fleet_of([one]), tmp_path / "f.html")
    assert 'href="./deep/%3Cb%3Ebag.html"' in text
    assert "<script>x" not in text
    for name in ("javascript:alert(1)\n", "SN#7?"):
        (tmp_path / f"{name}.html").write_text("report")
        text = page(fleet_of([dict(one, bag=str(tmp_path / name))]), tmp_path / "f.html")
        (link,) = re.findall(r'href="([^"]*)"', text)
        assert link.startswith("./") and unquote(link) == f"./{name}.html"


def test_times_are_iso(found):
    for one in found.objects:
        if one["time"] is not None:
            assert one["time"].endswith("Z")
            TypeAdapter(schema.AwareDatetime).validate_python(one["time"])


def test_an_output_that_cannot_be_made(tmp_path):
    from ema_cli.pages.fleet_files import check_files

    with pytest.raises(OutputError):
        check_files(tmp_path / "no" / "f.html", None, None)
