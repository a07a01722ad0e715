"""Features as vectors: differences to the baseline, squashing, rotation of the phases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_record.actuator import load_actuator

ABSOLUTE = "absolute_"
"""Marks a feature itself beside its difference to the baseline."""
SWINGS = {speed: f"swing_{speed}" for speed in ("quarter", "full")}
"""Feature that says how much a slew swings by itself, see `balance.Balance`."""
SWING = 0.001
"""Part of its speed from which a slew swings: limit cycles (stick-slip of the surface on the
shaft) do by 0.0013 to 0.2, beats of the sampling with the carrier by up to 0.0004."""
START = "start_position"


def difference_names(names: Sequence[str]) -> list[str]:
    """Return the names with a baseline: differences, then the features themselves."""
    return [*names, *(f"{ABSOLUTE}{n}" for n in names)]


def differences(record: np.ndarray, baseline: np.ndarray) -> np.ndarray:
    """Return the features with a baseline, shape (n, 2 d), of two arrays of shape (n, d)."""
    return np.hstack([record - baseline, record])


def squash(x: np.ndarray, center: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Return asinh((x − centre) / spread): linear near healthy, logarithmic far away."""
    return np.arcsinh((x - center) / spread)


def start_allowed(x: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Return features, shape (n, d), with the position before the test zero where it may be.

    Before a live test the surface is driven to its start, and static friction holds it where it
    comes to rest, up to the wind-up off; only what is beyond counts.
    """
    actuator = load_actuator()
    reach = 1e3 * actuator.wind_up / actuator.gear.ratio  # mrad
    return np.where(np.array(names) == START, np.sign(x) * np.maximum(np.abs(x) - reach, 0.0), x)


def disturbed(name: str, speed: str) -> bool:
    """Whether a limit cycle in a slew makes a feature something else: scatter, rise, agreement."""
    bare = name.removeprefix(ABSOLUTE)
    return bare.startswith(("position_rms_", "speed_rms_", "torque_rms_", "rise_",
                            "speed_over_angle_", "position_over_angle_")) and bare.endswith(
                                (speed, f"{speed}_back"))


def swings(names: Sequence[str], x: np.ndarray) -> np.ndarray:
    """Return which slews swing, bool, shape (n, speeds of `SWINGS` that there are).

    With a baseline: in the record or in the baseline.
    """
    place = {name: k for k, name in enumerate(names)}
    found = []
    for name in (n for n in SWINGS.values() if n in place):
        largest = x[:, place[name]]
        if ABSOLUTE + name in place:
            own = x[:, place[ABSOLUTE + name]]
            largest = np.maximum(own, own - largest)
        found.append(largest > SWING)
    return np.array(found, dtype=bool).reshape(-1, len(x)).T


def untold(names: Sequence[str], x: np.ndarray, instead: np.ndarray) -> np.ndarray:
    """Return which slews tell nothing of the sensors; arguments and shape as `steady`.

    Those that swing, unless all do, or those of usual units.
    """
    off = swings(names, x)
    return np.asarray(off & ~off.all(axis=1, keepdims=True) & ~swings(
        names, np.broadcast_to(instead, x.shape)))


def steady(names: Sequence[str], x: np.ndarray, instead: np.ndarray) -> np.ndarray:
    """Return features, shape (n, d), with `instead` where a slew that swings tells nothing.

    What a limit cycle makes of scatter and agreement of the sensors is not theirs. By how much a
    slew swings is no feature.

    Parameters
    ----------
    names : of the features.
    x : ndarray, shape (n, d).
    instead : ndarray, shape (d,) or (n, d). What is expected of a healthy unit.
    """
    instead = np.broadcast_to(instead, x.shape)
    off, out = untold(names, x, instead), x.copy()
    for k, speed in enumerate(s for s, name in SWINGS.items() if name in names):
        columns = np.array([disturbed(name, speed) for name in names])
        place = off[:, k, None] & columns
        out[place] = instead[place]
        for c, name in enumerate(names):
            if name.removeprefix(ABSOLUTE) == SWINGS[speed]:
                out[:, c] = instead[:, c]
    return out


def rotate(x: np.ndarray, names: Sequence[str], thirds: int) -> np.ndarray:
    """Return the features as if the rotor angle were counted from a phase further on.

    A fault of phase b, rotated by one third, looks like the same fault of phase a: line h of
    phase b lags by h 120°.

    Parameters
    ----------
    x : ndarray, shape (n, d). Features.
    names : of the features; ``..._m<h>_re`` is followed by ``..._m<h>_im``.
    thirds : number of phases.
    """
    out = x.copy()
    for k, name in enumerate(names):
        if name.endswith("_re") and "_m" in name:
            h = int(name[name.rindex("_m") + 2:-3])
            turned = (x[:, k] + 1j * x[:, k + 1]) * np.exp(2j * np.pi * h * thirds / 3.0)
            out[:, k], out[:, k + 1] = turned.real, turned.imag
    return out
