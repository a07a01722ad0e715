"""Rules on the transducers: gain, offset, noise and held values that physics gives away.

The true currents of a star sum to zero, the reference is what the drive makes them, angle and
position are integrals of the speed. None of that depends on the actuator's health, so a broken
sensor is told from a broken actuator. Bounds lie two times and more beyond what a good sensor
may do: gain +-1 %, the offset of a good transducer, twice the nominal noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ema_record.actuator import NOISE_RATE, Actuator
from ema_record.channels import (
    CHANNELS,
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    TIME,
)
from ema_record.checks.facts import SETTLED, BagFacts, Hit, Rule

GAIN_SPREAD = 0.04
"""Between the relative gains of the three current sensors."""
SCALE = 0.05
"""Relative distance of a channel from what it is compared with."""
SPEED_SCALE = 0.01
"""The same for speed against rotor angle, which no gear and no gain stands between."""
REST_OFFSET = 1.0 / 128.0
"""Reading of a current while the inverter is off (of the span of its converter)."""
SUM_OFFSET = 0.0046875
"""Mean of the weighted sum of the currents over a part of the test (of that span)."""
NOISY = 10.0
"""Times the nominal noise that is too much; of the sum of three currents, six times."""
ROUGH = 14.0
"""The same of the position, whose noise is that of its converter."""
ANGLE_NOISE = 2e-3
"""White noise of the commutation sensor that is too much (rad rms)."""
HELD = 0.05
"""Share of the samples of a driven phase current that repeat the one before."""
SPEED_OFFSET = 0.01897
"""Difference between measured speed and the rotor angle's over `WINDOW` (of the highest)."""
WINDOW = 400
"""Samples over which noise and travel are taken (20 ms)."""
PARTS = 16
"""Of the test, for its offsets."""
SEPARATED = 200.0
"""Ratio of the two smallest variances from which the weights of the sum are known."""
SLOW = 0.3795
"""Share of the motor's highest speed below which the drive has voltage to spare."""
UNLIMITED = (0.1364, 0.9091)
"""Reference currents that are neither noise nor the limit (of the limit)."""
STEADY = 20
"""Samples for which a reference is constant before its current is compared."""
TRAVELLED = 50.0
"""Motor angle from which travel is compared (rad)."""
TURNED = 3.0
"""The same within `WINDOW` (rad)."""
_PHASES = "abc"


class CurrentSum(NamedTuple):
    """The weighted sum of the phase currents, which is zero but for the sensors.

    Attributes
    ----------
    rest : ndarray, shape (3,) (A). Readings while the inverter is off, 0 where it never is.
    gain : ndarray, shape (3,). Relative gains, 1 in the mean; ones where they cannot be told.
    known : whether they can.
    start : index of the first sample after `SETTLED`.
    residual : ndarray, shape (m,) (A). The sum from there on.
    """

    rest: np.ndarray
    gain: np.ndarray
    known: bool
    start: int
    residual: np.ndarray


def current_sum(facts: BagFacts) -> CurrentSum | None:
    """Return the weighted sum of the currents, or None where the record is too short.

    The weights are the direction along which the currents vary least within each part of the
    test, so that an offset that appears does not turn them.
    """
    s = facts.samples
    off = facts.profile.inverter_off if facts.profile else 0.0
    start = int(np.searchsorted(s[:, TIME], off + SETTLED))
    currents = s[:, PHASE_CURRENTS]
    resting = currents[s[:, TIME] < off - 1e-3]
    rest = resting.mean(axis=0) if len(resting) >= WINDOW // 4 else np.zeros(3)
    driven = currents[start:] - rest
    if len(driven) < 2 * WINDOW:
        return None
    scatter = np.zeros((3, 3))
    for part in np.array_split(driven, PARTS):
        centred = part - part.mean(axis=0)
        scatter += centred.T @ centred
    variances, vectors = np.linalg.eigh(scatter)
    weights = np.abs(vectors[:, 0])
    known = variances[1] > SEPARATED * variances[0] and weights.min() > 0.2
    gain = weights.mean() / weights if known else np.ones(3)
    return CurrentSum(rest, gain / gain.mean(), known, start, driven @ (1.0 / gain))


def current_gains(facts: BagFacts) -> Iterator[Hit]:
    """Find a current sensor of another gain than the other two, or all against the reference."""
    found = facts.derived(current_sum)
    if found is not None and found.known and np.ptp(found.gain) > GAIN_SPREAD:
        error = found.gain / np.median(found.gain) - 1.0
        k = int(np.argmax(np.abs(error)))
        name = f"phase_current_{_PHASES[k]}"
        yield Hit(f"{name} reads {100 * error[k]:+.1f} % against the other two, which with it sum "
                  "to zero", None, float(error[k]), "", name)
        return
    ratio = _by_reference(facts)
    if ratio is not None and abs(ratio - 1.0) > SCALE:
        yield Hit(f"the phase currents are {ratio:.3f} times their references at low speed",
                  None, ratio, "", "phase_current")


def _by_reference(facts: BagFacts) -> float | None:
    """Return the phase currents against steady references, the median phase."""
    s = facts.samples
    slow = np.abs(s[:, MOTOR_SPEED]) < SLOW * facts.actuator.control.speed_limit
    least, most = (share * facts.actuator.inverter.current_limit for share in UNLIMITED)
    ratios = []
    for k in range(3):
        reference = s[slow, REFERENCE_CURRENTS.start + k]
        if len(reference) <= STEADY:
            return None
        now, before = reference[STEADY:], reference[:-STEADY]
        size = np.abs(now)
        use = (np.abs(now - before) < 0.1 * size) & (size > least) & (size < most)
        use &= np.abs(now - reference[STEADY // 2:-STEADY // 2]) < 0.1 * size
        if use.sum() < WINDOW:
            continue
        measured = s[slow, PHASE_CURRENTS.start + k][STEADY:]
        ratios.append(float((measured * np.sign(now))[use].sum() / size[use].sum()))
    return float(np.median(ratios)) if ratios else None


def current_offsets(facts: BagFacts) -> Iterator[Hit]:
    """Find current sensors with an offset, at rest or from some moment on."""
    found = facts.derived(current_sum)
    if found is None:
        return
    span = facts.actuator.converters.current_range
    k = int(np.argmax(np.abs(found.rest)))
    if abs(found.rest[k]) > REST_OFFSET * span:
        name = f"phase_current_{_PHASES[k]}"
        yield Hit(f"{name} reads {found.rest[k]:+.2f} A while the inverter is off",
                  0.0, float(found.rest[k]), "A", name)
    if not found.known:
        return
    means = np.array([part.mean() for part in np.array_split(found.residual, PARTS)])
    wrong = np.abs(means) > SUM_OFFSET * span
    if wrong.any():
        part = int(np.argmax(wrong))
        row = found.start + part * len(found.residual) // PARTS
        worst = float(means[np.argmax(np.abs(means))])
        yield Hit(
            f"the phase currents sum to {worst:+.2f} A, not to zero, from "
            f"{facts.samples[row, TIME]:.3f} s on: the offset of a current sensor changes",
            float(facts.samples[row, TIME]), worst, "A", "phase_current",
        )


def noise_bounds(actuator: Actuator) -> dict[int, float]:
    """Return the white noise within `WINDOW` that is too much, rms, by column; 2: any current."""
    noise, c = actuator.noise, actuator.converters

    def least(nominal: float, span: float, bits: int) -> float:
        return max(nominal, span / 2**bits / np.sqrt(12.0))  # a converter is white noise too

    return {
        PHASE_CURRENTS.start: NOISY * least(noise.current, c.current_range, c.current_bits),
        MOTOR_SPEED: NOISY * least(noise.speed, c.speed_range, c.speed_bits),
        SURFACE_POSITION: ROUGH * least(noise.position, c.position_range, c.position_bits),
        ROTOR_ANGLE: ANGLE_NOISE,
    }


def noises(facts: BagFacts) -> Iterator[Hit]:
    """Find channels with much more noise than a good sensor has."""
    s = facts.samples
    currents = s[:, PHASE_CURRENTS]
    wider = np.sqrt(max(1.0, 1.0 / (facts.interval * NOISE_RATE)))  # the band of the noise
    bounds = {column: wider * b for column, b in noise_bounds(facts.actuator).items()}
    bound = bounds.pop(PHASE_CURRENTS.start)
    noise, part = _noise(currents.sum(axis=1), bound)
    if noise > bound:
        rough = np.diff(currents, 2, axis=0).std(axis=0)
        name = f"phase_current_{_PHASES[int(np.argmax(rough))]}"
        yield Hit(f"noise of the sum of the phase currents is {noise:.2f} A rms, {name} has most",
                  float(s[part * WINDOW, TIME]), noise, "A", name)
    for column, bound in bounds.items():
        values = np.unwrap(s[:, column]) if column == ROTOR_ANGLE else s[:, column]
        noise, part = _noise(values, bound)
        if noise > bound:
            name, unit = CHANNELS[column]
            yield Hit(f"noise of {name} is {noise:.3g} {unit} rms",
                      float(s[part * WINDOW, TIME]), noise, unit, name)


def _noise(values: np.ndarray, bound: float) -> tuple[float, int]:
    """Return the largest white noise (rms) of all windows, and the first beyond `bound`."""
    rough = np.abs(np.diff(values, 2))
    n = len(rough) // WINDOW
    if n == 0:
        return 0.0, 0
    # Of white noise of deviation 1: median 0.6745, and the second difference has sqrt(6).
    noise = np.median(rough[:n * WINDOW].reshape(n, WINDOW), axis=1) / (0.6745 * np.sqrt(6.0))
    return float(noise.max()), int(np.argmax(noise > bound))


def held(facts: BagFacts) -> Iterator[Hit]:
    """Find phase currents that often repeat the sample before: samples were not taken."""
    s = facts.samples
    off = facts.profile.inverter_off + SETTLED if facts.profile else 0.0
    s = s[int(np.searchsorted(s[:, TIME], off)):]
    driven = (s[1:, REFERENCE_CURRENTS] != 0.0).any(axis=1)
    if driven.sum() < WINDOW:
        return
    for k, column in enumerate(range(PHASE_CURRENTS.start, PHASE_CURRENTS.stop)):
        same = (np.diff(s[:, column]) == 0.0) & driven
        share = float(same.sum() / driven.sum())
        if share > HELD:
            name = f"phase_current_{_PHASES[k]}"
            yield Hit(f"{100 * share:.0f} % of the samples of {name} repeat the one before",
                      float(s[1 + int(np.argmax(same)), TIME]), share, "", name)


class Travel(NamedTuple):
    """What the motor turned in each window of `WINDOW` samples, as three channels tell it."""

    time: np.ndarray
    """Begin of each window (s)."""
    speed: np.ndarray
    """Integrated motor speed (rad)."""
    angle: np.ndarray
    """Change of the rotor angle (rad)."""
    position: np.ndarray
    """Change of the surface position times the gear ratio (rad)."""


def travel(facts: BagFacts) -> Travel | None:
    """Return the motion by windows, None where there is too little."""
    motion = facts.motion
    n = len(motion.time) // WINDOW
    if n < 2:
        return None
    turned, angle, position = (
        x[:n * WINDOW].reshape(n, WINDOW).sum(axis=1)
        for x in (motion.turned, motion.angle, motion.travel)
    )
    if np.abs(angle).sum() < TRAVELLED:
        return None
    return Travel(motion.time[:n * WINDOW:WINDOW], turned, angle, position)


def motion_scales(facts: BagFacts) -> Iterator[Hit]:
    """Find speed, angle or position scaled against the other two."""
    found = facts.derived(travel)
    if found is None or facts.angle_in_degrees:
        return
    fast = np.abs(found.angle) > TURNED
    if fast.sum() < 4:
        return
    # The median: lost motion in the transmission changes few windows.
    speed = float(np.median((found.speed / found.angle)[fast]))
    position = float(np.median((found.position / found.angle)[fast]))
    ratios = {"motor_speed": (speed, SPEED_SCALE), "surface_position": (position, SCALE)}
    if abs(speed - 1.0) > SCALE and abs(position - speed) < 0.5 * SCALE * abs(speed):
        ratios = {"rotor_angle": (1.0 / speed, SPEED_SCALE)}
    for name, (ratio, bound) in ratios.items():
        if 0.2 < abs(ratio) < 5.0 and abs(ratio - 1.0) > bound:
            clock = ", or the clock of the samples is wrong" if name == "motor_speed" else ""
            yield Hit(f"{name} is {ratio:.3f} times what the other two say (gear ratio "
                      f"{facts.actuator.gear.ratio:g}){clock}", None, ratio, "", name)


def speed_offset(facts: BagFacts) -> Iterator[Hit]:
    """Find a speed that differs from that of the rotor angle in a part of the test."""
    found = facts.derived(travel)
    if found is None or facts.angle_in_degrees:
        return
    if abs(found.speed @ found.angle / (found.angle @ found.angle) - 1.0) > SCALE:
        return  # told by the rule on scales
    off = np.abs(found.speed - found.angle) / (WINDOW * facts.interval)
    wrong = off > SPEED_OFFSET * facts.actuator.control.speed_limit
    if wrong.any():
        row = int(np.argmax(wrong))
        yield Hit(f"motor_speed and rotor_angle differ by {off.max():.3g} rad/s",
                  float(found.time[row]), float(off.max()), "rad/s", "motor_speed")


_CALIBRATE = "calibrate or replace the transducer, then record the test again"
_WIRES = "check the transducer, its screen and its plug, then record the test again"
RULES = (
    Rule(name="sensor_scale", find=current_gains, remedy=_CALIBRATE),
    Rule(name="sensor_scale", find=motion_scales, remedy=_CALIBRATE),
    Rule(name="sensor_offset", find=current_offsets, remedy=_CALIBRATE),
    Rule(name="sensor_offset", find=speed_offset, remedy=_CALIBRATE),
    Rule(name="sensor_noise", find=noises, remedy=_WIRES),
    Rule(name="held_samples", find=held, remedy=_WIRES),
)
