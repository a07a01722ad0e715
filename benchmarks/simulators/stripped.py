"""The stripped C loop, compiled here and called through ctypes."""

from __future__ import annotations

import ctypes
import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.simulators import drive as d

FLAGS = ("-O3", "-march=native", "-ffast-math", "-shared", "-fPIC")
PARAMETERS = (d.R, d.L, d.K, d.V_LEG, d.BAND, d.I_MAX, d.J, d.DRY, d.VISCOUS, d.OMEGA, d.KP,
              d.KI, d.PERIOD)


def compiled(folder: Path) -> Callable[[float, float, float], np.ndarray]:
    """Return ``simulate(theta, dt, length)`` in C, compiled into `folder`.

    Raises
    ------
    OSError, subprocess.CalledProcessError
        No compiler, or it fails.

    """
    library = folder / "stripped.so"
    source = Path(__file__).with_name("stripped.c")
    compiler = os.environ.get("CC", "gcc")
    subprocess.run([compiler, *FLAGS, str(source), "-o", str(library), "-lm"], check=True,
                   capture_output=True)
    function = ctypes.CDLL(str(library)).simulate
    array = np.array(PARAMETERS)
    function.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_long,
                         ctypes.c_long, ctypes.c_void_p]
    function.restype = None

    def simulate(theta: float, dt: float, length: float) -> np.ndarray:
        out = np.empty((round(length / d.SAMPLE), 4))
        function(array.ctypes.data, theta, dt, len(out), round(d.SAMPLE / dt), out.ctypes.data)
        return out

    return simulate
