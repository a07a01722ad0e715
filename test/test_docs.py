"""The documents: their links lead somewhere, and they rest on nothing that is not here."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

LINK = re.compile(r"(?<!`)\]\(([^)\s]+)\)")
ELSEWHERE = re.compile(r"[a-z]+:|#")
README_LINES = 120
PLACE = re.compile(r"(?<![\w./-])((?:ema_[a-z]+|benchmarks|config|docs|test)/[\w./*-]*)")
MODULE = re.compile(r"(?<![\w./-])((?:ema_(?!phm)[a-z]+|benchmarks)(?:\.[A-Za-z_]\w*)+)")
RUN = re.compile(r"python -m ([\w.]+)")
EXAMPLE = {"ema_sim/effects/windage_drag.py", "ema_sim.effects.windage_drag.WindageDrag"}
"""The effect that docs/adding-an-effect.md adds."""
# Written in pieces, so that this file passes its own check.
NOT_HERE = re.compile("DESIGN, sec" + r"tion|DESIGN\." + "md")


def tracked(root):
    """Return the text of every tracked text file by its path from the root."""
    listed = subprocess.run(
        ["git", "-C", root, "ls-files", "-z"], capture_output=True, text=True, check=True)
    found = {}
    for name in filter(None, listed.stdout.split("\0")):
        try:
            found[name] = (root / name).read_text(encoding="utf-8")
        except (UnicodeDecodeError, FileNotFoundError):
            continue
    return found


def broken_links(path, text):
    """Return the relative links of a document that lead to no file."""
    links = (link.partition("#")[0] for link in LINK.findall(text)
             if not ELSEWHERE.match(link))
    return [link for link in links if not (path.parent / link).exists()]


def code_of(text):
    """Return what stands in backticks or in an indented or fenced block, imports in one piece."""
    blocks = re.findall(r"^ *```.*?^ *```|^(?: {4}\S.*\n)+", text, re.DOTALL | re.MULTILINE)
    code = "\n".join([*blocks, *re.findall(r"`[^`\n]+`", text)])
    return re.sub(r"from ([\w.]+) import (\w+)", r"\1.\2", code)


def is_module(root, name):
    """Whether a dotted name is a module, or a name that a module holds."""
    path = root / name.replace(".", "/")
    if path.is_dir() or path.with_suffix(".py").is_file():
        return True
    module, last = path.parent, path.name
    for source in (module.with_suffix(".py"), module / "__init__.py"):
        if source.is_file() and re.search(rf"\b{last}\b", source.read_text(encoding="utf-8")):
            return True
    return False


def can_run(root, name):
    """Whether ``python -m name`` finds a program, for a name of ours."""
    path = root / name.replace(".", "/")
    ours = (root / name.split(".")[0]).is_dir()
    return not ours or path.with_suffix(".py").is_file() or (path / "__main__.py").is_file()


def not_there(root, text):
    """Return the paths, modules and programs of this tree that a document names wrongly."""
    code = code_of(text)
    wrong = [place for place in PLACE.findall(code)
             if place not in EXAMPLE and not any(root.glob(place.rstrip("/.")))]
    wrong += [name for name in MODULE.findall(code)
              if name not in EXAMPLE and not name.endswith(".py") and not is_module(root, name)]
    return wrong + [name for name in RUN.findall(code) if not can_run(root, name)]


@pytest.fixture(scope="module")
def files(repository):
    return tracked(repository)


def test_every_relative_link_leads_to_a_file(files, repository):
    documents = {name: text for name, text in files.items() if name.endswith(".md")}
    assert len(documents) > 10
    broken = {name: broken_links(repository / name, text) for name, text in documents.items()}
    assert {name: links for name, links in broken.items() if links} == {}


def test_a_broken_link_is_found(repository):
    page = repository / "docs" / "page.md"
    text = "[a](nodes.md#terms) ![b](../README.md) [c](https://example.com/x) [d](#below)"
    assert broken_links(page, text) == []
    assert broken_links(page, text + " [e](nowhere.md)") == ["nowhere.md"]


def test_every_path_and_module_is_there(files, repository):
    documents = {name: text for name, text in files.items() if name.endswith(".md")}
    wrong = {name: not_there(repository, text) for name, text in documents.items()}
    assert {name: found for name, found in wrong.items() if found} == {}


@pytest.mark.parametrize("text", [
    "`ema_sim/nowhere.py`", "`test/unit/nowhere/`", "`ema_sim.plant.ports.nothing_of_this_name`",
    "`python -m benchmarks.units.nowhere`", "`config/nowhere*.xml`",
    "```python\nfrom ema_record.bag import nothing_of_this_name\n```",
    "    python -m ema_sim\n",
])
def test_what_is_not_there_is_found(text, repository):
    assert not_there(repository, text) != []
    right = ("`ema_sim/plant/ports.py` `ema_record/` `config/fastdds*.xml` `ema_phm.rig` "
             "`ema_record.bag.read.read_bag` `python -m ema_sim.simulator_node`\n"
             "```\npython -m benchmarks.reliability\n```\n")
    assert not_there(repository, right) == []


def test_the_readme_is_short_and_leads_to_every_page(files):
    readme = files["README.md"]
    assert len(readme.splitlines()) <= README_LINES
    pages = {name for name in files if re.fullmatch(r"docs/[^/]+\.md", name)}
    assert pages - set(LINK.findall(readme)) == set()


def test_no_file_cites_a_page_that_is_not_here(files):
    assert [name for name, text in files.items() if NOT_HERE.search(text)] == []
    assert NOT_HERE.search("the law (DESIGN, sec" + "tion 3)")


@pytest.mark.slow
@pytest.mark.timeout(900)  # the pictures of the gallery are made by the commands
def test_the_pages_make_a_site_that_loads_nothing_from_a_network(repository, tmp_path):
    pytest.importorskip("mkdocs")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", tmp_path / "site"],
        cwd=repository, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) > len(list((repository / "docs").glob("*.md")))
    loaded = re.compile(r"<(?:script|img|link)\b[^>]*(?:src|href)=[\"']?(?:https?:)?//")
    assert [p.name for p in pages if loaded.search(p.read_text(encoding="utf-8"))] == []
    gallery = tmp_path / "site" / "gallery" / "index.html"
    shown = re.findall(r'<(?:img|iframe)[^>]*src="([^"]+)"', gallery.read_text(encoding="utf-8"))
    assert {Path(src).name for src in shown} == {
        "verdict.svg", "evidence.svg", "trend.svg", "report.html", "fleet.html"}
    assert all((gallery.parent / src).is_file() for src in shown)
    tutorials = {p.parent.name for p in pages if p.parent.parent.name == "tutorials"}
    assert tutorials == {"technician", "engineer", "integrator", "fleet"}


def words_of(line):
    """Return the command and the options of a line of a tutorial."""
    words = shlex.split(line)
    return words[1], {w for w in words[2:] if w.startswith("--") and w != "--"}


def test_every_command_of_the_documents_is_there_with_its_options(files):
    from typer.main import get_command

    from ema_cli.main import COMMANDS, build_app

    known = {}
    for name, text in files.items():
        if not (name == "README.md" or re.fullmatch(r"docs/.*\.md", name)):
            continue
        blocks = "\n".join(re.findall(r"^```[a-z]*\n(.*?)^```", text, re.DOTALL | re.MULTILINE))
        blocks = re.sub(r"\\\n *", "", blocks)  # lines that go on below
        for line in re.findall(r"^(?:\$ )?(ema .+?)(?:  +#.*)?$", blocks, re.MULTILINE):
            command, options = words_of(line)
            assert command in COMMANDS, (name, line)
            if command not in known:
                known[command] = {o for p in get_command(build_app(command)).params
                                  for o in (*p.opts, *p.secondary_opts)}
            assert options <= known[command], (name, line)
    assert len(known) > 10


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("who", ["technician", "engineer", "integrator", "fleet"])
def test_a_tutorial_can_be_followed(who, repository, tmp_path, monkeypatch, capsys):
    from ema_cli.main import run

    text = (repository / "docs" / "tutorials" / f"{who}.md").read_text(encoding="utf-8")
    (tmp_path / "bags").symlink_to(repository / "bags")
    for name in ("sim_0001_step", "sim_0001_extended"):
        shutil.copytree(repository / "bags" / name,
                        tmp_path / "flights" / "SN-0007" / name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    lines = re.findall(r"^\$ ema (.+)$", text, re.MULTILINE)
    assert len(lines) >= 3
    for line in lines:
        assert run(shlex.split(line)) in (0, 1, 3), (line, capsys.readouterr().err)
