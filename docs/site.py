"""Hooks of mkdocs: links to files outside these pages become names; pictures are made."""

import importlib.util
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

OUTSIDE = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+)([^)]+)\)")
MAKE = Path(__file__).parent / "pictures" / "make.py"


def on_files(files: Files, *, config: Any) -> Files:
    """Return the files with the pictures of the gallery, made now by the commands."""
    spec = importlib.util.spec_from_file_location("make_pictures", MAKE)
    assert spec is not None and spec.loader is not None
    make = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make)
    for name, content in make.made().items():
        files.append(File.generated(config, f"made/{name}", content=content))
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Return the page with links to what is outside as text: the site holds none of that."""
    depth = page.file.src_uri.count("/")

    def text(found: re.Match[str]) -> str:
        if found[2].count("../") <= depth:
            return found[0]
        return f"{found[1]} (`{found[3]}` of the repository)"

    return OUTSIDE.sub(text, markdown)
