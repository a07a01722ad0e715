"""How late and how strongly the controller answers to what it measures.

The noise of the speed sensor goes round the loop: the controller answers each reading with its
proportional gain, and the record holds both reading and reference current. Reading and reference
less their neighbours are the noise alone; regressed on each other over several samples they give
the answer, sample by sample, hence its delay and the gain. Where there is no noise to answer,
the declared answer stands (ridge regression towards it, Hoerl and Kennard 1970): a record that is
too quiet to tell is no sign of another controller.
"""

from __future__ import annotations

import numpy as np

from ema_prognostics.features.signals import Signals
from ema_record.actuator import FOC
from ema_record.channels import REFERENCE_CURRENTS
from ema_sim.machine import FIRST_EDGE, SECTOR
from ema_sim.rebuild import torque_command

LONGEST = 1.5e-3
"""Longest delay that is sought (s)."""
MOST_LAGS = 50
RIDGE = 0.03
"""Added to the powers: what the filter has taken out of the noise cannot be told."""
UNTOLD = 0.1
"""Part of the declared noise of the speed that tells as much as the declaration itself."""
FILTERED = 1.5
"""Variance of white noise less the mean of its neighbours, over that of the noise."""
TINY = 1e-9


def _command(signals: Signals, part: slice) -> np.ndarray:
    """Return the reference of the torque current, shape (n,) (A), NaN at commutations."""
    theta = signals.theta[part]
    value = torque_command(signals.record.samples[part, REFERENCE_CURRENTS], theta,
                           signals.actuator)
    if signals.actuator.drive.kind == FOC:
        return value
    place = (theta - FIRST_EDGE) / SECTOR
    reach = 0.5 * np.abs(np.gradient(place)) + 1e-3
    whole = np.floor(place - reach) == np.floor(place + reach)
    return np.where(whole, value, np.nan)


def control_loop(signals: Signals, begin: float, end: float) -> dict[str, float]:
    """Return the delay of the control, log of ms, and its gain, log of that of the model.

    Delays below a period of the control are alike: a digital control acts once a period.

    Parameters
    ----------
    signals : of the record.
    begin, end : a slew at the limit of the speed, where the position does not act (s after the
        first command).
    """
    lags = min(MOST_LAGS, int(LONGEST * signals.rate))
    part = signals.between(begin, end)
    speed, wanted = signals.speed[part], _command(signals, part)
    noise = speed[1:-1] - 0.5 * (speed[2:] + speed[:-2])
    change = (wanted[1:-1] - 0.5 * (wanted[2:] + wanted[:-2]))[lags:]
    late = np.lib.stride_tricks.sliding_window_view(noise, lags + 1)[:, ::-1]
    known = np.isfinite(change)
    x, y = late[known], change[known]
    control, acquisition = signals.actuator.control, signals.actuator.acquisition
    declared = np.zeros(lags + 1)
    late_by = acquisition.reference_latency * control.period * signals.rate
    declared[min(round(late_by), lags)] = control.proportional_gain
    untold = FILTERED * (UNTOLD * signals.actuator.noise.speed) ** 2 * len(y) + TINY
    power = x.T @ x
    ridge = RIDGE * np.diag(power) + untold
    answer = np.linalg.solve(power + np.diag(ridge), ridge * declared - x.T @ y)
    strength = np.maximum(answer, 0.0) ** 2
    total = max(float(strength.sum()), 1e-9)
    delay = float(strength @ np.arange(lags + 1)) / total / signals.rate
    gain = np.sqrt(total) / control.proportional_gain
    return {"control_delay": float(np.log(1e3 * max(delay, control.period))),
            "control_gain": float(np.log(gain))}
