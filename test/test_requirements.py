"""Requirements and leaves of the fault tree have tests; `requirements.py` finds those not run."""

import ast

import pytest
from requirements import leaves, main, not_shown, outcomes, rows


def names_of(path):
    """Return the test functions of a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def wrong_numbers(found):
    """Return the numbers that do not follow the one before."""
    wrong, expected = [], (1, 1)
    for number, chapter, place, _, _ in found:
        if (chapter, place) not in (expected, (expected[0] + 1, 1)):
            wrong.append(number)
        expected = (chapter, place + 1)
    return wrong


def missing(found, root):
    """Return requirements without a test, and tests that are not there."""
    wrong = []
    for number, _, _, _, tests in found:
        if not tests:
            wrong.append(f"{number}: no test")
        for node in tests:
            file, _, name = node.partition("::")
            path = root / file
            if not path.is_file() or name.partition("[")[0] not in names_of(path):
                wrong.append(f"{number}: {node} does not exist")
    return wrong


@pytest.fixture(scope="module")
def requirements(repository):
    return rows((repository / "docs" / "requirements.md").read_text(encoding="utf-8"))


def test_requirements_are_numbered_in_order(requirements):
    assert len(requirements) > 40
    assert wrong_numbers(requirements) == []
    assert all(len(words) > 20 for _, _, _, words, _ in requirements)


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
    for _, _, _, _, tests in requirements:
        for node in tests:
            file, _, name = node.partition("::")
            value = name.partition("[")[2].removesuffix("]")
            if value:
                assert f'"{value}"' in (repository / file).read_text(encoding="utf-8"), node


@pytest.mark.parametrize(("text", "count"), [
    ("| R1.1 | something that must be so |  |", 1),
    ("| R1.1 | something | `test/test_requirements.py::test_that_is_not_there` |", 1),
    ("| R1.1 | something | `test/nowhere.py::test_x` |", 1),
    ("| R1.1 | something | `test/test_requirements.py::test_violations_are_found` |", 0),
])
def test_violations_are_found(text, count, repository):
    found = rows(text)
    assert len(found) == 1
    assert len(missing(found, repository)) == count


def test_a_wrong_number_is_found():
    numbers = ["R1.1", "R1.2", "R2.1"]
    lines = [f"| {n} | x | `a.py::b` |" for n in numbers]
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
    table = rows(f"| R1.1 | something | `test/unit/test_a.py::test_{name}` |")
    wrong = not_shown(table, outcomes([tmp_path / "results.xml"]))
    assert wrong == ([f"R1.1: test/unit/test_a.py::test_{name} {says}"] if says else [])


def test_results_without_the_tests_of_the_table_are_a_failure(tmp_path, capsys):
    (tmp_path / "results.xml").write_text(RESULTS, encoding="utf-8")
    assert main([str(tmp_path / "results.xml")]) == 1
    assert "R1.1: test/unit/monitor/" in capsys.readouterr().out
    assert main([]) == 2
