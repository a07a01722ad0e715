"""The report of a test: same content as page, XML and JSON; hashes that `sha256sum` gives."""

import hashlib
import json
import os
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from ema_cli.main import run
from ema_cli.pages.report_files import as_xml
from ema_prognostics.verdict.contract import kit_sha256
from ema_record.bag.read import read_bag, write_bag
from ema_record.kit import kit_folder
from ema_record.profile import load_profile
from ema_sim.simulate import simulate

LARGEST = 600_000
"""Bytes of a page."""
FIELDS = ["--ata", "27-11-00", "--work-order", "WO <4711> & Co", "--aircraft", "D-EMAX"]


@pytest.fixture(scope="module")
def written(tmp_path_factory, repository):
    """Return the reports of a bag with a turn short, by their endings."""
    folder = tmp_path_factory.mktemp("report")
    files = {end: folder / f"report{end}" for end in (".html", ".xml", ".json")}
    outs = [part for path in files.values() for part in ("--out", str(path))]
    bag = repository / "bags" / "sim_0001_extended"
    assert run(["report", str(bag), *outs, *FIELDS, "--quiet"]) == 1
    return files


class Page(HTMLParser):
    """Collects what a page refers to, and whether its tags are closed."""

    VOID = frozenset({"meta", "br", "link", "img"})

    def __init__(self):
        super().__init__()
        self.open, self.links = [], []

    def handle_starttag(self, tag, attrs):
        if tag not in self.VOID:
            self.open.append(tag)
        self.links += [v for k, v in attrs if k in ("src", "href", "onload")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_page_is_whole_small_and_needs_nothing_else(written):
    text = written[".html"].read_text(encoding="utf-8")
    page = Page()
    page.feed(text)
    assert (page.open, page.links) == ([], [])
    assert "<script" not in text and "@import" not in text and "url(" not in text
    assert len(text.encode()) < LARGEST
    said = " ".join(re.sub(r"<[^>]+>", " ", text.partition("</style>")[2]).split())
    for part in ("SIM-0001", "27-11-00", "WO &lt;4711&gt; &amp; Co", "FAULT", "MEDIUM",
                 "Shorted turns, phase b", "Plan the replacement", "command reached",
                 "≤ 9.78 mrad", "torque pulses twice a turn", "passed", "Tested by",
                 "Inspected by"):
        assert part in said, part


def test_hashes_are_those_of_the_files(written, repository):
    data = json.loads(written[".json"].read_text())
    bag = repository / "bags" / "sim_0001_extended"
    found = {one["file"]: one for one in data["trace"]["files"]}
    tests = kit_folder() / "profiles"
    assert set(found) == {"actuator.yaml", "cascade.json", *(p.name for p in tests.iterdir()),
                          *(p.name for p in bag.iterdir())}
    for folder in (bag, kit_folder(), tests):
        for path in folder.iterdir():
            if path.name in found:
                content = path.read_bytes()
                assert found[path.name]["sha256"] == hashlib.sha256(content).hexdigest()
                assert found[path.name]["bytes"] == len(content)
    page = written[".html"].read_text()
    assert all(one["sha256"] in page for one in found.values())
    assert data["trace"]["software_sha256"] in page
    assert data["trace"]["kit"] == f"default kit {kit_sha256()[:8]}"


def test_xml_holds_what_json_holds(written):
    data = json.loads(written[".json"].read_text())
    root = ET.fromstring(written[".xml"].read_text())
    assert root.find("UUT").get("serialNumber") == data["unit"]["serial_number"] == "SIM-0001"
    assert root.find("ResultSet/Outcome").get("value") == data["outcome"] == "Failed"
    tests = {one.get("name"): one for one in root.findall("ResultSet/Test")}
    assert list(tests) == [*(c["name"] for c in data["checks"]), "diagnosis"]
    for check in data["checks"]:
        given = {r.get("name"): r for r in tests[check["name"]].findall("TestResult")}
        for value in check["values"]:
            datum = given[value["name"]].find("TestData/Datum")
            assert (datum.get("value"), datum.get("unit") or "") == (value["value"], value["unit"])
            limit = given[value["name"]].find("TestLimits/Limit")
            assert (None if limit is None else float(limit.get("value"))) == value["limit"]
            if limit is not None and check["outcome"] == "Passed":
                assert abs(float(value["value"])) <= value["limit"]
    fault = tests["diagnosis"].find("Fault")
    assert float(fault.get("severity")) == data["verdict"]["faults"][0]["severity"]
    assert len(root.findall("Configuration/File")) == len(data["trace"]["files"])


def test_xml_is_read_whatever_a_record_calls_its_unit(written):
    data = json.loads(written[".json"].read_text())
    data["unit"]["serial_number"] = "S\x01\x1b\ufffe1"
    root = ET.fromstring(as_xml(data, None))
    assert root.find("UUT").get("serialNumber") == "S\ufffd\ufffd\ufffd1"


@pytest.mark.parametrize("text", ["a\x01b", "two\nlines", "\udcff", "x" * 201])
@pytest.mark.parametrize("option", ["--ata", "--aircraft", "--work-order", "--operator"])
def test_what_no_page_can_hold_is_refused(repository, tmp_path, capsys, option, text):
    bag, out = repository / "bags" / "sim_0001_step", tmp_path / "report.xml"
    assert run(["report", str(bag), "--out", str(out), option, text]) == 2
    assert f"{option} {text[:40]!r}: expected at most 200 characters" in capsys.readouterr().err
    assert not out.exists()


def test_what_nobody_gave_is_not_made_up(repository, tmp_path):
    out = [tmp_path / f"report{end}" for end in (".html", ".xml")]
    for path in out:
        run(["report", str(repository / "bags" / "sim_0001_step"), "--out", str(path)])
    assert "<dt>ATA chapter</dt><dd></dd>" in out[0].read_text()
    assert ET.fromstring(out[1].read_text()).find("WorkOrder").attrib == {}


def test_names_that_are_not_utf_8_are_shown_as_on_the_screen(repository, tmp_path):
    odd = tmp_path / os.fsdecode(b"\xff")
    bag = shutil.copytree(repository / "bags" / "sim_0001_step", odd / "bag")
    kit = shutil.copytree(repository / "config", odd / "kit",
                          ignore=shutil.ignore_patterns("library"))
    for end in (".html", ".xml", ".json"):
        out = tmp_path / f"report{end}"
        assert run(["report", str(bag), "--kit", str(kit), "--out", str(out)]) == 1
        assert "kit" in out.read_text(encoding="utf-8")


@pytest.mark.parametrize(("arguments", "problem"), [
    (["bags/sim_0001_step", "--out", "x.pdf"], "end the name with .html, .xml, .json"),
    (["bags/sim_0001_step", "bags/sim_0000_step", "--out", "x.html"], "2 actuators"),
    (["nowhere", "--out", "x.html"], "no report: "),
    (["cut", "--out", "x.xml", "--out", "./x.xml"], "two results in one place"),
    (["cut", "--out", "x.html"], "no report: cut: "),
    (["bags/sim_0001_step", "--out", "README.md"], "end the name"),
])
def test_wrong_use_is_one_line_and_writes_nothing(
        arguments, problem, repository, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bags").symlink_to(repository / "bags")
    (tmp_path / "cut").mkdir()
    (tmp_path / "cut" / "cut_0.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert run(["report", *arguments]) == (3 if "no report: cut" in problem else 2)
    error = capsys.readouterr().err
    assert problem in error and error.count("\n") == 1
    assert {p.name for p in tmp_path.iterdir()} == {"bags", "cut"}


def test_what_is_there_is_not_overwritten(written, repository, capsys):
    before = written[".html"].read_bytes()
    bag = str(repository / "bags" / "sim_0001_step")
    assert run(["report", bag, "--out", str(written[".html"])]) == 2
    assert "never overwritten" in capsys.readouterr().err
    assert written[".html"].read_bytes() == before


def test_a_record_that_cannot_be_read_may_be_the_newest(repository, tmp_path, capsys):
    for name in ("f_1", "f_2"):
        shutil.copytree(repository / "bags" / "sim_0000_step", tmp_path / "all" / name)
    (cut,) = (tmp_path / "all" / "f_2").glob("*.mcap")
    cut.write_bytes(cut.read_bytes()[:20_000])
    assert run(["report", str(tmp_path / "all"), "--out", str(tmp_path / "r.html")]) in (2, 3)
    said = capsys.readouterr().err
    assert "f_2" in said and "leave it out" in said and said.count("\n") == 1
    assert not (tmp_path / "r.html").exists()


def test_a_report_without_a_name_lies_beside_the_test_that_it_is_of(
        repository, tmp_path, monkeypatch, capsys):
    """The newest one, wherever it stands among those that are given."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bags").mkdir()
    for name in ("sim_0001_step", "sim_0001_extended"):
        shutil.copytree(repository / "bags" / name, tmp_path / "bags" / name)
    given = ["bags/sim_0001_extended", "bags/sim_0001_step"]
    last = max(given, key=lambda bag: read_bag(bag).provenance.start_time)
    first = next(bag for bag in given if bag != last)
    assert run(["report", last, first, "--quiet"]) == 1
    assert [p.name for p in (tmp_path / "bags").glob("*.html")] == [f"{Path(last).name}.html"]


@pytest.fixture
def chromium():
    """Return a browser without a window."""
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        pytest.skip("no chromium on this machine: the page is NOT tested in a browser")
    return found


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_it_prints_on_one_page_and_fits_narrow_and_wide_windows(written, chromium, tmp_path):
    page = written[".html"]

    def browse(*options):
        return subprocess.run(
            [chromium, "--headless", "--no-sandbox", "--disable-gpu",
             f"--user-data-dir={tmp_path / 'profile'}", *options], check=True, timeout=200,
            capture_output=True, text=True, env={**os.environ, "HOME": str(tmp_path)})

    for source in (page, written_with_trend(page, tmp_path)):
        pdf = tmp_path / f"{source.stem}.pdf"
        browse("--no-pdf-header-footer", f"--print-to-pdf={pdf}", source.as_uri())
        assert len(re.findall(rb"/Type /Page\b(?!s)", pdf.read_bytes())) == 1
    script = ("<script>addEventListener('load',()=>document.title='wide '+"
              "(document.documentElement.scrollWidth-innerWidth))</script></body>")
    probe = tmp_path / "probe.html"
    probe.write_text(page.read_text().replace("</body>", script))
    for width in (500, 1400):
        out = browse("--dump-dom", f"--window-size={width},900", probe.as_uri()).stdout
        assert int(re.search(r"<title>wide (-?\d+)", out)[1]) <= 0, width


def written_with_trend(page, folder):
    """Return the fullest page there can be: two charts of a trend, long fields."""
    from ema_cli.pages.report_files import as_page
    from ema_record.bag.read import read_bag

    data = json.loads(page.with_suffix(".json").read_text())
    (fault,) = data["verdict"]["faults"]
    second = {**fault, "fault_class": "friction", "phase": None}
    data["verdict"]["faults"].append(second)
    data["trend"] = [{"verdict": "fault", "faults": [fault, second]}] * 9
    data["checks"].append(data["checks"][-1])
    full = folder / "full.html"
    full.write_text(as_page(data, read_bag(data["verdict"]["bag"])))
    return full


@pytest.mark.parametrize("date", [0, 315_532_800 * 10**9])
def test_of_several_records_the_newest_is_known(tmp_path, capsys, date):
    """One that nothing dates, or a clock that was not set, may be the newest."""
    bags = [str(write_bag(simulate(load_profile("step"), start_time=start), tmp_path / name))
            for name, start in (("a", 1_790_000_000 * 10**9), ("b", date))]
    assert run(["report", *bags]) == 2
    assert "it may be the newest, give it alone" in capsys.readouterr().err
    assert run(["report", bags[1]]) == 0
