"""Where the shipped files (configuration, models) are, however the package was installed."""

from __future__ import annotations

from pathlib import Path

PACKAGE = "ema_phm"


def share_path(relative: str) -> Path:
    """Return the path of a shipped file or folder.

    A checkout keeps them beside the packages; ``pip install`` and ``colcon build``
    put them into ``share/ema_phm`` of the prefix.
    """
    here = Path(__file__).resolve()
    for parent in here.parents:
        for candidate in (parent / relative, parent / "share" / PACKAGE / relative):
            if candidate.exists() and (candidate.parent != parent or parent == here.parents[1]):
                return candidate
    raise FileNotFoundError(f"{relative}: not found beside {here.parent} nor in a share folder")
