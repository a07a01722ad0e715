"""The linters, through their own commands, over everything that is ours."""

import re
import subprocess
import sys

import pytest
from ament_flake8.main import main_with_errors
from ament_pep257.main import main as pep257


@pytest.fixture
def ours(repository, monkeypatch):
    """Return the folders and files with our code, relative to the root, which is made current."""
    monkeypatch.chdir(repository)
    packages = sorted(p.parent.name for p in repository.glob("ema_*/__init__.py"))
    assert len(packages) >= 5
    return [*packages, "benchmarks", "test", "setup.py"]


def run_module(*arguments):
    done = subprocess.run(
        [sys.executable, "-m", *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_ruff(ours):
    assert "All checks passed" in run_module("ruff", "check", "--no-cache", *ours)


@pytest.mark.slow
def test_mypy(ours):
    packages = [argument for name in ours if name.startswith("ema_") for argument in ("-p", name)]
    report = run_module("mypy", "--python-version", "3.11", *packages)
    checked = int(re.search(r"no issues found in (\d+) source files", report).group(1))
    assert checked > 40


@pytest.mark.slow
def test_ament_flake8(ours):
    status, errors = main_with_errors(argv=ours)
    assert (status, errors) == (0, [])


def test_ament_flake8_finds_a_long_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "long.py").write_text(f"x = '{'x' * 100}'\n", encoding="utf-8")
    status, errors = main_with_errors(argv=["long.py"])
    assert status == 1
    assert "E501" in errors[0]


@pytest.mark.slow
def test_ament_pep257(ours, capsys):
    """Packages in numpydoc's convention, which is that of ruff; tests in ament's, less D213.

    ament's own default also demands D213 (summary on the second line), which excludes
    summaries that begin at the quotes.
    """
    code = [path for path in ours if path.startswith("ema_") or path == "benchmarks"]
    tests = [path for path in ours if path not in code]
    statuses = [
        pep257(argv=["--convention", "numpy", "--add-ignore", "D105", "D401", "--", *code]),
        pep257(argv=["--add-ignore", "D213", "D401", "D402", "D413", "D417", "--", *tests]),
    ]
    report = capsys.readouterr()
    assert statuses == [0, 0], report.out + report.err
    assert "ema_record/record.py" in report.out


def test_ament_pep257_finds_a_missing_docstring(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bare.py").write_text("def public():\n    return 1\n", encoding="utf-8")
    assert pep257(argv=["--convention", "numpy", "--", "bare.py"]) == 1
