"""How the physics is compiled: numba options, and a cache that is never stale.

numba's disk cache looks at the file of a function, not at the files that it calls. The kernel
therefore closes over the hash of all sources that it depends on (`ema_record.sources`), which
numba takes into its cache key: an edit of any of them compiles anew, and no other edit does.
"""

from __future__ import annotations

from numba.extending import register_jitable

law = register_jitable(
    forceinline=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""Decorator of every law and equation: compiled into its callers, and plain Python for Python.

A law has no entry for Python, which would unpack all parameters: so it compiles thrice as fast.
"""
