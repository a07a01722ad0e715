"""What a command that simulates nothing does not load: it would take longer than its work."""

import json
import subprocess
import sys

import pytest

HEAVY = {"numba", "llvmlite", "scipy", "sklearn", "matplotlib", "jinja2", "joblib", "dask",
         "pandas", "pyarrow", "rclpy", "rosbags.typesys.stores.ros2_dashing"}
CHECK = "from ema_cli.main import run; run(['check', 'bags/sim_0000_extended'])"


def modules_after(code, repository):
    """Return what a new interpreter has loaded after it ran `code`."""
    code += "\nimport json, sys; print(); print(json.dumps(list(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], cwd=repository, check=True,
                           capture_output=True, text=True)
    return set(json.loads(found.stdout.splitlines()[-1])), found.stdout


@pytest.mark.parametrize(("code", "expected"), [(CHECK, "HEALTHY")])
def test_heavy_modules_stay_out(repository, code, expected):
    loaded, printed = modules_after(code, repository)
    assert expected in printed
    assert loaded & HEAVY == set()
    assert "ema_sim.machine" in loaded or not expected  # it has judged


def test_a_heavy_module_is_found(repository):
    assert "scipy" in modules_after("import scipy.special", repository)[0] & HEAVY
