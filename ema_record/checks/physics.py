"""Rules between channels: what belongs together by physics must agree in sign, unit, order."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from ema_record.channels import (
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    TIME,
    median,
)
from ema_record.checks.facts import SET_UNIT, BagFacts, Hit, Rule

RPM = 30.0 / np.pi
DEGREES = 180.0 / np.pi
NEAR = 0.1
"""Relative distance from a ratio at which it counts as that ratio."""
SAME_UNIT = 1.5
"""Ratio below which two channels have the same unit, whatever their scales."""
ANGLE_STEP = (0.506, 2.0)
"""Difference between turned motor angle and speed in one interval that no motor gives: of an
interval's way at the highest speed, and in steps of the angle's converter."""
TRAVEL_STEP = (0.005, 6.0)
"""The same between surface position and speed, of the way from the middle to the end stop."""
ENOUGH = 8000
"""Samples from which the phases of currents and references are compared."""
DRIVEN = 200
"""Samples from which phases are compared."""
BETTER = 0.3
"""Sum of the correlations by which other wires explain the currents better than the labels."""
LEAST_ASKED = 0.1
"""Share of the largest reference below which one tells nothing of the unit: the motor stood."""
ALIKE = 0.7
"""Correlation above which half of a current's power is its reference's."""
_PHASES = "abc"


class Ratios(NamedTuple):
    """Slopes of rotor angle and surface travel against the integrated speed, 1 where right.

    A channel that was not recorded counts as right, one that is alone against the speed is told
    from it as if the other one agreed with the speed.
    """

    angle: float
    travel: float


def ratios(facts: BagFacts) -> Ratios | None:
    """Return the slopes, or None where the motor hardly moved."""
    motion = facts.motion
    moving = np.abs(motion.turned) > facts.standing * facts.interval
    turned = motion.turned[moving]
    if len(turned) < 100:
        return None
    angle, travel = (
        float((turned @ moved[moving]) / (turned @ turned)) if facts.has(column) else 1.0
        for column, moved in ((ROTOR_ANGLE, motion.angle), (SURFACE_POSITION, motion.travel))
    )
    return Ratios(angle=angle, travel=travel)


def _is(value: float, ratio: float) -> bool:
    return abs(value - ratio) < NEAR * abs(ratio)


def motion_units(facts: BagFacts) -> Iterator[Hit]:
    """Find speed, angle or position in another unit."""
    if facts.angle_in_degrees:
        yield Hit("rotor_angle goes beyond a turn in rad: it is in degrees",
                  None, DEGREES, "", "rotor_angle")
    found = facts.derived(ratios)
    if facts.too_fast and not (facts.has(ROTOR_ANGLE) or facts.has(SURFACE_POSITION)):
        peak = float(np.abs(facts.samples[:, MOTOR_SPEED]).max())
        yield Hit(f"motor_speed goes to {peak:.4g}, the motor to "
                  f"{facts.actuator.control.speed_limit:.4g} rad/s: it is in another unit",
                  None, peak, "", "motor_speed")
    if found is None:
        return
    angle, travel = abs(found.angle), abs(found.travel)
    if max(angle, travel, 1.0) < SAME_UNIT * min(angle, travel, 1.0) or not (
        1e-9 < min(angle, travel) <= max(angle, travel) < 1e9
    ):
        return
    if _is(angle, 1.0):
        unit = "degrees" if _is(travel, DEGREES) else f"a unit {travel:.4g} times too small"
        yield Hit(f"surface_position is in {unit}, not in rad", None, travel, "",
                  "surface_position")
    elif _is(angle, 1.0 / RPM) and _is(travel, 1.0 / RPM):
        yield Hit("motor_speed is in rpm, not in rad/s", None, RPM, "", "motor_speed")
    elif _is(travel / angle, 1.0):
        yield Hit(f"motor_speed is {1.0 / travel:.4g} times what angle and position say: its "
                  "unit or the rate of the samples is wrong", None, 1.0 / travel, "",
                  "motor_speed")
    elif _is(travel, 1.0):
        yield Hit(f"rotor_angle turns {angle:.4g} times as fast as the motor", None, angle, "",
                  "rotor_angle")


def motion_signs(facts: BagFacts) -> Iterator[Hit]:
    """Find speed, angle or position of the opposite sign."""
    found = facts.derived(ratios)
    if found is None or min(abs(found.angle), abs(found.travel)) < 1e-3:
        return
    against = (found.angle < 0.0, found.travel < 0.0)
    name = {(True, True): "motor_speed", (True, False): "rotor_angle",
            (False, True): "surface_position"}.get(against)
    if name is not None:
        yield Hit(f"{name} has the opposite sign of the other two", None, -1.0, "", name)


def discontinuities(facts: BagFacts) -> Iterator[Hit]:
    """Find samples that do not continue the one before though time does."""
    found = facts.derived(ratios)
    if found is None:
        return
    motion, actuator = facts.motion, facts.actuator
    c, gear = actuator.converters, actuator.gear.ratio
    highest = actuator.control.speed_limit * facts.interval
    angle = max(ANGLE_STEP[0] * highest,
                ANGLE_STEP[1] * actuator.motor_angle(c.angle_range / 2**c.angle_bits))
    travel = gear * max(TRAVEL_STEP[0] * actuator.surface.end_stop,
                        TRAVEL_STEP[1] * c.position_range / 2**c.position_bits)
    for column, name, step, ratio, bound in (
        (ROTOR_ANGLE, "rotor_angle", motion.angle, found.angle, angle),
        (SURFACE_POSITION, "surface_position", motion.travel, found.travel, travel),
    ):
        if not (facts.has(column) and _is(ratio, 1.0)):
            continue
        off = np.abs(step - motion.turned)
        if name == "rotor_angle":
            off = np.minimum(off, actuator.motor_angle(2.0 * np.pi) - off)
        broken = off > bound
        if broken.any():
            row = int(np.argmax(broken))
            yield Hit(
                f"{name} jumps at {motion.time[row]:.4f} s and time does not: "
                f"{int(broken.sum())} places where samples were lost or mixed",
                float(motion.time[row]), float(off[row]), "rad of the motor", name,
            )


def _driven(facts: BagFacts) -> np.ndarray:
    """Return where samples under current are, enough of them for correlations, shape (n,)."""
    rows = np.arange(0, len(facts.samples), max(1, len(facts.samples) // ENOUGH))
    size = np.abs(facts.vector(_asked(facts)))[rows]
    if not len(rows) or not size.max() > 0.0:
        return rows[:0]
    return rows[size > 0.05 * median(size)]


def _asked(facts: BagFacts) -> slice:
    """Return the currents that say what is asked: the references, else the phase currents."""
    return REFERENCE_CURRENTS if facts.has_references else PHASE_CURRENTS


class Wiring(NamedTuple):
    """Which reference each phase current follows, with its sign, and how well."""

    order: tuple[int, ...]
    signs: tuple[int, ...]
    better: float
    """By how much it explains the currents better than the labels do (of their number)."""
    gain: np.ndarray
    """Phase currents against the references that they follow, shape (n,)."""
    phases: tuple[int, ...]
    """Which phase currents there are: two or all three of 0, 1, 2."""
    alike: np.ndarray
    """Correlation of each with that reference, shape (n,): a unit leaves it, a dead sensor 0."""


def wiring(facts: BagFacts) -> Wiring | None:
    """Return how the phase currents go with the reference currents; None without these."""
    rows = facts.derived(_driven)
    if len(rows) < DRIVEN or not facts.has_references:
        return None
    phases = tuple(column - PHASE_CURRENTS.start for column in facts.currents)
    n = len(phases)
    currents = facts.samples[rows][:, facts.currents]
    references = facts.samples[rows, REFERENCE_CURRENTS]
    power = np.sqrt((currents**2).mean(axis=0)[:, None] * (references**2).mean(axis=0)[None, :])
    product_mean = currents.T @ references / len(rows)
    c = np.divide(product_mean, power, out=np.zeros((n, 3)), where=power > 0.0)
    best = max(
        ((sum(sign * c[k, p] for k, (p, sign) in enumerate(zip(order, signs))), order, signs)
         for order in permutations(range(3), n) for signs in product((1, -1), repeat=n)),
        key=lambda item: item[0],
    )
    score, order, signs = best
    labelled = sum(c[k, p] for k, p in enumerate(phases))
    if score - labelled <= BETTER:  # currents that stand, of a rotor that does, fit in any order
        score, order, signs = labelled, phases, (1,) * n
    squares = (references**2).mean(axis=0)
    gain = np.array([
        product_mean[k, p] / squares[p] if squares[p] > LEAST_ASKED**2 * squares.max() else 1.0
        for k, p in enumerate(order)
    ])
    alike = np.array([abs(c[k, p]) for k, p in enumerate(order)])
    return Wiring(order, signs, float(score - labelled), gain, phases, alike)


def swapped(facts: BagFacts) -> Iterator[Hit]:
    """Find phase currents that follow the reference of another phase."""
    found = facts.derived(wiring)
    if found is not None and found.order != found.phases:
        pairs = ", ".join(
            f"phase_current_{_PHASES[k]} follows reference {_PHASES[p]}"
            for k, p in zip(found.phases, found.order) if k != p
        )
        yield Hit(f"swapped phases: {pairs}", None, found.better, "", "phase_current")
        return
    yield from _sequence(facts)


def _sequence(facts: BagFacts) -> Iterator[Hit]:
    """Find reference currents, else phase currents, whose phases run against the rotor."""
    rows = facts.derived(_driven)
    rows = rows[np.abs(facts.samples[rows, MOTOR_SPEED]) > facts.standing]
    if len(rows) < DRIVEN or facts.angle_in_degrees:
        return
    if not facts.has(ROTOR_ANGLE):
        yield from _rotation(facts)
        return
    vector = facts.vector(_asked(facts))[rows]
    rotor = np.exp(-1j * facts.samples[rows, ROTOR_ANGLE])
    forward, backward = vector * rotor, vector.conj() * rotor
    ahead, back = (abs((z**2).mean()) / (np.abs(z) ** 2).mean() for z in (forward, backward))
    if ahead < 0.3 and back > 0.6:
        yield Hit("swapped phases: the currents run against the rotor angle", None, float(back),
                  "", "phase_current")


def _rotation(facts: BagFacts) -> Iterator[Hit]:
    """Find currents that rotate against the motor's speed, where no angle was recorded."""
    speed = facts.samples[:, MOTOR_SPEED]
    usual = float(median(np.abs(speed[np.abs(speed) > facts.standing])))
    turn = facts.actuator.motor.pole_pairs * usual * facts.interval
    lag = max(1, round(np.pi / 3.0 / turn))  # a sixth of an electrical turn
    vector = facts.vector(_asked(facts))
    steady = (np.abs(np.abs(speed) - usual) < 0.3 * usual)[:-lag]
    if steady.sum() < DRIVEN:
        return
    ahead = np.sign(speed[:-lag]) * (vector[:-lag].conj() * vector[lag:]).imag
    share = float(ahead[steady].sum() / (np.abs(vector[:-lag]) ** 2)[steady].sum())
    if share < -0.3:
        yield Hit("swapped phases: the currents rotate against the motor's speed (two are "
                  "swapped, or one has the opposite sign)", None, share, "", "phase_current")


def current_signs(facts: BagFacts) -> Iterator[Hit]:
    """Find phase currents of the opposite sign."""
    found = facts.derived(wiring)
    if found is not None:
        for k, sign in zip(found.phases, found.signs):
            if sign < 0:
                name = f"phase_current_{_PHASES[k]}"
                yield Hit(f"{name} has the opposite sign of its reference", None, -1.0, "", name)


def current_units(facts: BagFacts) -> Iterator[Hit]:
    """Find phase currents in another unit than their references."""
    found = facts.derived(wiring)
    if found is None:
        return
    for k, gain, alike in zip(found.phases, np.abs(found.gain), found.alike):
        if (gain > 5.0 or 1e-6 < gain < 0.02) and alike > ALIKE:
            name = f"phase_current_{_PHASES[k]}"
            unit = "mA" if 0.5 < 1e-3 * gain < 2.0 else "another unit"
            yield Hit(f"{name} is {gain:.4g} times its reference: it is in {unit}",
                      float(facts.samples[0, TIME]), float(gain), "", name)


def dead_currents(facts: BagFacts) -> Iterator[Hit]:
    """Find phase currents of which nothing but noise is left while current is asked for."""
    found = facts.derived(wiring)
    if found is None:
        return
    for k, gain, alike in zip(found.phases, np.abs(found.gain), found.alike):
        moves = np.ptp(facts.samples[:, PHASE_CURRENTS.start + k]) > 0.0  # else it is stuck
        if moves and gain < 0.02 and alike <= ALIKE:
            name = f"phase_current_{_PHASES[k]}"
            yield Hit(f"{name} does not follow its reference: only noise is left of it",
                      float(facts.samples[0, TIME]), float(gain), "", name)


_SIGN = "correct the sign of the channel in the acquisition and record the test again"
RULES = (
    Rule(name="wrong_unit", find=motion_units, remedy=SET_UNIT),
    Rule(name="wrong_unit", find=current_units, remedy=SET_UNIT),
    Rule(name="stuck_channel", find=dead_currents,
         remedy="check the transducer, its plug and its wires, then record the test again"),
    Rule(name="sign_flip", find=motion_signs, remedy=_SIGN),
    Rule(name="sign_flip", find=current_signs, remedy=_SIGN),
    Rule(name="swapped_phases", find=swapped,
         remedy="correct the wiring or the labels of the phases and record the test again"),
    Rule(name="discontinuity", find=discontinuities,
         remedy="samples were lost before their time stamp, or two tests mixed: record again"),
)
