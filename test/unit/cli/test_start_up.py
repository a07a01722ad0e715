"""What a command that simulates nothing does not load: it would take longer than its work."""

import json
import subprocess
import sys

import pytest

HEAVY = {"numba", "llvmlite", "scipy", "sklearn", "matplotlib", "jinja2", "joblib", "dask",
         "pandas", "pyarrow", "rclpy", "rosbags", "numpy.ma"}
CHECK = "from ema_cli.main import run; run(['check', 'bags/sim_0000_extended'])"


def modules_after(code, repository):
    """Return what a new interpreter has loaded after it ran `code`."""
    code += "\nimport json, sys; print(); print(json.dumps(list(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], cwd=repository, check=True,
                           capture_output=True, text=True)
    return set(json.loads(found.stdout.splitlines()[-1])), found.stdout


API = ("import sys, ema_phm as ema; assert 'numpy' not in sys.modules;"
       "print(ema.diagnose('bags/sim_0000_step'))")


@pytest.mark.parametrize("code", [CHECK, API])
def test_heavy_modules_stay_out(repository, code):
    loaded, printed = modules_after(code, repository)
    assert "HEALTHY" in printed
    assert "ema_prognostics.features.extract" in loaded  # it has judged
    assert loaded & HEAVY == set()
