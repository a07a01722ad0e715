"""Where a panel's files lie, and the options that its programs share."""

from __future__ import annotations

import argparse
from pathlib import Path

SEALED = "sealed"
"""Answers: for the truth program and the scorer."""
TESTS = "tests"
"""Bags: all that the workflow sees."""
RESULTS = "results"
"""One JSON a unit, by the workflow."""


def add_common(parser: argparse.ArgumentParser) -> None:
    """Add --out, --part, --workers."""
    parser.add_argument("--out", type=Path, default=Path("blind_panel"),
                        help="folder of the panel")
    parser.add_argument("--part", default="1/1", help="N/M: the N-th of M balanced parts")
    parser.add_argument("--workers", type=int, default=1, help="processes")


def part_of(text: str) -> tuple[int, int]:
    """Return N, M of ``N/M``."""
    number, _, of = text.partition("/")
    if not (number.isdigit() and of.isdigit() and 1 <= int(number) <= int(of)):
        raise SystemExit(f"--part {text}: expected N/M with N from 1 to M, for example 1/4")
    return int(number), int(of)
