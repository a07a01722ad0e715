"""What a command that simulates nothing does not load: it would take longer than its work."""

import json
import signal
import subprocess
import sys
from types import ModuleType

import pytest

from ema_cli import __main__

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


def test_interrupted_while_modules_are_loaded_is_one_line(monkeypatch, capsys):
    class Loading(ModuleType):
        @property
        def main(self):
            raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, "ema_cli.main", Loading("ema_cli.main"))
    with pytest.raises(SystemExit) as left:
        __main__.main()
    assert (left.value.code, capsys.readouterr().err) == (130, "ema: interrupted\n")


@pytest.mark.parametrize("module", ["typer", "ema_cli.commands.effects"])
@pytest.mark.parametrize(("number", "line"), [
    (signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")])
def test_a_signal_while_modules_are_loaded_is_one_line_with_its_status(
    number, line, module
):
    code = ("import os, signal, sys\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
            "class Finder:\n    def find_spec(self, name, *_):\n"
            f"        if name == MODULE: os.kill(os.getpid(), {int(number)})\n"
            "sys.meta_path.insert(0, Finder())\nfrom ema_cli.__main__ import main\n"
            "sys.argv[1:] = ['effects']\nmain()").replace("MODULE", repr(module))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                          check=False, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (128 + number, "", f"ema: {line}\n")
