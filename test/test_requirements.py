"""Requirements have need, method and test, leaves of the fault tree tests, interfaces a row.

`requirements.py` finds those that were not run.
"""

import ast
import shutil

import pytest
from requirements import (
    interfaces,
    leaves,
    main,
    not_required,
    not_shown,
    outcomes,
    rows,
    without_origin,
)


def names_of(path):
    """Return the test functions of a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def wrong_numbers(found):
    """Return the numbers that do not follow the one before."""
    wrong, expected = [], (1, 1)
    for number, chapter, place, *_ in found:
        if (chapter, place) not in (expected, (expected[0] + 1, 1)):
            wrong.append(number)
        expected = (chapter, place + 1)
    return wrong


def missing(found, root):
    """Return requirements without a test, and tests that are not there."""
    wrong = []
    for number, *_, tests in found:
        if not tests:
            wrong.append(f"{number}: no test")
        for node in tests:
            file, _, name = node.partition("::")
            path = root / file
            if not path.is_file() or name.partition("[")[0] not in names_of(path):
                wrong.append(f"{number}: {node} does not exist")
    return wrong


@pytest.fixture(scope="module")
def page(repository):
    return (repository / "docs" / "requirements.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def requirements(page):
    return rows(page)


def test_requirements_are_numbered_in_order(requirements):
    assert len(requirements) > 40
    assert wrong_numbers(requirements) == []
    assert all(len(row.text) > 20 for row in requirements)


def test_every_requirement_is_shown_by_tests_that_exist(requirements, repository):
    assert missing(requirements, repository) == []


def test_every_leaf_of_the_fault_tree_is_shown_by_tests_that_exist(repository):
    found = leaves((repository / "docs" / "safety.md").read_text(encoding="utf-8"))
    assert len(found) > 12
    assert wrong_numbers(found) == []
    assert missing(found, repository) == []


@pytest.mark.parametrize(("row", "wrong"), [
    ("| A1, A2 | `test/test_requirements.py::test_violations_are_found` |", []),
    ("| A1 | `test/test_requirements.py::test_violations_are_found` |", ["A2: no test"]),
    ("| A1, A2 | `test/nowhere.py::test_x` |", [
        f"{leaf}: test/nowhere.py::test_x does not exist" for leaf in ("A1", "A2")]),
])
def test_a_leaf_without_a_test_is_found(row, wrong, repository):
    tree = "+- A  it moves\n|  +- A1 one part fails\n|  +- A2 another one\n\n" + row
    assert missing(leaves(tree), repository) == wrong


def test_names_with_parameters_are_those_of_the_test(requirements, repository):
    for *_, tests in requirements:
        for node in tests:
            file, _, name = node.partition("::")
            value = name.partition("[")[2].removesuffix("]")
            if value:
                assert f'"{value}"' in (repository / file).read_text(encoding="utf-8"), node


def test_every_requirement_comes_from_a_need_and_has_a_method(page, requirements):
    assert page.count("\n| R") == len(requirements)  # no row is written so that it is not read
    assert without_origin(requirements, page) == []


@pytest.mark.parametrize(("row", "says"), [
    ("| R1.1 | x | N1, N2 | test | `a.py::b` |", "N1: no requirement"),  # is no row
    ("| R1.1 | x | N2 | test | `a.py::b` |", "R1.1: no need 'N2'"),
    ("| R1.1 | x |  | test | `a.py::b` |", "R1.1: no need ''"),
    ("| R1.1 | x | N1 | hope | `a.py::b` |", "R1.1: no method 'hope'"),
    ("| R1.1 | x | N1 |  | `a.py::b` |", "R1.1: no method ''"),
])
def test_a_missing_need_or_method_is_found(row, says):
    text = f"| N1 | who needs it |\n{row}\n"
    assert says in without_origin(rows(text), text)


def test_every_interface_has_a_requirement(requirements, repository):
    found = interfaces(repository)
    assert {kind: len(names) > 10 for kind, names in found.items()} == dict.fromkeys(
        ("topics", "services", "parameters", "commands"), True)
    assert not_required(requirements, found) == []


ADDED = [
    ("ema_record/wire/topics.py", '\nPLANTED = "/ema/planted"\n', "topics: /ema/planted"),
    ("config/sros2/policy.xml", "<service>~/planted</service>", "services: ~/planted"),
    ("ema_sim/node/settings.py", '\nPLANTED = ParameterSpec(name="planted", default=0, text="")\n',
     "parameters: ema_sim planted"),
    ("ema_ros/parameters.py", '\nPLANTED = ParameterSpec(name="planted", default=0, text="")\n',
     "parameters: planted"),
    ("ema_cli/main.py", '\nCOMMANDS = ("check", "planted")\n', "commands: ema planted"),
]


@pytest.mark.parametrize(("file", "text", "says"), ADDED, ids=[says for *_, says in ADDED])
def test_an_interface_without_a_requirement_is_found(
        file, text, says, requirements, repository, tmp_path):
    for name in {file for file, *_ in ADDED}:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(repository / name, tmp_path / name)
    changed = tmp_path / file
    before = changed.read_text(encoding="utf-8")
    inside = before.rindex("</services>") if file.endswith(".xml") else len(before)
    changed.write_text(before[:inside] + text + before[inside:], encoding="utf-8")
    wrong = not_required(requirements, interfaces(tmp_path))
    assert wrong == [f"{says}: no requirement names it"]


@pytest.mark.parametrize(("text", "count"), [
    ("| R1.1 | something that must be so | N1 | test |  |", 1),
    ("| R1.1 | something | N1 | test | `test/test_requirements.py::test_that_is_not_there` |", 1),
    ("| R1.1 | something | N1 | test | `test/nowhere.py::test_x` |", 1),
    ("| R1.1 | something | N1 | test | "
     "`test/test_requirements.py::test_violations_are_found` |", 0),
])
def test_violations_are_found(text, count, repository):
    found = rows(text)
    assert len(found) == 1
    assert len(missing(found, repository)) == count


def test_a_wrong_number_is_found():
    numbers = ["R1.1", "R1.2", "R2.1"]
    lines = [f"| {n} | x | N1 | test | `a.py::b` |" for n in numbers]
    assert wrong_numbers(rows("\n".join(lines))) == []
    assert wrong_numbers(rows("\n".join([lines[0], *lines]))) != []
    assert wrong_numbers(rows("\n".join(lines[1:]))) != []


RESULTS = """<testsuites><testsuite>
<testcase classname="test.unit.test_a" name="test_one" />
<testcase classname="test.unit.test_a" name="test_two[x]"><skipped /></testcase>
<testcase classname="test.unit.test_a" name="test_two[y]" />
<testcase classname="test.unit.test_a" name="test_three"><skipped /></testcase>
<testcase classname="test.unit.test_a" name="test_four"><failure>no</failure></testcase>
<testcase classname="test.unit.test_a" name="test_five" />
<testcase classname="test.unit.test_a" name="test_five"><error>teardown</error></testcase>
</testsuite></testsuites>"""


@pytest.mark.parametrize(("name", "says"), [
    ("one", None), ("two", None), ("two[y]", None), ("two[x]", "was skipped"),
    ("three", "was skipped"), ("four", "failed"), ("five", "failed"), ("six", "did not run"),
])
def test_a_requirement_is_shown_by_tests_that_ran(tmp_path, name, says):
    (tmp_path / "results.xml").write_text(RESULTS, encoding="utf-8")
    table = rows(f"| R1.1 | something | N1 | test | `test/unit/test_a.py::test_{name}` |")
    wrong = not_shown(table, outcomes([tmp_path / "results.xml"]))
    assert wrong == ([f"R1.1: test/unit/test_a.py::test_{name} {says}"] if says else [])


def test_a_skipped_test_is_told_and_no_error_where_another_passed(
        tmp_path, monkeypatch, capsys):
    (tmp_path / "results.xml").write_text(RESULTS, encoding="utf-8")
    node = "`test/unit/test_a.py::test_{}`"
    row = f"| R1.1 | x | N1 | test | {node}, {node} |"
    for others, status in (("one", 0), ("three", 1), ("six", 1), ("four", 1)):
        table = rows(row.format("three", others))
        monkeypatch.setattr("requirements.rows", lambda text, table=table: table)
        monkeypatch.setattr("requirements.leaves", lambda text: [])
        monkeypatch.setattr("requirements.without_origin", lambda table, text: [])
        monkeypatch.setattr("requirements.not_required", lambda table, found: [])
        assert main([str(tmp_path / "results.xml")]) == status, others
        assert "R1.1: test/unit/test_a.py::test_three was skipped" in capsys.readouterr().out


def test_results_without_the_tests_of_the_table_are_a_failure(tmp_path, capsys):
    (tmp_path / "results.xml").write_text(RESULTS, encoding="utf-8")
    assert main([str(tmp_path / "results.xml")]) == 1
    out = capsys.readouterr().out
    assert "R1.1: test/unit/monitor/" in out
    assert " 0 of them in no requirement" in out
    assert main([]) == 2
