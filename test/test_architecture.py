"""The rules of the tree that no linter knows; each check must find a planted violation."""

import ast
import re
import subprocess
from pathlib import Path

import pytest
import tree

from ema_record.actuator import load_actuator

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
    "ema_phm": {
        "ema_record", "ema_rig", "ema_sim", "ema_prognostics", "ema_identification", "ema_cli",
    },
}
ROS_PACKAGES = {"rclpy", "launch", "launch_ros", "rosidl_runtime_py", "rosbag2_py", "rpyutils"}
MESSAGE_PACKAGE = re.compile(r".+_(msgs|interfaces|srvs)$")
MAX_LINES = 350
MAX_FILES = 15
"""Python files in a folder."""
MAX_DEPTH = 8
"""Imports in the longest chain of a package."""
# What is known to be wrong. Nothing is added here: an entry goes when the code has moved.
KNOWN_CYCLES: set[str] = set()
KNOWN_FOLDER_CYCLES: set[str] = set()
KNOWN_CROWDED: set[str] = set()
ONE_FILE_AN_ENTRY = {"ema_sim/effects", "ema_cli/commands"}
"""Catalogues: each file is one effect, with its parameters, bounds and source; or one command,
with its options and help. Stay."""
KNOWN_DEPTH = {
    "ema_identification": 10, "ema_prognostics": 10, "ema_record": 9}
KNOWN_NAMES: set[str] = set()
DISTINCTIVE = (
    "inverter.bus_voltage", "inverter.current_limit", "motor.phase_resistance",
    "motor.phase_inductance", "motor.back_emf_constant", "gear.ratio", "surface.end_stop",
    "control.position_gain", "control.speed_limit", "acquisition.rate", "motor.inertia",
    "motor.torque_limit",
)
"""Parameters of the default actuator whose values are hardly met by chance."""
DESCRIPTION = "ema_record/actuator.py"
"""The one module that may hold a number of an actuator; the default's are in `config/`."""
BY_CHANCE = {
    "ema_cli/views/flights_plot.py": {1.6},  # width of a line (points)
    "ema_cli/views/record_plots.py": {0.6, 11.0},  # width of a line, size of a font (points)
    "ema_identification/actuator/measure/features.py": {11.0},  # edges of bins (ms, 0.1 mrad)
    "ema_identification/actuator/panels.py": {500.0},  # points of a curve
    "ema_identification/actuator/laws/catalogue.py": {0.6, 500.0, 1.5e-5},  # severities
    "ema_identification/report/plots.py": {0.6, 500.0, 20_000.0},  # width of a line, points
    "ema_identification/rig/search/alternatives.py": {0.6, 1.6},  # delays in periods
    "ema_identification/rig/search/waves.py": {0.6},  # share of a wave
    "ema_prognostics/commission/calibrate.py": {20_000.0},  # steps of an optimiser
    "ema_prognostics/commission/commission.py": {48.0},  # units that are simulated
    "ema_prognostics/features/start.py": {0.6},  # share of the wind-up
    "ema_prognostics/features/winding.py": {0.6},  # share of the relay's band
    "ema_prognostics/features/vector.py": {0.6},  # share of a turn-on time
    "ema_prognostics/training/severity_training.py": {0.6},  # units of lost motion
    "ema_prognostics/paper/experiment.py": {22.0},  # 21 extents of a fault, counted from 1
    "ema_record/data_sheet/derive.py": {0.6},  # share of the speed that the bus allows
    "ema_record/data_sheet/quantities.py": {500.0, 20_000.0},  # bounds, the acquisition's default
    "ema_record/data_sheet/new_kit.py": {96.0},  # characters a line
    "ema_record/profiles/plan.py": {1.6},  # a preferred number
    "ema_record/checks/physics.py": {500.0, 0.6},  # samples; coherence of two phasors
    "ema_record/checks/stream.py": {11.0},  # the fifth prime
    "ema_record/wire/samples.py": {500.0},  # samples a message
    "ema_rig/bag.py": {500.0},  # samples a message
    "ema_ros/ema_node.py": {0.6},  # seconds of looking for another monitor
    "ema_ros/replay_node.py": {0.6},  # seconds of looking for others
    "ema_sim/effects/stribeck_friction.py": {500.0},  # bound of any actuator
    "ema_sim/effects/surface_load.py": {500.0},  # bound of any actuator
    "ema_sim/plant/kernel.py": {20_000.0},  # events
}
"""Equal numbers of another meaning, by file."""
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


def wrong_directions(package, source):
    """Return the imports that run against the order of the packages."""
    found = []
    for module in tree.imported(source):
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
    tops = (module.split(".")[0] for module in tree.imported(source))
    return [top for top in tops if top in ROS_PACKAGES or MESSAGE_PACKAGE.match(top)]


def numbers_of_the_actuator(source, actuator):
    """Return the numbers of a source that are distinctive parameters of `actuator`."""
    values = {getattr(getattr(actuator, section), name)
              for section, name in (dotted.split(".") for dotted in DISTINCTIVE)}
    values |= {0.5 * actuator.inverter.current_limit, 2.0 * actuator.inverter.bus_voltage,
               actuator.slew_speed, round(actuator.slew_speed, 2), round(actuator.slew_speed, 4)}
    return {
        float(node.value) for node in tree.nodes(source)
        if isinstance(node, ast.Constant) and type(node.value) in (int, float)
        and node.value in values
    }


def unsafe_code(source):
    """Return what could run code out of a file: eval, exec, pickle in any form."""
    found = [name for name in tree.imported(source) if name.split(".")[0] in UNSAFE_MODULES]
    for node in tree.nodes(source):
        if not isinstance(node, ast.Call):
            continue
        name = tree.dotted(node.func)
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
        for path in tree.product(repository)
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
        for path in tree.product(repository)
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


def test_the_numbers_of_the_actuator_stand_in_its_description(repository):
    actuator = load_actuator()
    found = {
        name: numbers
        for path in tree.product(repository)
        if (name := str(path.relative_to(repository))) != DESCRIPTION
        and (numbers := numbers_of_the_actuator(path.read_text(encoding="utf-8"), actuator)
             - BY_CHANCE.get(name, set()))
    }
    assert found == {}


@pytest.mark.parametrize("source", [
    "GEAR = 500.0", "GEAR = 500", "def f(speed=790.6): pass", "LIMITS = {'i': (-22.0, 22.0)}",
    "RATE = 20_000", "HALF = 11.0", "L = 0.72e-3", "J = 1.5e-5", "RAILS = 96", "SLEW = 1.5812",
])
def test_a_number_of_the_actuator_is_found(source):
    assert len(numbers_of_the_actuator(source, load_actuator())) == 1
    assert numbers_of_the_actuator("x = 2.0 * np.pi + 1e-3", load_actuator()) == set()


def test_files_can_be_read_in_one_sitting(repository):
    long = {
        str(path.relative_to(repository)): lines
        for path in [*tree.product(repository), *(repository / "benchmarks").rglob("*.py")]
        if (lines := tree.lines(path)) > MAX_LINES
    }
    assert long == {}


@pytest.fixture(scope="module")
def imports(repository):
    """Return the modules that each module of the product imports."""
    return tree.graph(tree.modules(repository))


def joined(circles):
    return {" <-> ".join(circle) for circle in circles}


def test_no_module_imports_itself_in_a_circle(imports):
    assert joined(tree.cycles(imports)) == KNOWN_CYCLES


def test_no_folder_imports_itself_in_a_circle(repository, imports):
    between = tree.folders(tree.modules(repository), imports)
    assert joined(tree.cycles(between)) == KNOWN_FOLDER_CYCLES


def test_every_folder_of_the_product_is_on_the_page(repository):
    rows = [line for line in (repository / "docs" / "architecture.md").read_text(
        encoding="utf-8").splitlines() if line.startswith("| `")]
    folders = {path.parent.relative_to(repository) for path in tree.product(repository)}
    assert [str(f) for f in sorted(folders) if not any(
        r.startswith(f"| `{f}/`") or (r.startswith(f"| `{f.parent}/`") and f"`{f.name}/`" in r)
        for r in rows)] == []


def test_the_decision_is_read_in_one_sitting(repository):
    """As docs/identification-method.md says; a budget of the whole room, not of a file."""
    room = repository / "ema_identification" / "actuator" / "decision"
    assert sum(bool(line.strip()) for path in room.glob("*.py")
               for line in path.read_text(encoding="utf-8").splitlines()) < 1500


def test_a_folder_can_be_read_at_a_glance(repository):
    crowded = set(tree.crowded(repository, MAX_FILES))
    assert crowded - ONE_FILE_AN_ENTRY == KNOWN_CROWDED


def test_imports_are_not_deep(imports):
    packages = {name for name in imports if "." not in name}
    depth = {name: len(tree.chain(imports, name)) - 1 for name in packages}
    assert [n for n in packages if depth[n] > KNOWN_DEPTH.get(n, MAX_DEPTH)] == []
    assert [n for n in KNOWN_DEPTH if depth[n] <= MAX_DEPTH] == []  # may be taken off the list


def test_one_name_is_one_class(repository):
    assert set(tree.classes_of_one_name(tree.modules(repository))) == KNOWN_NAMES


@pytest.fixture
def small_tree(tmp_path):
    """Return a checkout with a circle of modules, one of folders, and a name used twice."""
    for name, text in {
        "ema_a/__init__.py": "", "ema_a/b/__init__.py": "",
        "ema_a/one.py": "from ema_a.two import f\nclass Fit: pass\nclass _Own: pass\n",
        "ema_a/two.py": "def f():\n    from ema_a import one\n",
        "ema_a/b/leaf.py": "class Fit: pass\nclass _Own: pass\n",
        "ema_a/b/top.py": "import ema_a.one\nimport ema_a.b.leaf\n",
        "ema_a/three.py": "from ema_a.b.leaf import Fit\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def test_the_measures_of_a_small_tree(small_tree):
    found = tree.modules(small_tree)
    edges = tree.graph(found)
    assert edges["ema_a.b.top"] == {"ema_a.one", "ema_a.b.leaf"}
    assert joined(tree.cycles(edges)) == {"ema_a.one <-> ema_a.two"}
    assert joined(tree.cycles(tree.folders(found, edges))) == {"ema_a <-> ema_a.b"}
    assert tree.chain(edges, "ema_a")[0] == "ema_a.b.top"
    assert len(tree.chain(edges, "ema_a")) == 2
    assert tree.crowded(small_tree, 3) == {"ema_a": 4}
    assert tree.classes_of_one_name(found) == {"Fit": ["ema_a.b.leaf", "ema_a.one"]}
    assert tree.single_importer(edges) == {"ema_a.two": "ema_a.one"}


def test_nothing_read_from_a_file_can_run_code(repository):
    wrong = {
        str(path.relative_to(repository)): found
        for path in tree.product(repository)
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
