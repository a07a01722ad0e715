"""Hooks of mkdocs: outside links become names, formulas MathML; pictures are made."""

import importlib.util
import re
import sys
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

OUTSIDE = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+)([^)]+)\)")
CODE = re.compile(r"(^```.*?^```|`[^`\n]+`)", re.DOTALL | re.MULTILINE)
FORMULA = re.compile(r"\$\$(.+?)\$\$|(?<![\w$])\$(?=\S)([^$\n]+)(?<=\S)\$(?![\w$])", re.DOTALL)
MAKE = Path(__file__).parent / "pictures" / "make.py"


def on_files(files: Files, *, config: Any) -> Files:
    """Return the files with the pictures of the gallery, made now by the commands."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    spec = importlib.util.spec_from_file_location("make_pictures", MAKE)
    assert spec is not None and spec.loader is not None
    make = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make)
    for name, content in make.made().items():
        files.append(File.generated(config, f"made/{name}", content=content))
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Return the page with formulas as MathML and links to what is outside as text."""
    depth = page.file.src_uri.count("/")

    def text(found: re.Match[str]) -> str:
        if found[2].count("../") <= depth:
            return found[0]
        return f"{found[1]} (`{found[3]}` of the repository)"

    parts = CODE.split(OUTSIDE.sub(text, markdown))  # every second one is code
    return "".join(part if n % 2 else FORMULA.sub(_mathml, part) for n, part in enumerate(parts))


def _mathml(found: re.Match[str]) -> str:
    """Return a formula as the browser draws it without a script."""
    if found[1]:
        return f"<div class='formula'>{convert(found[1], display='block')}</div>"
    return str(convert(found[2]))
