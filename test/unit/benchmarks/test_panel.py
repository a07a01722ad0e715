"""The blind panel as a whole: units identified once, cut short, with a proposed test, tampered."""

import json
import re

import pytest

from benchmarks.blind_panel.__main__ import main, run
from benchmarks.blind_panel.rates import RECENT, ROWS, all_found, pooled, table
from benchmarks.blind_panel.score import score
from benchmarks.blind_panel.tasks import BAGS, IDENTIFIED, SEALED, read_tasks
from benchmarks.blind_panel.truth.answers import Panel
from benchmarks.blind_panel.truth.prepare import opened, prepare, record_proposed
from benchmarks.blind_panel.truth.seal import ANSWERS
from benchmarks.ledger import Ledger
from ema_record.bag.read import read_bag
from ema_record.profile import load_profile

OPTIONS = ["--seed", "9", "--each", "2", "--tests", "step", "--strata", "own, one"]
PANEL = Panel(9, ("step",), {"own, one effect": 2})


def say(out, key, *names, verdict="explained"):
    """Write what would be said of a unit: one set of names, `step` proposed for it."""
    finding = {"effect": names[0], "equivalent": names[1:], "parameters": [], "choices": {}}
    Ledger(out / IDENTIFIED).run(key, lambda: {
        "verdict": verdict, "findings": [finding], "unknown": None, "cpu": 1.0, "wall": 2.0,
        "next_profile": load_profile("step").model_dump(mode="json")})


@pytest.fixture
def sealed(tmp_path, capsys):
    """Return a folder with two units that are sealed and recorded, and their answers."""
    prepare(tmp_path, PANEL, 1)
    capsys.readouterr()
    return tmp_path, [answer for answers in opened(tmp_path, PANEL) for answer in answers]


@pytest.mark.slow
def test_units_are_judged_two_at_a_time_and_none_twice(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    panel = Panel(20263201, ("step",), {"own, nothing": 2, "own, unlisted off, nothing": 1})
    run(tmp_path, panel, 2)
    rows = Ledger(tmp_path / IDENTIFIED)
    assert rows.keys == {a.id for answers in opened(tmp_path, panel) for a in answers}
    assert {rows.run(key, dict)["verdict"] for key in rows.keys} == {"no disagreement"}
    first, kept = capfd.readouterr().out, (tmp_path / IDENTIFIED).read_bytes()
    assert first.count("no disagreement") == 3 and "own" not in first
    run(tmp_path, panel, 2)
    assert (tmp_path / IDENTIFIED).read_bytes() == kept
    assert capfd.readouterr().out == first.splitlines(keepends=True)[0]
    score(tmp_path, panel, visible=False)
    told = capfd.readouterr().out
    (commitment,) = set(re.findall(r"SHA-256 (\w{64})", first))
    assert f"answers as committed, part 1, SHA-256 {commitment}\n3 of 3 units" in told
    assert "| own, nothing | 2 | 0 (0-84.2 %) |" in told


def test_bags_and_commitment_are_made_before_anything_is_identified(sealed, capsys):
    out, answers = sealed
    assert [task.id for task in read_tasks(out)] == [a.id for a in answers]
    assert {path.name for path in (out / BAGS).iterdir()} == {a.id for a in answers}
    assert not (out / IDENTIFIED).exists()
    told = "".join(path.read_text(encoding="utf-8") for path in out.glob("*.*"))
    assert not [a for a in answers if a.stratum in told or a.names[0] in told]
    prepare(out, PANEL._replace(counts={"own, one effect": 3}), 1)
    assert re.findall(r"part (\d)", capsys.readouterr().out) == ["1", "2"]
    assert {a.id for a in answers} < {task.id for task in read_tasks(out)}


def test_the_table_of_a_panel_that_was_cut_short(sealed, capsys):
    out, answers = sealed
    say(out, answers[1].id, *answers[1].names)
    main(["--out", str(out), *OPTIONS, "--table"])
    told = capsys.readouterr().out
    assert "1 of 2 units identified" in told
    assert "| own, one effect | 1 | 1 (2.5-100 %) |" in told
    rows = json.loads((out / SEALED / "rows.json").read_text(encoding="utf-8"))
    assert [row["k"] for row in rows["own, one effect"]] == [1]


def test_a_set_has_its_proposed_test_recorded_whether_it_is_right_or_not(sealed, capsys):
    out, (one, other) = sealed
    say(out, one.id, one.names[0], "a look-alike")
    say(out, other.id, "wrong", "wrong too")
    record_proposed(out, PANEL)
    for answer in (one, other):
        record = read_bag(out / BAGS / answer.id / "next")
        before = read_bag(out / BAGS / answer.id / "measured")
        assert record.profile == load_profile("step")
        assert record.provenance.serial_number == before.provenance.serial_number
        assert record.provenance.start_time > before.provenance.start_time
        assert (record.samples[:, 1] != before.samples[:, 1]).any()
    say(out, f"{one.id}/next", *one.names)
    say(out, f"{other.id}/next", *other.names)
    score(out, PANEL, visible=False)
    assert "1 (2.5-100 %) of 1, >= 85 %; 1 sets, 1 with a command" in capsys.readouterr().out


def test_one_name_or_a_contradiction_has_no_further_test(sealed):
    out, (one, other) = sealed
    say(out, one.id, *one.names)
    say(out, other.id, "a", "b", verdict="contradicted")
    record_proposed(out, PANEL)
    assert not list((out / BAGS).glob("*/next"))


def refused(capsys, *arguments):
    """Return the last line of an error; status 2."""
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    return capsys.readouterr().err.splitlines()


def test_answers_that_were_tampered_with_are_refused_in_one_line(sealed, capsys):
    out, answers = sealed
    say(out, answers[0].id, *answers[0].names)
    path = out / SEALED / "1" / ANSWERS
    damaged = bytearray(path.read_bytes())
    damaged[40] ^= 1
    path.write_bytes(damaged)
    for more in ([], ["--table"]):
        (line,) = refused(capsys, "--out", str(out), *OPTIONS, *more)
        assert "not what was committed to" in line


def test_a_wrong_stratum_test_or_folder_is_told(tmp_path, capsys):
    out = ["--out", str(tmp_path), "--seed", "9", "--each", "1"]
    assert "none begins so, there are own, nothing" in refused(
        capsys, *out, "--strata", "theirs")[-1]
    assert "nowhere" in refused(capsys, *out, "--tests", "nowhere")[-1]
    (line,) = refused(capsys, *out, "--table")
    assert "holds no unit of this panel" in line
    assert not list(tmp_path.iterdir())


def counted(*rows, since=0):
    """Return the counts of rows together, as the README writes them."""
    right, of = (sum(x) for x in zip(*(pooled(all_found(), row, since) for row in rows)))
    return f"{right} of {of}"


BEYOND = "nothing, own, bands x 1.3", "nothing, second, bands x 1.3"
NOTHING = "nothing, own", "nothing, own, everything off", "nothing, second"
ONE = "one, own", "one, own, everything off", "one, own, bands x 1.3"
SECOND = "one, second", "one, PWM", "one, FOC"
TWO = "two, own", "two, own, everything off", "two, second"
README = {
    "`ema identify`, one effect": [
        *map(counted, ONE), counted(*SECOND),
        *(counted(row, since=RECENT) for row in ONE), counted(*SECOND, since=RECENT)],
    "two effects, both named": [
        *map(counted, TWO), *(counted(row, since=RECENT) for row in TWO)],
    "any name on nothing": [
        *map(counted, NOTHING), counted(*BEYOND), counted("nothing, PWM and FOC"),
        counted(*NOTHING, *BEYOND, "nothing, PWM and FOC", since=RECENT)],
    "what has changed since acceptance": [
        counted("accepted, own", "accepted, second"),
        counted("nothing since acceptance, own", "nothing since acceptance, second")],
    "wrong names on units": [counted("wrong name"), counted("wrong name", since=RECENT)],
}


@pytest.mark.parametrize("row", README)
def test_readme_says_what_the_panels_found(row, repository):
    line, = (x for x in (repository / "README.md").read_text(encoding="utf-8").splitlines()
             if x.startswith(f"| {row}"))
    assert re.findall(r"\d+ of \d+", line) == README[row]


def test_identification_page_has_the_table_of_the_panels(repository):
    assert table() in (repository / "docs" / "identification.md").read_text(encoding="utf-8")


def test_every_row_of_the_panels_is_in_the_table():
    found = all_found()
    assert {f.row for f in found} == set(ROWS)
    assert all(0 <= f.right <= f.of for f in found)
    assert len({(f.panel, f.row) for f in found}) == len(found)
