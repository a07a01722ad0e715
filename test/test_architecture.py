"""The rules of the tree that no linter knows; each check must find a planted violation."""

import ast
import re
import subprocess
from pathlib import Path

import pytest

MAY_IMPORT = {
    "ema_record": set(),
    "ema_rig": {"ema_record"},
    "ema_ros": {"ema_record"},
    "ema_sim": {"ema_record", "ema_ros"},
    "ema_monitor": {"ema_record", "ema_ros"},
    "ema_prognostics": {"ema_record", "ema_ros", "ema_sim"},
    "ema_identification": {"ema_record", "ema_rig", "ema_sim"},
    "ema_cli": {
        "ema_record", "ema_rig", "ema_ros", "ema_sim", "ema_monitor", "ema_prognostics",
        "ema_identification",
    },
}
ROS_PACKAGES = {"rclpy", "launch", "launch_ros", "rosidl_runtime_py", "rosbag2_py", "rpyutils"}
MESSAGE_PACKAGE = re.compile(r".+_(msgs|interfaces|srvs)$")
MAX_LINES = 350
UNSAFE_CALLS = {"eval", "exec", "joblib.load", "yaml.unsafe_load"}
UNSAFE_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal"}
# Written in pieces, so that this file passes its own check.
FORBIDDEN_TEXT = re.compile(
    "|".join([
        r"(?<![\w.])/(?:wor" + r"k|roo" + r"t|far" + r"m)/",
        r"pypi\." + r"org", r"files\.python" + r"hosted", r"registry\.npm" + r"js",
        r"deb\.deb" + r"ian", r"registry\.yarn" + r"pkg",
    ])
)


def imports(tree):
    """Yield every module that a file imports, at the top or inside a function."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module if node.level == 0 else "." * node.level
        elif isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name in {"__import__", "import_module", "importlib.import_module"} and node.args:
                first = node.args[0]
                if isinstance(first, ast.Constant):
                    yield first.value


def wrong_directions(package, source):
    """Return the imports that run against the order of the packages."""
    found = []
    for module in imports(ast.parse(source)):
        top = module.split(".")[0]
        if not top:
            found.append(f"relative import {module}")
        elif top.startswith("ema_") and top != package and top not in MAY_IMPORT[package]:
            found.append(module)
    return found


def ros_imports(name, source):
    """Return the imports of ROS in a file that is neither a node nor a `messages.py`."""
    if name.endswith("_node.py") or name == "messages.py":
        return []
    tops = (module.split(".")[0] for module in imports(ast.parse(source)))
    return [top for top in tops if top in ROS_PACKAGES or MESSAGE_PACKAGE.match(top)]


def unsafe_code(source):
    """Return what could run code out of a file: eval, exec, pickle in any form."""
    tree = ast.parse(source)
    found = [module for module in imports(tree) if module.split(".")[0] in UNSAFE_MODULES]
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func)
        if name in UNSAFE_CALLS:
            found.append(f"{name}(")
        found += [
            "allow_pickle" for keyword in node.keywords
            if keyword.arg == "allow_pickle" and ast.unparse(keyword.value) != "False"
        ]
    loaders = set(re.findall(r"\b\w*Loader\b", source)) - {"Loader"}
    if "yaml.Loader" in source or any(not name.endswith("SafeLoader") for name in loaders):
        found.append("yaml loader")
    return found


def forbidden_text(text):
    """Return the paths of one machine and the registry hosts that a text names."""
    return FORBIDDEN_TEXT.findall(text)


def sources(root):
    """Return the Python files of the packages."""
    files = sorted(p for name in MAY_IMPORT for p in (root / name).rglob("*.py"))
    assert len(files) > 40
    return files


def tracked(root):
    """Return the files that git knows and that are there."""
    names = subprocess.run(
        ["git", "ls-files", "-z"], cwd=root, check=True, capture_output=True, text=True
    ).stdout.split("\0")
    return [path for name in names if name and (path := root / name).is_file()]


def test_every_package_is_known_and_imports_run_one_way(repository):
    assert {p.parent.name for p in repository.glob("ema_*/__init__.py")} <= set(MAY_IMPORT)
    wrong = {
        str(path.relative_to(repository)): found
        for path in sources(repository)
        if (found := wrong_directions(
            path.relative_to(repository).parts[0], path.read_text(encoding="utf-8")))
    }
    assert wrong == {}


@pytest.mark.parametrize(("package", "source"), [
    ("ema_record", "from ema_sim.simulate import simulate"),
    ("ema_sim", "import ema_prognostics.verdict.diagnose as d"),
    ("ema_monitor", "def late():\n    from ema_sim import actuator"),
    ("ema_prognostics", "import importlib\nimportlib.import_module('ema_cli.main')"),
    ("ema_sim", "from . import actuator"),
])
def test_a_wrong_direction_is_found(package, source):
    assert len(wrong_directions(package, source)) == 1
    assert wrong_directions(package, "import numpy\nfrom ema_record import channels") == []


def test_only_nodes_and_messages_import_ros(repository):
    wrong = {
        str(path.relative_to(repository)): found
        for path in sources(repository)
        if path.parent.name != "ema_ros"
        and (found := ros_imports(path.name, path.read_text(encoding="utf-8")))
    }
    assert wrong == {}


@pytest.mark.parametrize("source", [
    "import rclpy",
    "from std_msgs.msg import Bool",
    "def f():\n    from rcl_interfaces.msg import ParameterDescriptor",
    "import diagnostic_msgs.srv as s",
])
def test_an_import_of_ros_is_found(source):
    assert len(ros_imports("server.py", source)) == 1
    assert ros_imports("simulator_node.py", source) == []
    assert ros_imports("messages.py", source) == []


def test_files_can_be_read_in_one_sitting(repository):
    long = {
        str(path.relative_to(repository)): lines
        for path in [*sources(repository), *(repository / "benchmarks").rglob("*.py")]
        if (lines := len(path.read_text(encoding="utf-8").splitlines())) > MAX_LINES
    }
    assert long == {}


def test_nothing_read_from_a_file_can_run_code(repository):
    wrong = {
        str(path.relative_to(repository)): found
        for path in sources(repository)
        if (found := unsafe_code(path.read_text(encoding="utf-8")))
    }
    assert wrong == {}


@pytest.mark.parametrize("source", [
    "import pickle",
    "from pickle import loads",
    "x = eval(text)",
    "exec(code)",
    "np.load(path, allow_pickle=True)",
    "np.load(path, allow_pickle=flag)",
    "joblib.load(path)",
    "yaml.load(text, Loader=yaml.Loader)",
    "yaml.load(text, Loader=yaml.UnsafeLoader)",
])
def test_unsafe_code_is_found(source):
    assert len(unsafe_code(source)) == 1
    safe = "np.load(path, allow_pickle=False)\nmodel.eval()\nyaml.load(t, Loader=CSafeLoader)"
    assert unsafe_code(safe) == []


def test_only_tests_of_benchmarks_import_benchmarks(repository):
    pattern = re.compile(r"^\s*(from|import) benchmarks", re.MULTILINE)
    wrong = [
        str(path.relative_to(repository)) for path in (repository / "test").rglob("*.py")
        if path.parent.name != "benchmarks" and pattern.search(path.read_text(encoding="utf-8"))
    ]
    assert wrong == []


def test_tracked_files_name_no_machine_and_no_registry(repository):
    wrong = {}
    for path in tracked(repository):
        try:
            found = forbidden_text(path.read_text(encoding="utf-8"))
        except UnicodeDecodeError:
            continue
        if found:
            wrong[str(path.relative_to(repository))] = found
    assert wrong == {}


@pytest.mark.parametrize("text", [
    "cd /wor" + "k/main", "'/roo" + "t/.cache'", "https://pypi" + ".org/simple",
    "https://registry.npm" + "js.org/a",
])
def test_a_machine_or_a_registry_is_found(text):
    assert len(forbidden_text(text)) == 1
    assert forbidden_text("docs/work/index.md, ../root/x and /tmp") == []


def test_tracked_files_are_the_tree(repository):
    names = {str(path.relative_to(repository)) for path in tracked(repository)}
    assert {"setup.py", "package.xml", "resource/ema_phm", "constraints.txt"} <= names
    assert not [n for n in names if Path(n).suffix in {".pyc", ".pkl", ".so", ".egg-info"}]
