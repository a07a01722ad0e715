"""Every requirement was shown by tests that ran and passed, and every interface has one.

``python test/requirements.py RESULTS.xml...`` compares the table of docs/requirements.md and the
fault tree of docs/safety.md with pytest's JUnit files, and the table with the topics, services,
parameters and commands of this tree: one line and status 1 for each test of them that did not run
or failed, and each interface that no row names. A test that was skipped, for want of a browser
say, has a line; it is an error only where none of its requirement's other tests passed.
"""

from __future__ import annotations

import ast
import re
import sys
import xml.etree.ElementTree as ET  # of our own files
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
TABLE, FAULT_TREE = ROOT / "docs" / "requirements.md", ROOT / "docs" / "safety.md"
ROW = re.compile(r"^\| (R(\d+)\.(\d+)) \| (.+?) \| (\w*) \| ([\w, ]*) \| (.*) \|$")
NEED = re.compile(r"^\| (N\d+) \| .+ \|$", re.MULTILINE)
LEAF, SHOWN = re.compile(r"\+- ([A-Z])(\d+) (.+)"), re.compile(r"^\| ([A-Z]\d.*?) \| (.*) \|$")
NODE = re.compile(r"`([^`]+\.py::[^`]+)`")
METHODS = frozenset({"test", "demonstration", "analysis", "inspection"})
EVERY_NODE = "ema_ros"
"""The package whose parameters each node has."""
EFFECTS = "EFFECT.PARAMETER"
"""Stands for the parameters of all effects, which have their own table."""
SHOWN_BY_OTHERS = ", other tests of it passed"


class Requirement(NamedTuple):
    """A row of the table."""

    number: str
    chapter: int
    place: int
    """In its chapter."""
    text: str
    need: str
    """Number of the need that it comes from."""
    methods: list[str]
    """By which it is shown."""
    tests: list[str]
    """Node ids of pytest."""


def rows(text: str) -> list[Requirement]:
    """Return the requirements of a table in Markdown."""
    found = []
    for line in text.splitlines():
        if match := ROW.match(line):
            number, chapter, place, words, need, methods, tests = match.groups()
            found.append(Requirement(number, int(chapter), int(place), words, need,
                                     re.split(", *", methods), NODE.findall(tests)))
    return found


def leaves(text: str) -> list[Requirement]:
    """Return the leaves of the fault tree in Markdown, each with the tests that show it."""
    shown: dict[str, list[str]] = {}
    for match in filter(None, map(SHOWN.match, text.splitlines())):
        shown |= dict.fromkeys(match.group(1).split(", "), NODE.findall(match.group(2)))
    return [
        Requirement(f"{branch}{place}", ord(branch) - ord("A") + 1, int(place), words, "", [],
                    shown.get(f"{branch}{place}", []))
        for branch, place, words in LEAF.findall(text)
    ]


def without_origin(table: list[Requirement], text: str) -> list[str]:
    """Return a line for each requirement without need or method, and each need without one."""
    needs = set(NEED.findall(text))
    wrong = [f"{row.number}: no need {row.need!r}" for row in table if row.need not in needs]
    wrong += [f"{row.number}: no method {method!r}" for row in table for method in row.methods
              if method not in METHODS]
    return wrong + [f"{need}: no requirement" for need in sorted(needs - {r.need for r in table})]


def interfaces(root: Path) -> dict[str, set[str]]:
    """Return topics, services, parameters and commands of a tree, as requirements name them.

    Topics and services are those of the SROS 2 policy, which a test compares with a running
    graph, and of the table of topics; a parameter is each `ParameterSpec` that is made anywhere.
    """
    found: dict[str, set[str]] = {kind: set() for kind in (
        "topics", "services", "parameters", "commands")}
    policy = ET.parse(root / "config" / "sros2" / "policy.xml").getroot()
    for kind in ("topics", "services"):
        for name in policy.iter(kind.removesuffix("s")):
            found[kind].add(re.sub(r"^/ema_\w+/", "~/", name.text or ""))
    for node in ast.walk(_parsed(root / "ema_record" / "wire" / "topics.py")):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant):
            name = str(node.value.value)
            if name.startswith("/"):
                found["services" if name.startswith("/ema_") else "topics"].add(
                    re.sub(r"^/ema_\w+/", "~/", name))
    for path in sorted(root.glob("ema_*/**/*.py")):
        if "ParameterSpec(" in path.read_text(encoding="utf-8"):
            found["parameters"] |= _parameters(path, path.relative_to(root).parts[0])
    for node in _parsed(root / "ema_cli" / "main.py").body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "COMMANDS":
            found["commands"] = {f"ema {name}" for name in ast.literal_eval(node.value)}
    return found


def _parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _parameters(path: Path, package: str) -> set[str]:
    """Return the parameters that a module declares; those without a fixed name are effects'."""
    names = set()
    for node in ast.walk(_parsed(path)):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "ParameterSpec":
            (given,) = (word.value for word in node.keywords if word.arg == "name")
            name = given.value if isinstance(given, ast.Constant) else EFFECTS
            names.add(str(name) if package == EVERY_NODE else f"{package} {name}")
    return names


def not_required(table: list[Requirement], found: dict[str, set[str]]) -> list[str]:
    """Return a line for each interface that no requirement names."""
    named = {name for row in table for name in re.findall(r"`([^`]+)`", row.text)}
    return [f"{kind}: {name}: no requirement names it"
            for kind, names in found.items() for name in sorted(names - named)]


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

    A test with parameters is shown when none of its cases failed and one passed. The line of one
    that was skipped ends in `SHOWN_BY_OTHERS` where another one of its requirement passed.
    """
    wrong = []
    for requirement in table:
        seen = {node: {outcome for name, outcome in found.items()
                       if name == node or name.startswith(node + "[")}
                for node in requirement.tests}
        others = SHOWN_BY_OTHERS if any("passed" in cases for cases in seen.values()) else ""
        for node, cases in seen.items():
            if "failed" in cases:
                wrong.append(f"{requirement.number}: {node} failed")
            elif "passed" not in cases:
                what = f"was skipped{others}" if cases else "did not run"
                wrong.append(f"{requirement.number}: {node} {what}")
    return wrong


def main(paths: list[str]) -> int:
    """Print what is not shown; return 0 when all is, 1 otherwise, 2 without results."""
    if not paths:
        print("usage: python test/requirements.py RESULTS.xml...", file=sys.stderr)
        return 2
    text = TABLE.read_text(encoding="utf-8")
    table, found = rows(text), interfaces(ROOT)
    shown = [*table, *leaves(FAULT_TREE.read_text(encoding="utf-8"))]
    unshown, unnamed = not_shown(shown, outcomes(map(Path, paths))), not_required(table, found)
    wrong = [*without_origin(table, text), *unnamed, *unshown]
    counts = ", ".join(f"{len(names)} {kind}" for kind, names in found.items())
    print("\n".join([*wrong, f"{len(shown)} requirements and leaves of the fault tree, "
                     f"{len(unshown)} tests of them not shown; "
                     f"{counts}, {len(unnamed)} of them in no requirement"]))
    return 1 if any(not line.endswith(SHOWN_BY_OTHERS) for line in wrong) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
