"""Whole turns of the rotor in a part of a record, and lines at multiples of their frequency.

Everything that is periodic in the rotor angle is averaged over a whole number of turns.
A sample counts with the angle that it covers; the samples at both ends count in part, so
neither the sample rate nor a partial turn biases a line. Lines are demodulated against the
measured rotor angle, so no bin of a Fourier transform need fall on a line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ema_record.channels import ROTOR_ANGLE, TIME
from ema_record.errors import IncompleteRecordError, InvalidRecordError
from ema_record.profile import Profile
from ema_record.record import Record

TURN = 2.0 * np.pi
MIN_SAMPLES_A_TURN = 24
"""Fewest samples a turn at which the sixth line and a trimmed portion are resolved."""
WINDOW_AFTER_COMMAND = (0.06, 0.36)
"""The paper's window, "immediately after the transient", after the command (s)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Turns:
    """A whole number of turns of the rotor.

    Attributes
    ----------
    samples : ndarray, shape (n, 10). Rows of the record that the turns touch.
    theta : ndarray, shape (n,). Electrical angle, unwrapped (rad).
    weight : ndarray, shape (n,). Part of the turns that each sample covers; sums to 1.
    count : number of turns.
    frequency : electrical frequency f_e, of that window (Hz).
    direction : +1 or -1, the sense of rotation.
    """

    samples: np.ndarray
    theta: np.ndarray
    weight: np.ndarray
    count: int
    frequency: float
    direction: int


def paper_window(profile: Profile) -> tuple[float, float]:
    """Return the analysis window of the paper's features (s)."""
    if profile.window is not None:
        return profile.window
    start = profile.command_time
    return start + WINDOW_AFTER_COMMAND[0], start + WINDOW_AFTER_COMMAND[1]


def cut(record: Record, window: tuple[float, float]) -> np.ndarray:
    """Return the samples inside `window` (s), shape (n, 10); IncompleteRecordError if short."""
    time = record.time
    if len(time) < 2:
        raise IncompleteRecordError(f"{len(time)} samples: repeat the test")
    margin = 2.0 / record.rate
    if time[0] > window[0] + margin or time[-1] < window[1] - margin:
        raise IncompleteRecordError(
            f"the record covers {time[0]:.3f} to {time[-1]:.3f} s, the analysis needs "
            f"{window[0]:.3f} to {window[1]:.3f} s: repeat the test"
        )
    first, last = np.searchsorted(time, window)
    return record.samples[first:last]


def whole_turns(
    record: Record, window: tuple[float, float], *, min_turns: int = 4, pole_pairs: int = 1,
) -> Turns:
    """Return the largest whole number of turns inside `window`.

    A turn is one of the electrical angle; the number is a multiple of `pole_pairs`, so that it
    is one of the rotor's own turns too.

    Parameters
    ----------
    record : the record.
    window : begin and end (s).
    min_turns : fewest electrical turns that are accepted.
    pole_pairs : of the motor.

    Raises
    ------
    IncompleteRecordError
        The window is not covered, or holds fewer turns.
    InvalidRecordError
        Too few samples a turn, or the angle does not advance.
    """
    samples = cut(record, window)
    if len(samples) < MIN_SAMPLES_A_TURN:
        raise IncompleteRecordError(
            f"{len(samples)} samples in the analysis window, at least {MIN_SAMPLES_A_TURN}: "
            "record at a higher rate"
        )
    theta = np.unwrap(samples[:, ROTOR_ANGLE])
    travel = theta[-1] - theta[0]
    direction = 1 if travel >= 0.0 else -1
    count = int(abs(travel) / TURN / pole_pairs) * pole_pairs
    if count < max(min_turns, pole_pairs):
        raise IncompleteRecordError(
            f"{abs(travel) / TURN:.1f} turns of the rotor in the analysis window "
            f"{window[0]:.3f} to {window[1]:.3f} s, at least {max(min_turns, pole_pairs)}: "
            "the surface did not move as commanded, repeat the test"
        )
    if len(samples) < MIN_SAMPLES_A_TURN * count:
        raise InvalidRecordError(
            f"{len(samples) / count:.1f} samples a turn, at least {MIN_SAMPLES_A_TURN}: "
            "record at a higher rate"
        )
    # Cell edges half way between samples; clipped to the whole turns.
    edges = np.empty(len(theta) + 1)
    edges[1:-1] = 0.5 * (theta[1:] + theta[:-1])
    edges[0], edges[-1] = theta[0], theta[-1]
    progress = np.clip(direction * (edges - theta[0]), 0.0, TURN * count)
    weight = np.diff(progress) / (TURN * count)
    keep = slice(0, int(np.max(np.nonzero(weight)[0])) + 1)
    end = np.interp(TURN * count, np.maximum.accumulate(direction * (theta - theta[0])),
                    samples[:, TIME])
    return Turns(
        samples=samples[keep], theta=theta[keep], weight=weight[keep], count=count,
        frequency=count / float(end - samples[0, TIME]), direction=direction,
    )


def waves_at(theta: np.ndarray, orders: Sequence[float]) -> dict[float, np.ndarray]:
    """Return exp(jhθ), shape (n,), by multiple: the product of two that are there, if it is one.

    A product costs a tenth of sine and cosine; its error grows by one rounding a multiple.
    """
    found: dict[float, np.ndarray] = {}
    for h in orders:
        part = next((a for a in found if h - a in found), None)
        if part is None:
            found[h] = np.cos(h * theta) + 1j * np.sin(h * theta)
        else:
            found[h] = found[part] * found[h - part]
    return found


def rotor_lines(
    turns: Turns, signal: np.ndarray, harmonics: int | Sequence[float] = 6
) -> np.ndarray:
    """Return the complex lines of `signal` at multiples of the electrical angle, 0 the first.

    Weighted least squares on 1, the drift along the window, cos hθ and sin hθ, so that
    neither a drift nor a partial turn leaks into a line.

    Parameters
    ----------
    turns : whole turns of the rotor.
    signal : ndarray, shape (n,) or (n, m), one row a sample of `turns`.
    harmonics : highest multiple, or the multiples themselves (multiples of 1 / pole pairs).

    Returns
    -------
    ndarray, complex, shape (lines + 1,) or (lines + 1, m). The entry of multiple h is c with
    signal = Re(c exp(jhθ)) + ...; entry 0 is the mean. Unit of the signal.
    """
    orders = range(1, harmonics + 1) if isinstance(harmonics, int) else harmonics
    theta, weight = turns.theta, turns.weight
    drift = np.linspace(-1.0, 1.0, len(theta))
    columns = [np.ones_like(theta), drift]
    for wave in waves_at(theta, orders).values():
        columns += [wave.real, wave.imag]
    design = np.stack(columns)
    weighted = design * weight
    coefficients = np.linalg.solve(weighted @ design.T, weighted @ signal)
    lines = np.empty((len(orders) + 1, *coefficients.shape[1:]), dtype=complex)
    lines[0] = coefficients[0]
    lines[1:] = coefficients[2::2] - 1j * coefficients[3::2]
    return lines
