"""The gap of zero shaft torque where the slow ramp turns round.

Against the motor's travel the motor torque falls with the slope of the shaft, stays level
while the lost motion is crossed, and falls again. The width of the level is the backlash,
whatever stiffness and friction are; the level itself is the motor's own friction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ema_prognostics.features.signals import Signals
from ema_record.channels import median

BIN, NEAR, LEAST_SPAN = 0.016, 0.04, 0.2
"""Motor travel a bin, least travel, and least reach of the search, of `Actuator.wind_up`."""
LEAST_SLOPE = 0.05
"""Floor of a slope, of that of the nominal shaft."""
STARTED = 0.15
"""Motion of the surface, of the shaft's wind-up, at which it has started."""
NEAR_RAMP = 0.9
"""Where no position is recorded: the curve ends at this share of the last torque."""
LAG = 2e-3
"""Length of the speed's smoothing (s)."""


class LostMotion(NamedTuple):
    """Result of one reversal."""

    width: float
    """Lost motion (rad at the surface)."""
    level: float
    """Motor torque in the gap, along the new sense of rotation (N m)."""
    slope: float
    """Stiffness of the shaft relative to nominal."""
    error: float
    """Root mean square of the fit's residual (N m)."""
    bend: float
    """Log of the slope after the gap over that before it: friction in proportion to load."""


def _model(x: np.ndarray, release: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Return the unit curve at `x`: rises to `release`, level for `width`, rises again."""
    return np.minimum(x - release, 0.0) + np.maximum(x - release - width, 0.0)


def _search(
    x: np.ndarray, y: np.ndarray, weight: np.ndarray, release: np.ndarray, width: np.ndarray
) -> tuple[float, float, float, float, float]:
    """Return (sse, release, width, level, slope) of the best pair on the grid."""
    r, w = (g.ravel()[:, None] for g in np.meshgrid(release, width, indexing="ij"))
    f = _model(x[None, :], r, w)
    total = weight.sum()
    f_mean = f @ weight / total
    y_mean = float(y @ weight / total)
    covariance = (f * weight) @ y - total * f_mean * y_mean
    variance = (f * f) @ weight - total * f_mean**2
    variance = np.maximum(variance, 1e-12)
    slope = np.maximum(covariance / variance, 0.0)
    sse = (y * y) @ weight - total * y_mean**2 - 2 * slope * covariance + slope**2 * variance
    best = int(np.argmin(sse))
    return (float(sse[best]), float(r[best, 0]), float(w[best, 0]),
            float(y_mean - slope[best] * f_mean[best]), float(slope[best]))


def _bend(
    x: np.ndarray, y: np.ndarray, weight: np.ndarray, release: float, width: float, least: float
) -> float:
    """Return the log of the slope after the gap over that before, the gap where it was found."""
    root = np.sqrt(weight)
    curve = np.column_stack([
        np.minimum(x - release, 0.0), np.maximum(x - release - width, 0.0), np.ones(len(x))])
    before, after, _ = np.linalg.lstsq(curve * root[:, None], y * root, rcond=None)[0]
    return float(np.log(max(after, least) / max(before, least)))


def reversal_gap(signals: Signals, begin: float, length: float, direction: int) -> LostMotion:
    """Return the gap of the reversal at `begin` (s after the first command).

    Parameters
    ----------
    signals : of the record.
    begin, length : window (s).
    direction : sense of rotation after the reversal.
    """
    part = signals.between(begin, begin + length)
    actuator = signals.actuator
    ratio, wind_up = actuator.gear.ratio, actuator.wind_up
    n = max(3, round(LAG * signals.rate))
    kernel = np.ones(n) / n
    theta = direction * signals.motor_angle[part]
    speed = direction * np.convolve(signals.speed[part], kernel, mode="same")
    step = 1.0 / signals.rate
    acceleration = np.convolve(np.gradient(speed, step), kernel, mode="same")
    torque = (
        direction * signals.torque_constant * signals.torque_current[part]
        - actuator.motor.inertia * acceleration
        - actuator.motor.viscous_friction * speed
    )
    turned = int(np.argmin(theta))
    travel = theta - theta[turned]
    place = np.arange(len(theta))
    moving = (travel > NEAR * wind_up) & (place > max(turned, n)) & (place < len(theta) - n)
    # The curve ends where the surface moves.
    if signals.has_position:
        rest = direction * signals.position[part][turned:turned + n].mean()
        travelled = direction * np.convolve(signals.position[part], kernel, mode="same") - rest
        moved = travelled > STARTED * wind_up / ratio
    else:
        smooth = np.convolve(torque, kernel, mode="same")
        moved = smooth > NEAR_RAMP * float(median(smooth[-4 * n:-n]))
    after = np.flatnonzero(moved & moving)
    end = int(after[0]) - n if len(after) else len(theta) - n
    moving[max(end, turned + 4 * n):] = False
    if np.count_nonzero(moving) < 40:
        return LostMotion(0.0, 0.0, 0.0, 1.0, 0.0)
    x, y = travel[moving], torque[moving]
    index = (x / (BIN * wind_up)).astype(int)
    count = np.bincount(index)
    used = count > 0
    weight = count[used].astype(float)
    x = np.bincount(index, x)[used] / weight
    y = np.bincount(index, y)[used] / weight
    span = float(x[-1])
    release = np.linspace(NEAR * wind_up, max(span, LEAST_SPAN * wind_up), 28)
    width = np.linspace(0.0, span, 40)
    sse, r, w, level, slope = _search(x, y, weight, release, width)
    for _ in range(3):
        dr, dw = release[1] - release[0], width[1] - width[0]
        release = np.linspace(max(0.0, r - dr), r + dr, 15)
        width = np.linspace(max(0.0, w - dw), w + dw, 15)
        sse, r, w, level, slope = _search(x, y, weight, release, width)
    nominal = actuator.shaft.stiffness / ratio**2
    error = float(np.sqrt(max(sse, 0.0) / weight.sum()))
    bend = _bend(x, y, weight, r, w, LEAST_SLOPE * nominal)
    return LostMotion(w / ratio, level, slope / nominal, error, bend)
