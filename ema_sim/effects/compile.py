"""How the physics is compiled: numba options, and a cache that is never stale.

numba's disk cache looks at the file of a function, not at the files that it calls. The kernel
therefore closes over `source_hash`, a hash of all sources of this package, which numba takes
into its cache key: an edit anywhere in the package compiles anew.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from numba import njit

ROS_ONLY = ("parameter_events.py", "server.py", "simulator_node.py")
"""Files that no law calls: an edit there compiles nothing anew."""

law = njit(forceinline=True, error_model="numpy")
"""Decorator of every law and equation: compiled into its caller."""


def source_hash() -> str:
    """Return a hash of the package's Python sources, without those that only speak ROS."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        if path.name in ROS_ONLY:
            continue
        digest.update(str(path.relative_to(root)).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()
