"""Lines at multiples of the electrical frequency, demodulated against the measured rotor angle.

So no bin of a Fourier transform need fall on a line.
"""

from __future__ import annotations

import numpy as np

from ema_prognostics.features.turns import Turns


def rotor_lines(turns: Turns, signal: np.ndarray, harmonics: int = 6) -> np.ndarray:
    """Return the complex lines of `signal` at 0..`harmonics` times the rotor angle.

    Weighted least squares on 1, the drift along the window, cos hθ and sin hθ, so that
    neither a drift nor a partial turn leaks into a line.

    Parameters
    ----------
    turns : whole turns of the rotor.
    signal : ndarray, shape (n,) or (n, m), one row a sample of `turns`.
    harmonics : highest multiple.

    Returns
    -------
    ndarray, complex, shape (harmonics + 1,) or (harmonics + 1, m). Entry h is c with
    signal = Re(c exp(jhθ)) + ...; entry 0 is the mean. Unit of the signal.
    """
    theta, weight = turns.theta, turns.weight
    drift = np.linspace(-1.0, 1.0, len(theta))
    columns = [np.ones_like(theta), drift]
    for h in range(1, harmonics + 1):
        columns += [np.cos(h * theta), np.sin(h * theta)]
    design = np.stack(columns, axis=1)
    weighted = design * weight[:, None]
    coefficients = np.linalg.solve(weighted.T @ design, weighted.T @ signal)
    lines = np.empty((harmonics + 1, *coefficients.shape[1:]), dtype=complex)
    lines[0] = coefficients[0]
    lines[1:] = coefficients[2::2] - 1j * coefficients[3::2]
    return lines
