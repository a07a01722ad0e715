"""The Makefile's jobs, run as a person runs them, in the environment that the tests have."""

import os
import subprocess
import sys

import pytest


@pytest.fixture
def make(repository):
    """Return a function that runs make without touching the environment's installation."""

    def run(*arguments, venv=sys.prefix, keep=True):
        old = ["-o", f"{venv}/.installed-run", "-o", f"{venv}/.installed-test"] if keep else []
        env = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
        return subprocess.run(
            ["make", *old, f"VENV={venv}", *arguments], cwd=repository, env=env, text=True,
            stdin=subprocess.DEVNULL, capture_output=True, timeout=100, check=False,
        )

    return run


def test_help_names_the_jobs(make):
    done = make()
    assert done.returncode == 0, done.stderr
    assert [job for job in ("make bit ", "make test ", "make test-slow ")
            if job not in done.stdout] == []


def test_what_starts_ros_is_where_make_looks_for_it(repository):
    """`ROS_TESTS` of the Makefile leaves no test out."""
    tests = repository / "test"
    found = {path.parent for path in tests.rglob("test_*.py")
             if "ros" in path.relative_to(tests).parts or "mark.ros\n" in path.read_text()}
    assert found == {tests, tests / "ros", tests / "unit" / "ros"}


@pytest.mark.slow
@pytest.mark.parametrize(("job", "tests", "status"), [
    ("test", "test/test_requirements.py", 0),  # none with real processes among them
    ("test-slow", "test/test_requirements.py", 2),  # no test at all
    ("test", "test/test_nowhere.py", 2),
])
def test_some_tests_alone(make, tmp_path, job, tests, status):
    done = make(job, f"TESTS={tests}", "WORKERS=0", f"RESULTS={tmp_path}",
                "PYTEST_OPTIONS=-p no:cacheprovider")
    assert done.returncode == status, done.stdout + done.stderr
    assert (" passed in " in done.stdout) == (status == 0)
    assert ("all selected tests passed" in done.stdout) == (status == 0)


@pytest.mark.parametrize(("effect", "options"), [
    ("none", 0), ("backlash.width=1e-3", 1), ("turn_short.fraction=0.1 turn_short.phase=b", 2),
])
def test_every_effect_becomes_an_option(make, effect, options):
    assert make("-n", "bit", f"EFFECT={effect}").stdout.count("--effect") == options


@pytest.mark.slow
@pytest.mark.ros
def test_bit_with_hidden_effects_is_done_whatever_the_verdict(make, tmp_path):
    done = make(
        "bit", "PROFILE=step", "EFFECT=turn_short.fraction=0.1 turn_short.phase=b",
        f"BIT_OPTIONS=--out '{tmp_path / 'records'}'",
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "make bit: done" in done.stdout
    assert len(list((tmp_path / "records").glob("*/metadata.yaml"))) == 1


def test_bit_with_an_unknown_effect_fails_in_one_line(make):
    done = make("bit", "PROFILE=step", "EFFECT=turn_shrt.fraction=0.1")
    assert done.returncode == 2
    assert "turn_shrt" in done.stderr
    assert "make bit: failed (ema bit: 2)" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("python", ["false", "no-such-python"])
def test_an_unsuitable_interpreter_is_said_in_a_line(make, tmp_path, python):
    done = make("bit", f"PYTHON={python}", venv=tmp_path / "venv", keep=False)
    assert done.returncode == 2
    assert f"{python} is not Python 3.10 to 3.13" in done.stderr
    assert not (tmp_path / "venv").exists()
