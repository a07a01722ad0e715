"""The two machines of the contract tests: the default one, and one of quite another size.

A law that holds for one gear, one pole pair, one bus and one rate may hold by chance.
"""

from __future__ import annotations

from typing import NamedTuple

import pytest

from ema_record.actuator import Actuator, load_actuator


class Machine(NamedTuple):
    """An actuator and the rate of its acquisition."""

    actuator: Actuator
    rate: float
    """Samples a second (1/s)."""


def changed(actuator: Actuator | None = None, **parts: dict[str, float]) -> Actuator:
    """Return an actuator with some parameters replaced, part by part."""
    a = actuator if actuator is not None else load_actuator()
    return a._replace(**{name: getattr(a, name)._replace(**v) for name, v in parts.items()})


DEFAULT = Machine(load_actuator(), load_actuator().acquisition.rate)
OTHER = Machine(changed(
    DEFAULT.actuator,
    inverter={"bus_voltage": 28.0},
    motor={"pole_pairs": 4, "phase_resistance": 0.5, "phase_inductance": 0.3e-3},
    gear={"ratio": 300.0},
    # The same slew speed of the surface, so that the shipped profiles fit.
    control={"speed_limit": 474.36, "position_gain": 1.2e4},
), 10_000.0)


@pytest.fixture
def other_actuator() -> Actuator:
    """Return an actuator with another gear, other pole pairs, another bus."""
    return OTHER.actuator


both_machines = pytest.mark.parametrize("machine", [DEFAULT, OTHER], ids=["default", "other"])
"""Runs a test with the default actuator at 20 kHz and the other one at 10 kHz."""
