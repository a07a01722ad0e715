"""The constant k of a phase from what data sheets state.

Between two terminals a star shows the difference of two phases, e_a − e_b. Its peak is 2 k ω for a
trapezoid with a top of 120 degrees, √3 k ω for a sine; its mean over the 60 degrees around the
peak, which block commutation uses, 2 k ω and 3 √3 / π k ω. The torque in block commutation a
current I is the same constant: no energy is lost. With sinusoidal currents of peak I it is
3/2 k₁ I, k₁ the fundamental (Krishnan, 2010, chapter 9).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ema_record.data_sheet.quantities import Given
from ema_record.errors import UsageError
from ema_record.profiles.motion import trapezoid

SHAPES = ("sine", "trapezoid")
VOLTAGES = ("mean", "peak", "rms")
"""What a voltage constant is of: the mean in block commutation, the peak, or rms, line to line."""
CURRENTS = ("block", "peak", "rms")
"""What a torque constant is a current of: of block commutation, or of a sinusoidal phase."""
FLAT_TOP = 2.0 * math.pi / 3.0
AGREE = 0.12
"""How far two statements of the same constant may differ: tolerances and warm magnets."""
_POINTS = 7200


class ShapeConstants(NamedTuple):
    """Constants of a back-EMF shape, all for k = 1."""

    peak: float
    mean: float
    rms: float
    """Of the voltage between two terminals."""
    fundamental: float
    """Of a phase."""


def shape_constants(shape: str) -> ShapeConstants:
    """Return the constants of ``sine`` or ``trapezoid``."""
    angle = (np.arange(_POINTS) + 0.5) * (2.0 * np.pi / _POINTS)

    def phase(at: np.ndarray) -> np.ndarray:
        return np.sin(at) if shape == "sine" else trapezoid(at, FLAT_TOP)

    line = phase(angle) - phase(angle - 2.0 * np.pi / 3.0)
    near = np.abs(angle - np.pi / 3.0) < np.pi / 6.0
    return ShapeConstants(
        peak=float(line.max()), mean=float(line[near].mean()),
        rms=float(np.sqrt((line**2).mean())),
        fundamental=2.0 * float((phase(angle) * np.sin(angle)).mean()))


def phase_constant(
    given: dict[str, Given], shape: str, voltage: str, current: str, bus: float
) -> tuple[float, str]:
    """Return k of a phase (V s/rad) and where it is from, as text.

    Parameters
    ----------
    given : what the data sheet states, by option.
    shape : of the back-EMF.
    voltage : what ``kv`` and ``back-emf`` are of, one of `VOLTAGES`.
    current : what ``torque-constant`` is a current of, one of `CURRENTS`.
    bus : nominal voltage where none is given (V).

    Raises
    ------
    UsageError
        No constant is stated, or two contradict each other.
    """
    of = shape_constants(shape)
    line = {"mean": of.mean, "peak": of.peak, "rms": of.rms}[voltage]
    torque = {"block": of.mean, "peak": 1.5 * of.fundamental,
              "rms": 1.5 * of.fundamental * math.sqrt(2.0)}[current]
    found: dict[str, float] = {}
    if "torque-constant" in given:
        found["torque-constant"] = given["torque-constant"].value / torque
    if "back-emf" in given:
        found["back-emf"] = given["back-emf"].value / line
    if "kv" in given:
        found["kv"] = 1.0 / (given["kv"].value * line)
    if "no-load-speed" in given:
        at = given["nominal-voltage"].value if "nominal-voltage" in given else bus
        idle = given["no-load-current"].value if "no-load-current" in given else 0.0
        inner = at - idle * given["resistance"].value
        found["no-load-speed"] = max(inner, 1e-3) / (given["no-load-speed"].value * of.mean)
    if not found:
        raise UsageError("no constant of the motor: give one of --kv, --back-emf, "
                         "--torque-constant and --no-load-speed")
    name, k = next(iter(found.items()))
    for other, value in found.items():
        if abs(value / k - 1.0) > AGREE:
            raise UsageError(
                f"--{name} {given[name].text} and --{other} {given[other].text} contradict each "
                f"other: k of a phase would be {k:.4g} or {value:.4g} V s/rad: check the units, "
                "--voltage-is and --current-is")
    words, over = {
        "torque-constant": (f"{current} current", torque),
        "no-load-speed": ("less the drop of the no-load current", of.mean),
    }.get(name, (f"{voltage} line to line", line))
    return k, f"--{name} {given[name].text} ({words}), over {over:.4g}"
