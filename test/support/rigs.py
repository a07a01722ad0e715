"""Synthetic rigs with a known answer: other units, other drives, other outputs than the two.

The motion is prescribed (a position loop that tracks well) and the input follows from it, with
noise on both. `free_run` integrates the equation of motion instead, with sticking.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ema_identification.result import Identification
from ema_rig.record import Axis, RigRecord

Law = Callable[["Motion"], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A motion at an even rate; shape (n,) each."""

    time: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Rig:
    """What a rig is, in SI units of its own axis."""

    name: str
    motion: str
    input: str
    inertia: float
    viscous: float
    stroke: float
    """Amplitude of the motion (m or rad)."""
    frequency: float
    """Lowest frequency of the motion (Hz)."""
    duration: float
    rate: float
    outputs: tuple[str, ...]
    input_noise: float
    """White noise of the input a sample, in units of its rms without effects."""
    position_noise: float
    """White noise of the position a sample, in units of the stroke."""
    speed_noise: float = 1e-3
    """The same of the speed, in units of its rms."""


RIGS = {
    rig.name: rig
    for rig in (
        Rig(name="screw", motion="linear", input="force", inertia=60.0, viscous=150.0,
            stroke=0.15, frequency=0.4, duration=20.0, rate=500.0, outputs=("position",),
            input_noise=0.02, position_noise=2e-6),
        Rig(name="crane", motion="linear", input="voltage", inertia=0.4, viscous=6.0,
            stroke=0.6, frequency=0.25, duration=30.0, rate=250.0, outputs=("position",),
            input_noise=0.03, position_noise=5e-6),
        Rig(name="spindle", motion="rotary", input="torque", inertia=2e-3, viscous=3e-3,
            stroke=12.0, frequency=0.3, duration=20.0, rate=500.0, outputs=("speed",),
            input_noise=0.02, position_noise=1e-6),
        Rig(name="joint", motion="rotary", input="current", inertia=0.05, viscous=0.2,
            stroke=1.2, frequency=0.35, duration=20.0, rate=400.0,
            outputs=("position", "speed"), input_noise=0.02, position_noise=5e-6),
        Rig(name="motor", motion="rotary", input="current", inertia=2.5e-4, viscous=6e-4,
            stroke=9.0, frequency=0.5, duration=15.0, rate=1000.0,
            outputs=("position", "speed"), input_noise=0.02, position_noise=5e-6),
        Rig(name="valve", motion="rotary", input="voltage", inertia=0.02, viscous=0.5,
            stroke=0.7, frequency=0.2, duration=40.0, rate=200.0, outputs=("position",),
            input_noise=0.03, position_noise=2e-6),
    )
}
"""Six rigs by name."""


def changed(record: RigRecord, **laws: Callable[[np.ndarray], np.ndarray]) -> RigRecord:
    """Return a record with channels changed, each by a law."""
    samples = record.samples.copy()
    for name, law in laws.items():
        column = [c.name for c in record.channels].index(name)
        samples[:, column] = law(samples[:, column])
    return replace(record, samples=samples)


def motion_of(rig: Rig, rng: np.random.Generator) -> Motion:
    """Return a motion of five incommensurate frequencies with random phases."""
    time = np.arange(int(rig.duration * rig.rate)) / rig.rate
    total = np.zeros((3, len(time)))
    for k, factor in enumerate((1.0, 1.618, 2.414, 3.303, 5.19)):
        omega = 2 * np.pi * rig.frequency * factor * rng.uniform(0.9, 1.1)
        size, phase = rig.stroke / (1 + k) ** 1.5, rng.uniform(0, 2 * np.pi)
        total += size * np.array([
            np.sin(omega * time + phase), omega * np.cos(omega * time + phase),
            -(omega**2) * np.sin(omega * time + phase)])
    return Motion(time=time, position=total[0], speed=total[1], acceleration=total[2])


def rms(values: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def make(
    rig: Rig, seed: int, effects: dict[str, float] | None = None, coloured: bool = False
) -> RigRecord:
    """Return a record of a rig with effects.

    Parameters
    ----------
    rig : Rig
        What it is.
    seed : int
        Of the motion and the noise.
    effects : dict of float
        By name in `EFFECTS`: size in units of the rms input without effects.
    coloured : bool
        Whether the noise of the input is of first order, 0.05 s, in place of white.

    """
    rng = np.random.default_rng([seed, sum(map(ord, rig.name))])
    motion = motion_of(rig, rng)
    plain = rig.inertia * motion.acceleration + rig.viscous * motion.speed
    size = rms(plain)
    total = plain.copy()
    for name, share in (effects or {}).items():
        total += share * size * EFFECTS[name](rig, motion, plain, size)
    noise = rng.standard_normal(len(total))
    if coloured:
        pole = np.exp(-1.0 / (0.05 * rig.rate))
        for k in range(1, len(noise)):
            noise[k] = pole * noise[k - 1] + np.sqrt(1 - pole**2) * noise[k]
    axis = Axis(name=rig.name, motion=rig.motion, input=rig.input)  # type: ignore[arg-type]
    values = {
        "time": motion.time,
        axis.input_channel.name: total + rig.input_noise * size * noise,
        "position": motion.position
        + rig.position_noise * rig.stroke * rng.standard_normal(len(total)),
        "speed": motion.speed
        + rig.speed_noise * rms(motion.speed) * rng.standard_normal(len(total)),
    }
    kept = ("time", axis.input_channel.name, *rig.outputs)
    channels = tuple(c for c in axis.channels if c.name in kept)
    return RigRecord(samples=np.column_stack([values[c.name] for c in channels]),
                     channels=channels, axis=axis, source=f"{rig.name}-{seed}")


DELAYED = 0.3
"""Share of the input that a delay changes, about; a delay has no other size."""
Effect = Callable[[Rig, Motion, np.ndarray, float], np.ndarray]


def _order(rig: Rig) -> float:
    """Return the wave number of a ripple: 7 or 24 a turn, or 40 mm (rad a unit of position)."""
    if rig.motion == "linear":
        return 2 * np.pi / (rig.stroke / 4.0)
    return 7.0 if rig.stroke > 5.0 else 24.0


def _play(rig: Rig, motion: Motion) -> np.ndarray:
    width, state = 0.02 * rig.stroke, np.zeros_like(motion.position)
    for k in range(1, len(state)):
        way = state[k - 1] + motion.position[k] - motion.position[k - 1]
        state[k] = min(width, max(-width, way))
    return state / width


def _later(motion: Motion, plain: np.ndarray) -> np.ndarray:
    """Return what a delay changes, in units of `DELAYED`."""
    delay = DELAYED * rms(plain) / rms(np.gradient(plain, motion.time))
    return (np.interp(motion.time + delay, motion.time, plain) - plain) / (DELAYED * rms(plain))


EFFECTS: dict[str, Effect] = {
    "coulomb_friction": lambda _r, m, _p, _s: np.sign(m.speed),
    "offset": lambda _r, m, _p, _s: np.ones_like(m.time),
    "quadratic_drag": lambda _r, m, _p, _s: m.speed * np.abs(m.speed) / rms(m.speed**2),
    "cogging_torque": lambda r, m, _p, _s: np.cos(_order(r) * m.position - 0.7),
    "spring": lambda _r, m, _p, _s: m.position / rms(m.position),
    "asymmetric_friction": lambda _r, m, _p, _s: np.abs(m.speed) / rms(m.speed),
    "stribeck_friction": lambda _r, m, _p, _s: np.sign(m.speed) * (
        1.0 + np.exp(-((m.speed / (0.15 * rms(m.speed))) ** 2))),
    "presliding_hysteresis": lambda r, m, _p, _s: _play(r, m),
    "control_delay": lambda _r, m, p, _s: _later(m, p),
    "drive_lag": lambda _r, m, p, _s: np.gradient(p, m.time) / rms(np.gradient(p, m.time)),
    "periodic_disturbance": lambda r, m, _p, _s: np.sin(2 * np.pi * 9.37 * r.frequency * m.time),
    # Strangers: in no catalogue.
    "detent": lambda r, m, _p, _s: 2.0 * np.exp(
        -(((m.position - 0.3 * r.stroke) / (0.1 * r.stroke)) ** 2)),
    "friction_hump": lambda _r, m, _p, _s: np.sign(m.speed) * np.exp(
        -(((np.abs(m.speed) - rms(m.speed)) / (0.3 * rms(m.speed))) ** 2)),
    "friction_ripple": lambda r, m, _p, _s: np.sign(m.speed) * np.sin(
        2 * np.pi * m.position / (0.8 * r.stroke)),
}
"""Force or torque of unit size."""
STRANGERS = ("detent", "friction_hump", "friction_ripple")
NEEDS = {"stribeck_friction": {"coulomb_friction"}, "presliding_hysteresis": {"coulomb_friction"}}
"""What an effect of the panel consists of beside itself."""


def judged(name: str, found: Identification) -> str:
    """Return ``right``, ``wrong`` or ``missed`` for one effect."""
    sets = [{f.effect, *f.equivalent} for f in found.findings]
    if name in STRANGERS:
        if sets:
            return "wrong"
        return "right" if found.unknown is not None else "missed"
    needed = {name} | NEEDS.get(name, set())
    if any(not (named & needed) for named in sets):
        return "wrong"
    return "right" if any(name in named for named in sets) else "missed"
