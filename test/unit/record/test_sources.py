"""A hash of sources follows the imports: what a module depends on changes it, nothing else."""

import subprocess
import sys

import pytest

from ema_prognostics.training import fleet
from ema_record.sources import OURS, source_hash, sources_of

TREE = {
    "ema_a/__init__.py": "",
    "ema_a/top.py": "import numpy\nfrom ema_a.middle import part\nfrom ema_b import leaf as x\n",
    "ema_a/middle.py": "def part():\n    import ema_b.late\n",
    "ema_a/apart.py": "from ema_a.top import part\n",
    "ema_b/__init__.py": "from ema_b.first import name\n",
    "ema_b/first.py": "name = 1\n",
    "ema_b/leaf.py": "from ema_a import top  # a cycle does no harm\n",
    "ema_b/late.py": "",
}
NEEDED = {"ema_a", "ema_a.top", "ema_a.middle", "ema_b", "ema_b.first", "ema_b.leaf", "ema_b.late"}


@pytest.fixture
def tree(tmp_path):
    for name, text in TREE.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    return tmp_path


def test_imports_are_followed(tree):
    assert set(sources_of("ema_a.top", root=tree)) == NEEDED
    assert set(sources_of("ema_b.first", root=tree)) == {"ema_b", "ema_b.first"}


def test_an_unknown_module_is_an_error(tree):
    with pytest.raises(ModuleNotFoundError, match=r"ema_a\.nothing"):
        sources_of("ema_a.nothing", root=tree)
    with pytest.raises(ModuleNotFoundError, match="numpy"):
        sources_of("numpy", root=tree)


@pytest.mark.parametrize(
    "module",
    ["ema_sim.plant.kernel", "ema_sim.simulate", "ema_sim.campaign.run", fleet.MODULE],
)
def test_what_is_imported_is_in_it(module):
    """What the interpreter itself loads of ours for a module, the hash covers."""
    code = f"import sys, {module}; print(*[m for m in sys.modules if m.startswith('{OURS}')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert module in loaded and len(loaded) > 10
    assert loaded <= set(sources_of(module))


def test_a_planted_change_changes_the_key(tree):
    before, seen = source_hash("ema_a.top", root=tree), set()
    for name, text in TREE.items():
        path = tree / name
        path.write_text(text + "# edited\n")
        source_hash.cache_clear()
        seen.add(source_hash("ema_a.top", root=tree))
        path.write_text(text)
    # One key a file that is needed, and the old one for the file apart.
    assert before in seen and len(seen) == len(NEEDED) + 1
