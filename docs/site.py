"""Hook of mkdocs: a link to a file outside these pages becomes the file's name."""

import re
from typing import Any

OUTSIDE = re.compile(r"\[([^\]]+)\]\(\.\./([^)]+)\)")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return the page with such links as text: the site holds none of these files."""
    return OUTSIDE.sub(r"\1 (`\2` of the repository)", markdown)
