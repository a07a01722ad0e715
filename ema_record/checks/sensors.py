"""Rules on the transducers: gain, offset, noise and held values that physics gives away.

The true currents of a star sum to zero, the reference is what the drive makes them, angle and
position are integrals of the speed. None of that depends on the actuator's health, so a broken
sensor is told from a broken actuator. Bounds are shares of what the kit says of its actuator, two
times and more beyond what a good sensor may do (gain, offset and noise of the kit's conditions).
What is better than that (an exact sum, no rounding, no noise) breaks none of them; what a
recorder lacks is not asked for.

Held values are samples of a current that were stored and not taken. A converter that is coarse, or
a current that is quiet, repeats values too: changes of a held channel are larger than the steps of
its converter, or come in a fixed beat; a long run of one value is another matter (`values.stuck`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ema_record.actuator import FOC, NOISE_RATE, RELAY
from ema_record.channels import (
    CHANNELS,
    MOTOR_SPEED,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    TIME,
    median,
)
from ema_record.checks.facts import (
    CALIBRATE,
    LONGEST,
    REST_OFFSET,
    SCALE,
    SETTLED,
    SLOW,
    SUM_OFFSET,
    BagFacts,
    Hit,
    Rule,
)
from ema_record.record import SETTLING

GAIN_SPREAD = (0.04, 4.0)
"""Between the relative gains of the current sensors: at least, and times a good one's error."""
NOISY = 5.0
"""Times the most noise of a good sensor that is too much; of the sum of three currents three
times."""
ROUGH = 7.0
"""The same of the position, whose noise is that of its converter."""
LEAST_NOISE = 3e-5
"""Noise of a good sensor, however little its kit says, of the highest value."""
ANGLE_NOISE = 2e-3
"""White noise of the commutation sensor that is too much (rad rms at the motor)."""
RIPPLE = 0.05
"""Change of the acceleration of motor and surface from sample to sample, of the highest one, at
`NOISE_RATE`; in proportion to longer intervals."""
PARTS = 16
"""Of the test, for its offsets."""
SEPARATED = 200.0
"""Ratio of the two smallest variances from which the weights of the sum are known."""
UNLIMITED = (0.1364, 0.9091)
"""Reference currents that are neither noise nor the limit (of the limit)."""
OF_BAND = 6.0
"""Half widths of a relay's band from which its mean current is within 3 % of the reference: it
falls short by 0.1 to 0.2 of one (0.45 to 1.7 A beside 0.77 A; 3 to 4 A beside 0.5 A)."""
STEADY_TIME = 1e-3
"""For which a reference is constant before its current is compared (s)."""
HELD = 0.05
"""Share of the samples of a driven phase current that repeat the one before."""
COARSE = 0.5
"""Added to it over the median change in steps of the converter: what rounding repeats, doubled."""
FINE = 2.0
"""Median change, in those steps, from which rounding explains few repeats."""
BEAT = 0.5
"""Changes that follow a change at once, of those by chance, that only a fixed beat has."""
DRIVEN = 1e-3
"""Current that counts as driven, of the limit, where the references were not recorded."""
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
    test, so that an offset that appears does not turn them. Of two currents there is no sum: it
    is zero, its weights are not known, and the third one rests at 0.
    """
    s = facts.samples
    off = facts.profile.inverter_off if facts.profile else 0.0
    start = int(np.searchsorted(s[:, TIME], off + SETTLED))
    currents = s[:, PHASE_CURRENTS]
    resting = currents[slice(*np.searchsorted(s[:, TIME], (SETTLING, off - SETTLING)))]
    rest = np.zeros(3)
    if len(resting) >= facts.window // 4:
        rest = np.nan_to_num(resting.mean(axis=0))
    driven = currents[start:] - rest
    if len(driven) < 2 * facts.window:
        return None
    if len(facts.currents) < 3:
        return CurrentSum(rest, np.ones(3), False, start, np.zeros(len(driven)))
    scatter = np.zeros((3, 3))
    for part in np.array_split(driven, PARTS):
        centred = part - part.mean(axis=0)
        scatter += centred.T @ centred
    if not np.isfinite(scatter).all():  # readings without a bound
        return None
    variances, vectors = np.linalg.eigh(scatter)
    weights = np.abs(vectors[:, 0])
    known = variances[1] > SEPARATED * variances[0] and weights.min() > 0.2
    gain = weights.mean() / weights if known else np.ones(3)
    return CurrentSum(rest, gain / gain.mean(), bool(known), start, driven @ (1.0 / gain))


def current_gains(facts: BagFacts) -> Iterator[Hit]:
    """Find a current sensor of another gain than the other two, or all against the reference."""
    found = facts.derived(current_sum)
    most = max(GAIN_SPREAD[0], GAIN_SPREAD[1] * facts.conditions.current_gain)
    if found is not None and found.known and np.ptp(found.gain) > most:
        error = found.gain / median(found.gain) - 1.0
        k = int(np.argmax(np.abs(error)))
        name = f"phase_current_{_PHASES[k]}"
        yield Hit(f"{name} reads {100 * error[k]:+.1f} % against the other two, which with it sum "
                  "to zero", None, float(error[k]), "", name)
        return
    ratio = _by_reference(facts) if facts.has_references else None
    if ratio is not None and abs(ratio - 1.0) > max(SCALE, 5.0 * facts.conditions.current_gain):
        yield Hit(f"the phase currents are {ratio:.3f} times their references at low speed",
                  None, ratio, "", "phase_current")


def _by_reference(facts: BagFacts) -> float | None:
    """Return the phase currents against their references at low speed, None: too few.

    Six-step references are compared where they are steady, the median phase; sinusoidal ones as
    rotating vectors, whatever the lag of the control.
    """
    s = facts.samples
    if len(s) < facts.window:
        return None
    slow = np.abs(s[:, MOTOR_SPEED]) < SLOW * facts.actuator.control.speed_limit
    least, most = (share * facts.actuator.inverter.current_limit for share in UNLIMITED)
    if facts.actuator.drive.kind == RELAY:
        least = max(least, OF_BAND * facts.actuator.inverter.hysteresis)
    if facts.actuator.drive.kind == FOC:
        # Means in the rotor's frame: the noise of a reference would make the ratio too small.
        n = max(4, facts.window // 4)
        turned = np.cumsum(s[:, MOTOR_SPEED]) * facts.interval * facts.actuator.motor.pole_pairs
        current, reference, slow = (
            x[:len(s) // n * n].reshape(-1, n).mean(axis=1) for x in (
                *(facts.vector(part) * np.exp(-1j * turned)
                  for part in (PHASE_CURRENTS, REFERENCE_CURRENTS)), slow))
        size = np.abs(reference)
        use = (size > least) & (size < most) & (slow == 1.0)
        use[1:] &= np.abs(np.diff(size)) < 0.1 * size[1:]
        if n * use.sum() < facts.window:
            return None
        reference = reference[use]
        return float(abs(np.vdot(reference, current[use])) / np.vdot(reference, reference).real)
    steady = max(2, round(STEADY_TIME / facts.interval))
    ratios = []
    for column in facts.currents:
        reference = s[slow, column - PHASE_CURRENTS.start + REFERENCE_CURRENTS.start]
        if len(reference) <= steady:
            return None
        now, before = reference[steady:], reference[:-steady]
        size = np.abs(now)
        use = (np.abs(now - before) < 0.1 * size) & (size > least) & (size < most)
        use &= np.abs(now - reference[steady // 2:steady // 2 - steady]) < 0.1 * size
        if use.sum() < facts.window:
            continue
        measured = s[slow, column][steady:]
        ratios.append(float((measured * np.sign(now))[use].sum() / size[use].sum()))
    return float(median(ratios)) if ratios else None


def current_offsets(facts: BagFacts) -> Iterator[Hit]:
    """Find current sensors with an offset, at rest or from some moment on."""
    found = facts.derived(current_sum)
    if found is None:
        return
    k = int(np.argmax(np.abs(found.rest)))
    if abs(found.rest[k]) > facts.offset_bound(REST_OFFSET):
        name = f"phase_current_{_PHASES[k]}"
        yield Hit(f"{name} reads {found.rest[k]:+.2f} A while the inverter is off",
                  0.0, float(found.rest[k]), "A", name)
    if not found.known:
        return
    means = np.array([part.mean() for part in np.array_split(found.residual, PARTS)])
    wrong = np.abs(means) > facts.offset_bound(SUM_OFFSET)
    if wrong.any():
        part = int(np.argmax(wrong))
        row = found.start + part * len(found.residual) // PARTS
        worst = float(means[np.argmax(np.abs(means))])
        yield Hit(
            f"the phase currents sum to {worst:+.2f} A, not to zero, from "
            f"{facts.samples[row, TIME]:.3f} s on: the offset of a current sensor changes",
            float(facts.samples[row, TIME]), worst, "A", "phase_current",
        )


def noise_bounds(facts: BagFacts) -> dict[int, float]:
    """Return the white noise within a window that is too much, rms, by column; 2: any current.

    What the machine itself does from sample to sample counts beside the sensor's noise.
    """
    a = facts.actuator
    noise, c, most = a.noise, a.converters, max(1.0, facts.conditions.noise_most)
    dt = facts.interval
    wider = np.sqrt(max(1.0, 1.0 / (dt * NOISE_RATE)))  # the band of the noise

    def least(nominal: float, span: float, bits: int, highest: float) -> float:
        rounding = span / 2**bits / np.sqrt(12.0)  # a converter is white noise too
        return float(max(nominal, rounding, LEAST_NOISE * highest) * most * wider)

    ripple = min(1.0, RIPPLE * max(1.0, dt * NOISE_RATE))
    shake = ripple * facts.acceleration * dt
    surface_acceleration = a.motor.torque_limit * a.gear.ratio / a.surface.inertia
    pole_pairs = a.motor.pole_pairs
    angle = max(ANGLE_NOISE * pole_pairs, ROUGH * c.angle_range / 2**c.angle_bits)
    return {
        PHASE_CURRENTS.start: NOISY * least(
            noise.current, c.current_range, c.current_bits, a.inverter.current_limit),
        MOTOR_SPEED: shake + NOISY * least(
            noise.speed, c.speed_range, c.speed_bits, a.control.speed_limit),
        SURFACE_POSITION: ripple * surface_acceleration * dt * dt + ROUGH * least(
            noise.position, c.position_range, c.position_bits, a.surface.end_stop),
        ROTOR_ANGLE: angle * wider + shake * dt * pole_pairs,
    }


def noises(facts: BagFacts) -> Iterator[Hit]:
    """Find channels with much more noise than a good sensor has."""
    s, window = facts.samples, facts.window
    bounds = noise_bounds(facts)
    bound = bounds.pop(PHASE_CURRENTS.start)
    currents = s[:, PHASE_CURRENTS]
    noise, part = _noise(currents.sum(axis=1), bound, window)  # NaN without one of the three
    if noise > bound:
        rough = np.diff(currents, 2, axis=0).std(axis=0)
        name = f"phase_current_{_PHASES[int(np.argmax(rough))]}"
        yield Hit(f"noise of the sum of the phase currents is {noise:.2f} A rms, {name} has most",
                  float(s[part * window, TIME]), noise, "A", name)
    for column, bound in bounds.items():
        values = np.unwrap(s[:, column]) if column == ROTOR_ANGLE else s[:, column]
        noise, part = _noise(values, bound, window)
        if noise > bound:
            name, unit = CHANNELS[column]
            yield Hit(f"noise of {name} is {noise:.3g} {unit} rms",
                      float(s[part * window, TIME]), noise, unit, name)


def _noise(values: np.ndarray, bound: float, window: int) -> tuple[float, int]:
    """Return the largest white noise (rms) of all windows, and the first beyond `bound`."""
    rough = np.abs(np.diff(values, 2))
    n = len(rough) // window
    if n == 0:
        return 0.0, 0
    # Of white noise of deviation 1: median 0.6745, and the second difference has sqrt(6).
    noise = median(rough[:n * window].reshape(n, window), axis=-1) / (0.6745 * np.sqrt(6.0))
    return float(noise.max()), int(np.argmax(noise > bound))


def held(facts: BagFacts) -> Iterator[Hit]:
    """Find phase currents that often repeat the sample before: samples were not taken."""
    s = facts.samples
    off = facts.profile.inverter_off + SETTLED if facts.profile else 0.0
    s = s[int(np.searchsorted(s[:, TIME], off)):]
    if facts.has_references:
        driven = (s[1:, REFERENCE_CURRENTS] != 0.0).any(axis=1)
    else:
        least = DRIVEN * facts.actuator.inverter.current_limit
        driven = (np.abs(s[1:, facts.currents]) > least).any(axis=1)
    if driven.sum() < facts.window:
        return
    for column in facts.currents:
        share, first = held_share(np.abs(np.diff(s[:, column])), driven)
        if share > HELD:
            name = CHANNELS[column].name
            yield Hit(f"{100 * share:.0f} % of the samples of {name} repeat the one before",
                      float(s[1 + first, TIME]), share, "", name)


def held_share(change: np.ndarray, driven: np.ndarray) -> tuple[float, int]:
    """Return the share of samples that are held, 0 where rounding explains it, and the first.

    Parameters
    ----------
    change : ndarray, shape (n,). Absolute changes from sample to sample (A).
    driven : ndarray of bool, shape (n,). Where they count.
    """
    same = change == 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    driven = driven.copy()
    long = edges[1::2] - edges[::2] >= LONGEST
    for begin, end in zip(edges[::2][long].tolist(), edges[1::2][long].tolist()):
        driven[begin:end] = False
    repeats, changes = driven & same, change[driven & ~same]
    if not (len(changes) and repeats.any()):
        return 0.0, 0
    share = float(repeats.sum() / driven.sum())
    steps = float(median(changes) / changes.min())
    after = ~same[:-1] & driven[1:]  # samples after a change
    follows = float((after & ~same[1:]).sum() / max(1, int(after.sum())))
    beaten = follows < BEAT * (1.0 - share)
    rough = steps > FINE and share > HELD + COARSE / steps
    return (share if beaten or rough else 0.0), int(np.argmax(repeats))


_WIRES = "check the transducer, its screen and its plug, then record the test again"
RULES = (
    Rule(name="sensor_scale", find=current_gains, remedy=CALIBRATE),
    Rule(name="sensor_offset", find=current_offsets, remedy=CALIBRATE),
    Rule(name="sensor_noise", find=noises, remedy=_WIRES),
)
HELD_SAMPLES = Rule(name="held_samples", find=held, remedy=_WIRES)
"""Told last of all rules."""
