"""Rules on motion by windows: speed, rotor angle and position tell the same travel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ema_record.channels import ROTOR_ANGLE, SURFACE_POSITION, median
from ema_record.checks.facts import CALIBRATE, SCALE, BagFacts, Hit, Rule

SPEED_SCALE = 0.01
"""`SCALE` for speed against rotor angle, which no gear and no gain stands between: in the mean,
and once a turn, where a good resolver (0.2 degrees) gives a third of it."""
SPEED_OFFSET = 0.01897
"""Difference between measured speed and the rotor angle's over a window (of the highest)."""
LEAST_TURNS = 4
"""Turns of the motor on end from which a line once a turn is told from a drift."""
TRAVELLED = 1.0 / 6.0
"""Motion from which travel is compared, of that from the middle to the end stop."""
TURNED = 0.19
"""The same within a window, of that at the highest speed."""


class Travel(NamedTuple):
    """What the motor turned in each window, as three channels tell it; NaN: not recorded."""

    time: np.ndarray
    """Begin of each window (s)."""
    speed: np.ndarray
    """Integrated motor speed (rad)."""
    angle: np.ndarray
    """Change of the rotor angle (rad)."""
    position: np.ndarray
    """Change of the surface position times the gear ratio (rad)."""
    gained: np.ndarray
    """Change of the measured speed (rad/s)."""


def travel(facts: BagFacts) -> Travel | None:
    """Return the motion by windows, None where there is too little.

    Without the rotor angle the speed stands for it; without both others there is nothing to
    compare.
    """
    motion, window, actuator = facts.motion, facts.window, facts.actuator
    n = len(motion.time) // window
    if n < 2 or not (facts.has(ROTOR_ANGLE) or facts.has(SURFACE_POSITION)):
        return None
    turned, angle, position = (
        x[:n * window].reshape(n, window).sum(axis=1)
        for x in (motion.turned, motion.angle if facts.has(ROTOR_ANGLE) else motion.turned,
                  motion.travel)
    )
    if np.abs(angle).sum() < TRAVELLED * actuator.surface.end_stop * actuator.gear.ratio:
        return None
    ends = motion.turned[window - 1:n * window:window] / facts.interval
    gained = np.diff(ends, prepend=motion.turned[0] / facts.interval)
    return Travel(motion.time[:n * window:window], turned, angle, position, gained)


def motion_scales(facts: BagFacts) -> Iterator[Hit]:
    """Find speed, angle or position scaled against the others."""
    found = facts.derived(travel)
    if found is None or facts.angle_in_degrees:
        return
    highest = facts.actuator.control.speed_limit * facts.window * facts.interval
    fast = np.abs(found.angle) > TURNED * highest
    if fast.sum() < 4:
        return
    speed = float(median((found.speed / found.angle)[fast]))
    # Lost motion changes few windows, a shaft that twists none of the whole way: neither both.
    position = min(
        float(median((found.position / found.angle)[fast])),
        float((found.position * np.sign(found.angle))[fast].sum()
              / np.abs(found.angle[fast]).sum()),
        key=lambda ratio: abs(ratio - 1.0),
    )
    ratios = {"motor_speed": (speed, SPEED_SCALE), "surface_position": (position, SCALE)}
    if abs(speed - 1.0) > SCALE and abs(position - speed) < 0.5 * SCALE * abs(speed):
        ratios = {"rotor_angle": (1.0 / speed, SPEED_SCALE)}
    both = facts.has(ROTOR_ANGLE, SURFACE_POSITION)
    others = "the other two say" if both else "the other one says"
    for name, (ratio, bound) in ratios.items():
        if 0.2 < abs(ratio) < 5.0 and abs(ratio - 1.0) > bound:
            clock = ", or the clock of the samples is wrong" if name == "motor_speed" else ""
            yield Hit(f"{name} is {ratio:.3f} times what {others} (gear ratio "
                      f"{facts.actuator.gear.ratio:g}){clock}", None, ratio, "", name)


def speed_offset(facts: BagFacts) -> Iterator[Hit]:
    """Find a speed that differs from that of the rotor angle in a part of the test.

    A speed that a filter of first order delays by τ turns less by τ times what it has gained, and
    is no worse for it: what is left of that, of a delay of at most a window, counts.
    """
    found = facts.derived(travel)
    if found is None or facts.angle_in_degrees:
        return
    if abs(found.speed @ found.angle / (found.angle @ found.angle) - 1.0) > SCALE:
        return  # told by the rule on scales
    window = facts.window * facts.interval
    behind, gained = found.angle - found.speed, found.gained
    late = np.clip(behind @ gained / max(gained @ gained, 1e-12), 0.0, window)
    off = np.abs(behind - late * gained) / window
    wrong = off > SPEED_OFFSET * facts.actuator.control.speed_limit
    if wrong.any():
        row = int(np.argmax(wrong))
        yield Hit(f"motor_speed and rotor_angle differ by {off.max():.3g} rad/s",
                  float(found.time[row]), float(off.max()), "rad/s", "motor_speed")


def speed_ripple(facts: BagFacts) -> Iterator[Hit]:
    """Find a speed that is off that of the rotor angle once a turn of the motor.

    Speed less ε times its cosine turns ε more or less once a turn. Beside it a scale, a filter,
    which turns less by its delay times the speed, and a drift.
    """
    motion = facts.motion
    if not facts.has(ROTOR_ANGLE) or facts.angle_in_degrees or not len(motion.time):
        return
    speed = motion.turned / facts.interval
    fast = np.abs(speed) > TURNED * facts.actuator.control.speed_limit
    edges = np.flatnonzero(np.diff(np.concatenate([[False], fast, [False]]).astype(np.int8)))
    begin, end = max(zip(edges[::2], edges[1::2]), key=lambda run: run[1] - run[0],
                     default=(0, 0))
    angle = np.cumsum(motion.angle[begin:end])
    if not len(angle) or np.ptp(angle) < LEAST_TURNS * 2.0 * np.pi:
        return
    time = np.linspace(-1.0, 1.0, len(angle))
    columns = np.stack([np.ones(len(angle)), time, time**2, angle, speed[begin:end],
                        np.cos(angle), np.sin(angle)])
    if not np.isfinite(columns).all():
        return
    columns /= np.linalg.norm(columns, axis=1)[:, None]
    behind = np.cumsum(motion.turned[begin:end]) - angle
    part = np.linalg.lstsq(columns.T, behind, rcond=None)[0][-2:]
    ripple = float(np.linalg.norm(part) * np.sqrt(2.0 / len(angle)))
    if ripple > SPEED_SCALE:
        yield Hit(f"motor_speed and rotor_angle differ by {100.0 * ripple:.2g} % of the speed "
                  "once a turn of the motor", float(motion.time[begin]), ripple, "", "motor_speed")


RULES = (
    Rule(name="sensor_scale", find=motion_scales, remedy=CALIBRATE),
    Rule(name="sensor_scale", find=speed_ripple, remedy=CALIBRATE),
    Rule(name="sensor_offset", find=speed_offset, remedy=CALIBRATE),
)
