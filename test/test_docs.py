"""The documents: their links lead somewhere, and they rest on nothing that is not here."""

import re
import subprocess

import pytest

LINK = re.compile(r"(?<!`)\]\(([^)\s]+)\)")
ELSEWHERE = re.compile(r"[a-z]+:|#")
README_LINES = 120
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


def test_the_readme_is_short_and_leads_to_every_page(files):
    readme = files["README.md"]
    assert len(readme.splitlines()) <= README_LINES
    pages = {name for name in files if re.fullmatch(r"docs/[^/]+\.md", name)}
    assert pages - set(LINK.findall(readme)) == set()


def test_no_file_cites_a_page_that_is_not_here(files):
    assert [name for name, text in files.items() if NOT_HERE.search(text)] == []
    assert NOT_HERE.search("the law (DESIGN, sec" + "tion 3)")
