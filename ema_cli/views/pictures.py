"""Pictures as files: PNG, SVG or PDF, by the ending of the name; new ones only."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ema_record.errors import UsageError
from ema_record.files import new_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")


def picture_format(path: Path) -> str:
    """Return the format of a picture by the ending of its name; UsageError for another."""
    if path.suffix.lower() not in FORMATS:
        raise UsageError(f"--plot {path}: {path.suffix or 'no ending'} is no picture: end the "
                         f"name with {', '.join(FORMATS)}")
    return path.suffix.lower()[1:]


def save_picture(figure: Figure, path: Path) -> Path:
    """Write a figure into a new file, in the format of its name."""
    with new_file(path) as temporary:
        figure.savefig(temporary, format=picture_format(path))
    return path
