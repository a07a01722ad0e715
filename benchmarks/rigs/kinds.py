"""Records of the synthetic panel: ten ways in which people move and record an axis.

Each is made from a motion in closed form and the input that it needs; noise and sensors come
after. Half have nothing beyond Coulomb friction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ema_rig.record import Axis, RigRecord
from support.rigs import EFFECTS, RIGS, Effect, Motion, Rig, motion_of, rms

Made = Callable[[Rig, np.random.Generator], Motion]


def _of_speed(rig: Rig, speed: np.ndarray) -> Motion:
    """Return the motion of a speed that is given, by the rule of Simpson's little brother."""
    step = 1.0 / rig.rate
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * step)])
    return Motion(time=np.arange(len(speed)) * step, position=position - position.mean(),
                  speed=speed, acceleration=np.gradient(speed, step))


def commensurate(rig: Rig, rng: np.random.Generator) -> Motion:
    """Return two sines whose frequencies are whole tenths of each other's tenth."""
    pairs = ((7, 17), (6, 22), (5, 15), (4, 10), (10, 25))
    first, second = pairs[int(rng.integers(len(pairs)))]
    time = np.arange(int(rig.duration * rig.rate)) / rig.rate
    total = np.zeros((3, len(time)))
    for number, size in ((first, 1.0), (second, 0.35 * first / second + 0.1)):
        w, phase = 2 * np.pi * rig.frequency * number / first, rng.uniform(0, 2 * np.pi)
        total += rig.stroke * size * np.array([
            np.sin(w * time + phase), w * np.cos(w * time + phase),
            -(w**2) * np.sin(w * time + phase)])
    return Motion(time=time, position=total[0], speed=total[1], acceleration=total[2])


def dwells(rig: Rig, rng: np.random.Generator) -> Motion:
    """Return moves of half a quarter of the period with rests as long, of random size."""
    length = int(0.2 / rig.frequency * rig.rate)
    s = (np.arange(length) + 0.5) / length
    bell = s**3 * (1 - s) ** 3
    places, speed = 0.0, []
    while sum(len(part) for part in speed) < rig.duration * rig.rate:
        target = rig.stroke * rng.uniform(-1.0, 1.0)
        speed += [(target - places) * bell / (bell.sum() / rig.rate), np.zeros(length)]
        places = target
    return _of_speed(rig, np.concatenate(speed)[:int(rig.duration * rig.rate)])


def trapezoids(rig: Rig, rng: np.random.Generator) -> Motion:
    """Return constant speeds of five sizes in both directions, with ramps between."""
    top = rig.stroke * 2 * np.pi * rig.frequency
    count = int(rig.duration * rig.rate)
    hold, ramp = int(0.25 / rig.frequency * rig.rate), int(0.06 / rig.frequency * rig.rate)
    speeds = [top * share * way for _ in range(20) for share in rng.permutation(
        [0.1, 0.3, 0.5, 0.7, 1.0]) for way in (1, -1)]
    x = np.arange(len(speeds)) * (hold + ramp)
    corners = np.column_stack([x, x + hold]).ravel()
    return _of_speed(rig, np.interp(np.arange(count), corners, np.repeat(speeds, 2)))


def one_way(rig: Rig, rng: np.random.Generator) -> Motion:
    """Return speeds that change and never reverse."""
    sines = motion_of(rig, rng)
    top = rms(sines.speed)
    return _of_speed(rig, 1.6 * top + 0.45 * sines.speed * top / np.abs(sines.speed).max() * 2.0)


def several(rig: Rig, rng: np.random.Generator) -> Motion:
    """Return four runs from the same place, with a pause in the record between."""
    runs = [motion_of(replace(rig, duration=0.25 * rig.duration), rng) for _ in range(4)]
    time = np.concatenate([run.time + k * (0.25 * rig.duration + 2.0)
                           for k, run in enumerate(runs)])
    return Motion(time=time, position=np.concatenate([r.position - r.position[0] for r in runs]),
                  speed=np.concatenate([r.speed for r in runs]),
                  acceleration=np.concatenate([r.acceleration for r in runs]))


MOTIONS: dict[str, Made] = {
    "incommensurate sines": motion_of, "commensurate sines": commensurate, "dwells": dwells,
    "trapezoids": trapezoids, "quantised encoder": motion_of, "one way": one_way,
    "several runs": several, "held speed": motion_of,
}
"""Kinds of records that can be used."""
DISTURBED = 9.37
"""Frequency of a wave in time, over that of the motion (`support.rigs`)."""
COUNTS = (2000, 4096, 8192)
"""Of an encoder, a turn; of a linear axis, in the stroke."""


def _in_gap(rig: Rig, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Return where the drive stands in a gap crossed after each reversal, and when it crosses."""
    width, state = 0.03 * rig.stroke, np.zeros_like(motion.position)
    for k in range(1, len(state)):
        way = state[k - 1] + motion.position[k] - motion.position[k - 1]
        state[k] = min(width, max(-width, way))
    return state, np.abs(state) < width * (1 - 1e-9)


def _stops(rig: Rig, motion: Motion) -> np.ndarray:
    place = 0.55 * np.abs(motion.position).max()
    way = motion.position - np.clip(motion.position, -place, place)
    return way / max(rms(way), 1e-9 * rig.stroke)


def _let_go(rig: Rig, motion: Motion, _plain: np.ndarray, size: float) -> np.ndarray:
    """Return what crossing a gap takes away: half of the inertia, and the load's friction.

    The load rests in the gap and gets its momentum back in one blow at the far side.
    """
    (state, crossing), step = _in_gap(rig, motion), motion.time[1] - motion.time[0]
    behind = np.gradient(np.gradient(state, step), step)
    return np.sign(motion.speed) * ~crossing - 0.5 * rig.inertia * behind / (0.4 * size)


MORE: dict[str, Effect] = {
    "hardening_spring": lambda _r, m, _p, _s: m.position**3 / rms(m.position**3),
    "end_stops": lambda r, m, _p, _s: _stops(r, m),
    "gravity": lambda _r, m, _p, _s: math.sqrt(2.0) * np.cos(m.position - 0.4),
    "backlash": _let_go,
}
NAMED = ("cogging_torque", "spring", "quadratic_drag", "offset", "asymmetric_friction",
         "stribeck_friction", "presliding_hysteresis", "control_delay", "periodic_disturbance",
         *MORE)
WITH_FRICTION = {"stribeck_friction", "presliding_hysteresis", "backlash"}
"""Effects that bring Coulomb friction of their own."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One record and what is true of it."""

    kind: str
    record: RigRecord
    truth: frozenset[str]
    """Names beyond inertia and viscous friction."""
    effect: str
    """What is beyond Coulomb friction, ``""`` for nothing."""
    base: dict[str, float]
    """Inertia and viscous friction."""


def case_of(number: int, seed: int) -> Case:
    """Return the record of a number; odd ones have nothing beyond Coulomb friction."""
    rng = np.random.default_rng([seed, number])
    kind = list(MOTIONS)[(number // 2) % len(MOTIONS)]
    rig = RIGS[list(RIGS)[int(rng.integers(len(RIGS)))]]
    if kind == "quantised encoder":
        rig = replace(rig, outputs=("position",))
    if kind == "held speed":
        rig = replace(rig, outputs=("position", "speed"))
    motion = MOTIONS[kind](rig, rng)
    effect = "" if number % 2 else _effect(kind, rig, motion, rng)
    plain = rig.inertia * motion.acceleration + rig.viscous * motion.speed
    size = rms(plain)
    total, truth = plain.copy(), set()
    if effect in WITH_FRICTION or rng.random() < 0.6:
        truth.add("coulomb_friction")
    if "coulomb_friction" in truth and effect not in WITH_FRICTION:
        total += rng.uniform(0.15, 0.5) * size * np.sign(motion.speed)
    if effect:
        truth.add(effect)
    if effect == "control_delay":
        motion, total = delayed(motion, total, rng.uniform(0.3, 0.5) * size / rms(
            np.gradient(plain, motion.time)))
    elif effect:
        total += rng.uniform(0.3, 0.5) * size * {**EFFECTS, **MORE}[effect](
            rig, motion, plain, size)
    return Case(kind=kind, truth=frozenset(truth), effect=effect,
                record=_recorded(rig, motion, total, size, kind, rng, f"{kind}-{number}"),
                base={"inertia.value": rig.inertia, "viscous_friction.value": rig.viscous})


def _motion_ends(motion: Motion) -> float:
    """Return the frequency below which 99 % of the power of the speed lies (Hz)."""
    power = np.cumsum(np.abs(np.fft.rfft(motion.speed * np.hanning(len(motion.speed)))) ** 2)
    return float(np.searchsorted(power, 0.99 * power[-1])
                 / (len(motion.speed) * (motion.time[1] - motion.time[0])))


def delayed(motion: Motion, total: np.ndarray, delay: float) -> tuple[Motion, np.ndarray]:
    """Return the motion and the whole input, friction too, given so much (s) before it acts.

    The last samples of each run, whose input came after its end, are left out.
    """
    step = motion.time[1] - motion.time[0]
    ends = np.append(np.nonzero(np.diff(motion.time) > 10.0 * step)[0], len(motion.time) - 1)
    end = motion.time[ends[np.searchsorted(ends, np.arange(len(motion.time)))]]
    kept = motion.time + delay <= end + 1e-6 * step
    return (Motion(time=motion.time[kept], position=motion.position[kept],
                   speed=motion.speed[kept], acceleration=motion.acceleration[kept]),
            np.interp(motion.time + delay, motion.time, total)[kept])


def _effect(kind: str, rig: Rig, motion: Motion, rng: np.random.Generator) -> str:
    """Return an effect that this record can show."""
    turns = float(np.ptp(motion.position)) / (2 * np.pi)
    names = set(NAMED) - ({"gravity"} if rig.motion == "linear" or not 0.25 < turns < 1.4
                          else set())
    if kind == "one way":  # no reversal, and Coulomb friction is an offset
        names &= {"cogging_torque", "quadratic_drag", "control_delay", "periodic_disturbance"}
    if kind == "several runs":  # one clock is needed
        names -= {"periodic_disturbance"}
    if kind == "commensurate sines":  # a motion that repeats itself: of its cycle, maybe
        names -= {"periodic_disturbance"}
    if _motion_ends(motion) > 0.8 * DISTURBED * rig.frequency:  # it may as well be of the motion
        names -= {"periodic_disturbance"}
    if kind == "dwells":
        names -= {"backlash", "presliding_hysteresis", "stribeck_friction"}
    return sorted(names)[int(rng.integers(len(names)))]


def _recorded(
    rig: Rig, motion: Motion, total: np.ndarray, size: float, kind: str,
    rng: np.random.Generator, name: str,
) -> RigRecord:
    """Return the record of a motion and the input that it needs, with noise and sensors."""
    axis = Axis(name=rig.name, motion=rig.motion, input=rig.input)  # type: ignore[arg-type]
    position = motion.position + rig.position_noise * rig.stroke * rng.standard_normal(len(total))
    if kind == "quantised encoder":
        counts = COUNTS[int(rng.integers(len(COUNTS)))]
        step = (2 * np.pi if rig.motion == "rotary" else rig.stroke) / counts
        if rig.motion == "rotary" and rig.stroke < 2.0:
            step /= 20.0  # behind a gear
        position = step * np.round(motion.position / step)
    speed = motion.speed + rig.speed_noise * rms(motion.speed) * rng.standard_normal(len(total))
    if kind == "held speed":
        speed = speed[np.arange(len(speed)) // 4 * 4]
    values = {"time": motion.time, axis.input_channel.name:
              total + rig.input_noise * size * rng.standard_normal(len(total)),
              "position": position, "speed": speed}
    kept = ("time", axis.input_channel.name, *rig.outputs)
    channels = tuple(c for c in axis.channels if c.name in kept)
    return RigRecord(samples=np.column_stack([values[c.name] for c in channels]),
                     channels=channels, axis=axis, source=name)
