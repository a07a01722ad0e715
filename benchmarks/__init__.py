"""Measurements, one command each: ``python -m benchmarks.NAME``."""

import sys
from pathlib import Path

# Oracles and makers of defects are those of the tests: the package `support`.
sys.path.append(str(Path(__file__).resolve().parents[1] / "test"))
