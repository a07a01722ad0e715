"""The tree builds with colcon and with pip, and what they install runs from there."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

EXECUTABLES = ("ema", "simulator_node", "monitor_node", "prognostics_node")
NODES = EXECUTABLES[1:]
SHARED = ("package.xml", "config/actuator.yaml", "config/profiles/step.yaml",
          "config/profiles/extended.yaml", "config/fastdds.xml")


def run(*command, **options):
    return subprocess.run(
        [str(part) for part in command], stdin=subprocess.DEVNULL, capture_output=True,
        text=True, timeout=100, check=False, **options,
    )


@pytest.fixture(scope="module")
def tree(repository, tmp_path_factory):
    """Return a copy of the tracked files, in the workspace that they are built in."""
    target = tmp_path_factory.mktemp("workspace") / "src" / "ema_phm"
    listed = run("git", "ls-files", "-z", cwd=repository)
    assert listed.returncode == 0, listed.stderr
    for name in filter(None, listed.stdout.split("\0")):
        if not (repository / name).is_file():
            continue
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(repository / name, target / name)
    return target


@pytest.fixture(scope="module")
def prefix(tree):
    """Return the prefix into which colcon has installed the package."""
    workspace = tree.parents[1]
    built = run(
        Path(sys.executable).with_name("colcon"), "build",
        cwd=workspace, env={**os.environ, "COLCON_HOME": str(workspace / "colcon_home")},
    )
    assert built.returncode == 0, built.stdout + built.stderr
    assert "1 package finished" in built.stdout
    return workspace / "install" / "ema_phm"


@pytest.fixture
def overlay(prefix, tmp_path):
    """Return the environment that the workspace's set-up file makes."""
    sourced = run(
        "sh", "-c", ". ./local_setup.sh && env -0", cwd=prefix.parent,
        env={**os.environ, "ROS_LOG_DIR": str(tmp_path)},
    )
    assert sourced.returncode == 0, sourced.stderr
    return dict(line.split("=", 1) for line in sourced.stdout.split("\0") if line)


def test_colcon_installs_executables_where_ros2_run_looks(prefix):
    folder = prefix / "lib" / "ema_phm"
    assert sorted(p.name for p in folder.iterdir()) == sorted(EXECUTABLES)
    assert all(os.access(folder / name, os.X_OK) for name in EXECUTABLES)


def test_colcon_registers_the_package_and_its_files(prefix, overlay):
    assert (prefix / "share/ament_index/resource_index/packages/ema_phm").is_file()
    assert [n for n in SHARED if not (prefix / "share" / "ema_phm" / n).is_file()] == []
    found = run(
        sys.executable, "-c",
        "from ament_index_python import get_package_prefix as p; print(p('ema_phm'))",
        env=overlay,
    )
    assert Path(found.stdout.strip()) == prefix, found.stderr


def test_every_shipped_file_is_installed(tree, prefix):
    shipped = {str(p.relative_to(tree)) for p in (tree / "config").rglob("*") if p.is_file()}
    share = prefix / "share" / "ema_phm"
    installed = {str(p.relative_to(share)) for p in (share / "config").rglob("*") if p.is_file()}
    assert installed == shipped


def test_installed_code_uses_its_own_files(prefix, overlay, tmp_path):
    found = run(
        sys.executable, "-c",
        "import ema_record; from ema_record.kit import share_path\n"
        "print(ema_record.__file__); print(share_path('config/actuator.yaml'))",
        env=overlay, cwd=tmp_path,
    )
    package, actuator = found.stdout.splitlines()
    assert Path(package).is_relative_to(prefix), found.stderr
    assert Path(actuator) == prefix / "share" / "ema_phm" / "config" / "actuator.yaml"


def test_installed_command_simulates(prefix, overlay, tmp_path):
    done = run(
        prefix / "lib" / "ema_phm" / "ema", "simulate", "--profile", "step",
        "--out", tmp_path / "bag", env=overlay, cwd=tmp_path,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "bag" / "metadata.yaml").is_file()


@pytest.mark.parametrize("node", NODES)
def test_installed_node_refuses_a_wrong_argument_in_one_line(node, prefix, overlay, tmp_path):
    done = run(
        prefix / "lib" / "ema_phm" / node, "--ros-args", "--nonsense", env=overlay, cwd=tmp_path
    )
    assert done.returncode == 2, done.stdout + done.stderr
    assert "--nonsense" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.ros
def test_installed_simulator_node_runs_until_it_is_told_to_stop(
    prefix, overlay, ros_domain, tmp_path
):
    node = subprocess.Popen(
        [prefix / "lib" / "ema_phm" / "simulator_node"], cwd=tmp_path, text=True,
        env={**overlay, "ROS_DOMAIN_ID": str(ros_domain)}, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )
    try:
        seen = []
        for line in node.stdout:
            seen.append(line)
            if "ready" in line:
                break
        assert any("ready" in line for line in seen), "".join(seen)
        node.send_signal(signal.SIGINT)
        rest, _ = node.communicate(timeout=20)
        assert node.returncode == 0, rest
        assert "Traceback" not in rest
    finally:
        node.kill()
        node.communicate()


def test_pip_installs_the_same_package(tree, tmp_path):
    target = tmp_path / "prefix"
    done = run(
        sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps",
        "--no-build-isolation", "--ignore-installed", "--prefix", target, tree,
    )
    assert done.returncode == 0, done.stderr
    assert {p.name for p in (target / "bin").iterdir()} == set(EXECUTABLES)
    assert [n for n in SHARED if not (target / "share" / "ema_phm" / n).is_file()] == []
