"""Dry and viscous friction, told apart by the torque at several speeds.

The torque of a slew is T = C + D ω: dry friction C of motor and surface, viscous friction D.
Grease makes D anything between half and twice nominal; three speeds (full, a quarter, the ramp)
give both, so dry friction without a baseline is known as well as if D were (Armstrong-Hélouvry,
Dupont, Canudas de Wit 1994, the Coulomb and viscous parts of a Stribeck curve).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ema_prognostics.features.balance import Balance
from ema_prognostics.features.signals import Signals
from ema_prognostics.features.vector import SWING

LEAST = 1e-3
"""Floor of the dry friction, part of the torque at the lowest speed."""


def dry_and_viscous(speed: Sequence[float], torque: Sequence[float]) -> tuple[float, float]:
    """Return the torque at rest (N m) and its growth with speed (N m s/rad): least squares.

    Parameters
    ----------
    speed : of each slew, along its sense of rotation (rad/s); two that differ at least.
    torque : mean torque along it (N m).
    """
    x, y = np.asarray(speed, dtype=float), np.asarray(torque, dtype=float)
    away = x - x.mean()
    slope = float(away @ y / max(float(away @ away), np.finfo(float).tiny))
    return float(y.mean() - slope * x.mean()), slope


def dry_friction(
    signals: Signals, balances: Mapping[str, Balance], ramps: Sequence[tuple[float, float]],
    ramp_torque: float,
) -> tuple[dict[str, float], dict[str, Balance]]:
    """Return the dry torque, a logarithm of N m, and what viscous friction takes at full speed.

    Where the quarter-speed slew swings its mean torque lies between the dynamic and the static
    level and is no friction at that speed: the other two speeds count, and the slew is given the
    torque between theirs.

    Parameters
    ----------
    signals : of the record.
    balances : of the slews ``full``, ``quarter`` and those back.
    ramps : begin and end of the slow ramps (s after the first command).
    ramp_torque : mean torque along the ramps (N m).

    Returns
    -------
    The two features by name; the balances, with that torque.
    """
    speed, torque, swing = [], [], []
    for name in ("full", "quarter"):
        pair = balances[name], balances[f"{name}_back"]
        speed.append(float(np.mean([b.speed for b in pair])))
        torque.append(float(np.mean([b.torque for b in pair])))
        swing.append(max(b.swing for b in pair))
    slow = [abs(float(signals.speed[signals.between(*w)].mean())) for w in ramps]
    speed.append(float(np.mean(slow)))
    torque.append(ramp_torque)
    found = dict(balances)
    if swing[1] > SWING >= swing[0]:
        dry, slope = dry_and_viscous(speed[::2], torque[::2])
        more = dry + slope * speed[1] - torque[1]
        for name in ("quarter", "quarter_back"):
            found[name] = found[name]._replace(torque=max(found[name].torque + more, 1e-9))
    else:
        dry, slope = dry_and_viscous(speed, torque)
    return {"dry_torque": float(np.log(max(dry, LEAST * ramp_torque, 1e-9))),
            "viscous_share": slope * speed[0] / max(ramp_torque, 1e-9)}, found
