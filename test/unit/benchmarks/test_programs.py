"""Every program that the README of the benchmarks names is there and can be started."""

import importlib
import re
from pathlib import Path

import pytest

import benchmarks

FOLDER = Path(benchmarks.__file__).parent
TABLE = [line.split("|")[1] for line in (FOLDER / "README.md").read_text(
    encoding="utf-8").splitlines() if line.startswith("| `")]
PROGRAMS = sorted({name for cell in TABLE for name in re.findall(r"`([\w.]+)`", cell)})


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_can_be_started(name):
    module = importlib.import_module(f"benchmarks.{name}")
    if hasattr(module, "__path__"):
        module = importlib.import_module(f"benchmarks.{name}.__main__")
    assert callable(module.main)


def test_every_program_is_named():
    made = {path.stem for path in FOLDER.glob("*.py") if "def main(" in path.read_text(
        encoding="utf-8")} | {path.parent.name for path in FOLDER.glob("*/__main__.py")}
    assert made <= set(PROGRAMS)
