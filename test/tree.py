"""The measures of a checkout: files, lines, import cycles, import depth, folders, importers.

``python test/tree.py [ROOT]`` prints them for the checkout at ROOT, by default this one.
Everything is read off the sources; nothing of the project is imported.
"""

from __future__ import annotations

import ast
import functools
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

Graph = dict[str, set[str]]
MANY_FILES = 15


ENTRY_POINT = re.compile(r"^\w+\.(\w+_node|main|__main__|identify)$")
"""At the top of a package. (`ema_ros.ema_node`, which nodes are made from, is none.)"""
NOT_ONE = {"ema_ros.ema_node"}


def modules(root: Path) -> dict[str, Path]:
    """Return the path of each module of the product, by its dotted name.

    Parameters
    ----------
    root : Path
        The checkout: its packages are the folders ``ema_*`` with an ``__init__.py``.
    """
    found = {}
    for top in sorted(root.glob("ema_*/__init__.py")):
        for path in sorted(top.parent.rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@functools.cache
def nodes(source: str) -> tuple[ast.AST, ...]:
    """Return every node of a source, the module first; parsed once, however many ask."""
    return tuple(ast.walk(ast.parse(source)))


def dotted(node: ast.expr) -> str:
    """Return the dotted name that an expression is, "" of any other expression."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def imported(source: str) -> Iterator[str]:
    """Yield every dotted name that a source imports, at the top or inside a function.

    ``from a import b`` yields ``a.b``: b may be a module. A relative import yields its dots.
    """
    for node in nodes(source):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            if node.level:
                yield "." * node.level + module
            else:
                yield from (f"{module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call):
            name = dotted(node.func)
            if name in {"__import__", "import_module", "importlib.import_module"} and node.args:
                first = node.args[0]
                if isinstance(first, ast.Constant):
                    yield first.value


def graph(found: dict[str, Path]) -> Graph:
    """Return the modules of the product that each module imports."""
    edges: Graph = {}
    for name, path in found.items():
        names = imported(path.read_text(encoding="utf-8"))
        known = (n if n in found else n.rpartition(".")[0] for n in names)
        edges[name] = {n for n in known if n in found and n != name}
    return edges


def folders(found: dict[str, Path], edges: Graph) -> Graph:
    """Return the folders that each folder imports from, by their dotted names.

    An entry point of a package (a node, a command, its one verb) stands above the package's
    folders, whichever folder its file lies in, and counts as a folder of its own.
    """
    folder = {
        name: name if ENTRY_POINT.search(name) and name not in NOT_ONE else
        name if path.name == "__init__.py" else name.rpartition(".")[0]
        for name, path in found.items()
    }
    between: Graph = {folder[name]: set() for name in found}
    for name, targets in edges.items():
        between[folder[name]] |= {folder[t] for t in targets} - {folder[name]}
    return between


def components(edges: Graph) -> list[list[str]]:
    """Return the strongly connected parts, those that are imported first (Tarjan, 1972)."""
    order: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    parts: list[list[str]] = []

    def visit(name: str) -> None:
        order[name] = lowest[name] = len(order)
        stack.append(name)
        for target in sorted(edges.get(name, ())):
            if target not in order:
                visit(target)
                lowest[name] = min(lowest[name], lowest[target])
            elif target in stack:
                lowest[name] = min(lowest[name], order[target])
        if lowest[name] == order[name]:
            at = stack.index(name)
            parts.append(sorted(stack[at:]))
            del stack[at:]

    for name in sorted(edges):
        if name not in order:
            visit(name)
    return parts


def cycles(edges: Graph) -> list[list[str]]:
    """Return the groups of names that import one another in a circle."""
    return sorted(part for part in components(edges) if len(part) > 1)


def chain(edges: Graph, package: str) -> list[str]:
    """Return the longest chain of imports inside a package, module by module.

    The depth of the package is the number of imports in it: one less. A cycle counts as one
    module.
    """
    inside = {n for n in edges if n == package or n.startswith(package + ".")}
    longest: dict[str, list[str]] = {}
    for part in components({n: edges[n] & inside for n in inside}):
        below = [longest[t] for n in part for t in edges[n] & inside if t not in part]
        best = max(below, key=len, default=[])
        longest |= {n: [n, *best] for n in part}
    return max(longest.values(), key=len, default=[])


def crowded(root: Path, most: int = MANY_FILES) -> dict[str, int]:
    """Return the folders of product, tests and benchmarks with more than `most` Python files."""
    count: dict[str, int] = defaultdict(int)
    for path in [*product(root), *beside(root)]:
        count[str(path.parent.relative_to(root))] += 1
    return {name: n for name, n in sorted(count.items()) if n > most}


def single_importer(edges: Graph) -> dict[str, str]:
    """Return the modules that one module of the product alone imports, and that module."""
    users: Graph = defaultdict(set)
    for name, targets in edges.items():
        for target in targets:
            users[target].add(name)
    return {name: user for name, (user, *more) in sorted(users.items()) if not more}


def classes_of_one_name(found: dict[str, Path]) -> dict[str, list[str]]:
    """Return the public classes that several modules define, with these modules."""
    places: dict[str, list[str]] = defaultdict(list)
    for module, path in found.items():
        for node in ast.iter_child_nodes(nodes(path.read_text(encoding="utf-8"))[0]):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(module)
    return {name: where for name, where in sorted(places.items()) if len(where) > 1}


def product(root: Path) -> list[Path]:
    """Return the Python files of the product."""
    return list(modules(root).values())


def beside(root: Path) -> list[Path]:
    """Return the Python files of tests and benchmarks."""
    return sorted(p for name in ("test", "benchmarks") for p in (root / name).rglob("*.py"))


def lines(path: Path) -> int:
    """Return the number of lines of a file."""
    return len(path.read_text(encoding="utf-8").splitlines())


def report(root: Path) -> Iterator[str]:
    """Yield the lines of the report on a checkout."""
    found = modules(root)
    edges = graph(found)
    for name, files in (("product", product(root)), ("tests and benchmarks", beside(root))):
        longest = max(files, key=lines)
        yield (f"{name}: {len(files)} files, {sum(map(lines, files))} lines, longest "
               f"{lines(longest)} ({longest.relative_to(root)})")
    for what, group in (("modules", edges), ("folders", folders(found, edges))):
        circles = cycles(group)
        yield f"import cycles between {what}: {len(circles)}"
        yield from (f"  {' <-> '.join(circle)}" for circle in circles)
    single = single_importer(edges)
    yield "package               modules  import depth  with a single importer"
    for package in sorted(name for name in found if "." not in name):
        own = [n for n in found if n.split(".")[0] == package]
        yield (f"{package:22}{len(own):7}{len(chain(edges, package)) - 1:14}"
               f"{sum(n in single for n in own):24}")
    yield f"folders with more than {MANY_FILES} Python files:"
    yield from (f"  {name}: {count}" for name, count in crowded(root).items())
    yield "public classes with one name in several modules:"
    yield from (f"  {n}: {', '.join(w)}" for n, w in classes_of_one_name(found).items())
    yield "modules with a single importer:"
    yield from (f"  {name} <- {user}" for name, user in single.items())


if __name__ == "__main__":
    here = Path(__file__).resolve().parents[1]
    print("\n".join(report(Path(sys.argv[1]) if len(sys.argv) > 1 else here)))
