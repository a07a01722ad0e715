"""How fast a phase takes over the current: what the winding shows of R, L and back-EMF.

After a commutation the incoming phase rises at (V − e) / L until it meets its reference. The
charge that it lacks meanwhile is ½ I² L / (V − e): divided by I² it is a time over a current,
free of the load. Its growth from a quarter of the speed to the full speed shows the back-EMF,
its scatter between the phases a winding or a joint unlike the others.
"""

from __future__ import annotations

import numpy as np

from ema_prognostics.features.signals import Signals
from ema_record.channels import REFERENCE_CURRENTS
from ema_sim.plant.electrical import FIRST_EDGE, SECTOR, THIRD

FLOOR = 1e-9


def rise(signals: Signals, begin: float, end: float) -> tuple[float, float]:
    """Return the mean take-over and its spread between the phases, as logarithms.

    Parameters
    ----------
    signals : of the record.
    begin, end : a settled slew (s after the first command).
    """
    part = signals.between(begin, end)
    theta = signals.theta[part]
    ahead = theta[-1] >= theta[0]
    reference = signals.record.samples[part, REFERENCE_CURRENTS]
    lack = np.empty(3)
    for phase in range(3):
        angle = theta - phase * THIRD
        since = np.mod(angle - FIRST_EDGE if ahead else -FIRST_EDGE - angle, np.pi)
        incoming = since < SECTOR
        wanted = reference[incoming, phase]
        missing = np.abs(wanted) - np.sign(wanted) * signals.currents[part][incoming, phase]
        lack[phase] = missing.sum() / max(float(wanted @ wanted), FLOOR)
    mean = float(lack.mean())
    turned = complex(lack @ np.exp(1j * THIRD * np.arange(3)))
    return (float(np.log(max(mean, 1e-6))),
            float(np.log(abs(turned) / max(abs(mean), 1e-6) + 1e-3)))
