"""Every requirement was shown by tests that ran and passed.

``python test/requirements.py RESULTS.xml...`` compares the table of docs/requirements.md and the
fault tree of docs/safety.md with pytest's JUnit files: one line and status 1 for each test of them
that did not run or failed.
"""

from __future__ import annotations

import re
import sys
import xml.etree.ElementTree as ET  # of our own files
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

DOCS = Path(__file__).resolve().parents[1] / "docs"
TABLE, FAULT_TREE = DOCS / "requirements.md", DOCS / "safety.md"
ROW = re.compile(r"^\| (R(\d+)\.(\d+)) \| (.+?) \| (.*) \|$")
LEAF, SHOWN = re.compile(r"\+- ([A-Z])(\d+) (.+)"), re.compile(r"^\| ([A-Z]\d.*?) \| (.*) \|$")
NODE = re.compile(r"`([^`]+\.py::[^`]+)`")


class Requirement(NamedTuple):
    """A row of the table."""

    number: str
    chapter: int
    place: int
    """In its chapter."""
    text: str
    tests: list[str]
    """Node ids of pytest."""


def rows(text: str) -> list[Requirement]:
    """Return the requirements of a table in Markdown."""
    found = []
    for line in text.splitlines():
        if match := ROW.match(line):
            number, chapter, place, words, tests = match.groups()
            found.append(
                Requirement(number, int(chapter), int(place), words, NODE.findall(tests)))
    return found


def leaves(text: str) -> list[Requirement]:
    """Return the leaves of the fault tree in Markdown, each with the tests that show it."""
    shown: dict[str, list[str]] = {}
    for match in filter(None, map(SHOWN.match, text.splitlines())):
        shown |= dict.fromkeys(match.group(1).split(", "), NODE.findall(match.group(2)))
    return [
        Requirement(f"{branch}{place}", ord(branch) - ord("A") + 1, int(place), words,
                    shown.get(f"{branch}{place}", []))
        for branch, place, words in LEAF.findall(text)
    ]


def outcomes(paths: Iterable[Path]) -> dict[str, str]:
    """Return `passed`, `failed` or `skipped` of each test in JUnit files, by its node id.

    The worst counts where a test is in there several times.
    """
    order = ("skipped", "passed", "failed")
    found: dict[str, str] = {}
    for path in paths:
        for case in ET.parse(path).iter("testcase"):
            file = case.get("classname", "").replace(".", "/") + ".py"
            kinds = {child.tag for child in case}
            outcome = ("failed" if kinds & {"failure", "error"}
                       else "skipped" if "skipped" in kinds else "passed")
            node = f"{file}::{case.get('name')}"
            found[node] = max(found.get(node, outcome), outcome, key=order.index)
    return found


def not_shown(table: list[Requirement], found: dict[str, str]) -> list[str]:
    """Return a line for each test of the table that did not run, was skipped or failed.

    A test with parameters is shown when none of its cases failed and one passed.
    """
    wrong = []
    for requirement in table:
        for node in requirement.tests:
            seen = {outcome for name, outcome in found.items()
                    if name == node or name.startswith(node + "[")}
            if "failed" in seen:
                wrong.append(f"{requirement.number}: {node} failed")
            elif "passed" not in seen:
                what = "was skipped" if seen else "did not run"
                wrong.append(f"{requirement.number}: {node} {what}")
    return wrong


def main(paths: list[str]) -> int:
    """Print what is not shown; return 0 when all is, 1 otherwise, 2 without results."""
    if not paths:
        print("usage: python test/requirements.py RESULTS.xml...", file=sys.stderr)
        return 2
    table = [*rows(TABLE.read_text(encoding="utf-8")),
             *leaves(FAULT_TREE.read_text(encoding="utf-8"))]
    wrong = not_shown(table, outcomes(map(Path, paths)))
    print("\n".join([*wrong, f"{len(table)} requirements and leaves of the fault tree, "
                     f"{len(wrong)} tests of them not shown"]))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
