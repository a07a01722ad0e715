"""The kernel's disk cache never answers for sources that were edited since."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from ema_record.sources import sources_of

ROOT = Path(__file__).parents[3]

RUN = """
import hashlib
from ema_record.profile import step_profile
from ema_sim.effects import parse_effects
from ema_sim.plant import kernel
from ema_sim.simulate import simulate
record = simulate(step_profile(0.03, start=-0.02, duration=0.06),
                  effects=parse_effects(["motor_friction.increase=0.5"]))
stats = kernel.kernel(kernel.RELAY, False).stats
print(hashlib.sha256(record.samples.tobytes()).hexdigest(), sum(stats.cache_hits.values()),
      kernel.__file__)
"""


@pytest.fixture
def copied(tmp_path):
    """Return a copy of the sources that the simulator needs."""
    for name in ("ema_sim", "ema_record", "config"):
        shutil.copytree(ROOT / name, tmp_path / name,
                        ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def run(code: str, folder: Path) -> list[str]:
    env = os.environ | {
        "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "cache"),
    }
    done = subprocess.run([sys.executable, "-c", code], env=env, cwd=folder, check=False,
                          capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.slow  # compiles the kernel twice
def test_an_edited_law_is_compiled_anew(copied):
    first, hits, where = run(RUN, copied)
    assert where.startswith(str(copied)) and hits == "0"
    again, hits, _ = run(RUN, copied)
    assert again == first and hits == "1"
    law = copied / "ema_sim" / "effects" / "motor_friction.py"
    text = law.read_text()
    assert "return p.increase * torque" in text
    law.write_text(text.replace("return p.increase * torque", "return 2.0 * p.increase * torque"))
    edited, hits, _ = run(RUN, copied)
    assert edited != first and hits == "0"


def test_every_law_counts():
    laws = [path for path in (ROOT / "ema_sim").rglob("*.py") if "@law" in path.read_text()]
    assert len(laws) >= 28
    assert set(laws) <= set(sources_of("ema_sim.plant.kernel").values())
