"""How the physics is compiled: numba options, and a cache that is never stale.

numba's disk cache looks at the file of a function, not at the files that it calls. The kernel
therefore closes over the hash of all sources that it depends on (`ema_record.sources`), which
numba takes into its cache key: an edit of any of them compiles anew, and no other edit does.
"""

from __future__ import annotations

from numba import njit

law = njit(forceinline=True, error_model="numpy")
"""Decorator of every law and equation: compiled into its caller."""
