"""What the built-in test sees at one moment."""

from __future__ import annotations

from dataclasses import dataclass

ACTUATOR_TIMEOUT = 3.0
"""Age at which the status of the actuator is no longer believed (s); it sends one a second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ActuatorStatus:
    """What the actuator says of itself on `/diagnostics`."""

    active: bool
    surface_position: float
    """(rad)"""
    command_stamp: int
    """Of the current or last command (ns since the epoch)."""
    start_time: int
    """Acceptance of that command (ns since the epoch)."""
    samples_published: int
    """For that command."""
    captures: bool = False
    """It publishes the samples of a move when the move is over."""
    complaint: str = ""
    """What is wrong in its words, as a command that it refused; empty: nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """What the test sees at one moment."""

    now: float
    """Monotonic clock (s)."""
    stamp: int
    """Ns since the epoch."""
    interlock: str = ""
    """Why the actuator must not move; empty: it may."""
    missing: str = ""
    """What of the graph is missing or in the way; empty: nothing."""
    actuator: ActuatorStatus | None = None
    actuator_heard: float = -1.0
    """Monotonic clock at that status (s)."""
    samples_received: int = 0
    """Since the last command of this test."""
    last_sample: float = -1.0
    """Time of the last sample since that command (s)."""
    last_position: float | None = None
    """Of the surface with that sample (rad); None: it is not recorded."""
    last_block: float = -1.0
    """Monotonic clock at the last block (s)."""
    abort: bool = False
    """Somebody asked for the end of the test."""
    foreign_command: bool = False
    """Somebody else commanded the actuator."""
    stop: bool = False
    """The process was asked to end."""
