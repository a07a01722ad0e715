"""Defects of recordings, 32 kinds, put into good bags: what `ema lint` must find.

A defect changes a `Recording` (the messages of a bag) and returns nothing; its place and size
are drawn from the generator. `DEFECTS` maps each kind to the rules of which one must fire.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from random import Random
from typing import NamedTuple

import numpy as np

from ema_record.profile import load_profile, step_profile
from ema_record.wire.samples import BLOCK_SIZE
from ema_record.wire.sensors import encode_bool, encode_dc_bus
from ema_record.wire.topics import DC_BUS, WEIGHT_ON_WHEELS, WINDING_TEMPERATURE
from ema_sim.simulate import simulate
from support.recording import Recording

MOTION, SPEED, POSITION, ANGLE = (1, 8, 9), 1, 9, 8
CURRENTS = (2, 3, 4)


class Kind(NamedTuple):
    """One kind of defect."""

    make: Callable[[Recording, Random], None]
    rules: frozenset[str]


DEFECTS: dict[str, Kind] = {}


def defect(*rules: str) -> Callable[[Callable[[Recording, Random], None]], None]:
    """Register a kind of defect; one of `rules` must find it."""

    def register(make: Callable[[Recording, Random], None]) -> None:
        DEFECTS[make.__name__] = Kind(make, frozenset(rules))

    return register


def place(r: Recording, rng: Random) -> int:
    """Return a block that is neither the first nor the last."""
    return rng.randrange(1, len(r.blocks) - 1)


@defect("gap")
def gap(r: Recording, rng: Random) -> None:
    """One to three blocks are lost."""
    k = place(r, rng)
    del r.blocks[k:min(k + rng.randint(1, 3), len(r.blocks) - 1)]


@defect("gap")
def missing_begin(r: Recording, rng: Random) -> None:
    """The first blocks are lost."""
    del r.blocks[:rng.randint(1, 3)]


@defect("clock_jump")
def clock_forward(r: Recording, rng: Random) -> None:
    """The clock of the samples jumps ahead."""
    for _, block in r.blocks[place(r, rng):]:
        block[:, 0] += rng.choice([0.002, 0.05, 1.0])


@defect("clock_jump")
def clock_backward(r: Recording, rng: Random) -> None:
    """The clock of the samples steps back."""
    step = rng.choice([0.002, 0.01, 0.02])
    for _, block in r.blocks[place(r, rng):]:
        block[:, 0] -= step


@defect("reception_clock")
def recorder_clock(r: Recording, rng: Random) -> None:
    """The recorder's clock is set."""
    k, step = place(r, rng), rng.choice([-(5 * 10**9), -(10**8), 4 * 10**8, 3600 * 10**9])
    r.blocks[k:] = [(time + step, block) for time, block in r.blocks[k:]]


@defect("duplicate_block")
def duplicate(r: Recording, rng: Random) -> None:
    """A block comes twice."""
    k = place(r, rng)
    r.blocks.insert(k + rng.randint(1, 2), r.blocks[k])


@defect("reordered_block")
def reordered(r: Recording, rng: Random) -> None:
    """Two blocks change places."""
    k = rng.randrange(1, len(r.blocks) - 2)
    (t0, b0), (t1, b1) = r.blocks[k:k + 2]
    r.blocks[k:k + 2] = [(t0, b1), (t1, b0)]


@defect("repeated_data")
def old_buffer(r: Recording, rng: Random) -> None:
    """A block holds the data of the one before."""
    k = rng.randrange(2, 5)  # in the slew
    r.blocks[k][1][:, 1:] = r.blocks[k - 1][1][:, 1:]


@defect("discontinuity")
def lost_unnoticed(r: Recording, rng: Random) -> None:
    """Samples are lost before they are stamped."""
    n, first = rng.randint(1, 40), rng.randrange(1200, 6000)

    def law(s: np.ndarray) -> None:
        s[first:-n, 1:] = s[first + n:, 1:].copy()

    r.change(law)


@defect("discontinuity")
def mixed(r: Recording, rng: Random) -> None:
    """The end is that of another test."""
    other = simulate(r.profile, seed=rng.randrange(1000, 2000))
    first = rng.randrange(500, len(r.record) - 500)

    def law(s: np.ndarray) -> None:
        s[first:, 1:] = other.samples[first:, 1:]

    r.change(law)


@defect("saturation")
def saturation(r: Recording, rng: Random) -> None:
    """A transducer is cut off at its range."""
    column = rng.choice([*CURRENTS, SPEED])

    def law(s: np.ndarray) -> None:
        limit = rng.uniform(0.3, 0.7) * np.abs(s[:, column]).max()
        np.clip(s[:, column], -limit, limit, out=s[:, column])

    r.change(law)


@defect("stuck_channel")
def stuck(r: Recording, rng: Random) -> None:
    """A channel keeps its value from some moment on."""
    column = rng.randrange(1, 10)
    first = rng.randrange(600, 4000)

    def law(s: np.ndarray) -> None:
        s[first:, column] = s[first, column]

    r.change(law)


@defect("stuck_channel")
def dead(r: Recording, rng: Random) -> None:
    """A channel is zero."""
    column = rng.randrange(1, 10)

    def law(s: np.ndarray) -> None:
        s[:, column] = 0.0

    r.change(law)


@defect("swapped_phases")
def swapped_phases(r: Recording, rng: Random) -> None:
    """Phase currents are mixed up."""
    order = rng.choice([(3, 2, 4), (4, 3, 2), (2, 4, 3), (3, 4, 2), (4, 2, 3)])
    r.change(lambda s: s.__setitem__((slice(None), slice(2, 5)), s[:, list(order)]))


@defect("wrong_unit")
def milliamperes(r: Recording, rng: Random) -> None:
    """Currents are in mA."""
    columns = rng.choice([[2], [3], [4], [2, 3, 4], [2, 3, 4, 5, 6, 7], [5, 6, 7]])
    r.change(lambda s: s.__setitem__((slice(None), columns), 1e3 * s[:, columns]))


@defect("wrong_unit")
def rpm(r: Recording, rng: Random) -> None:
    """The motor speed is in rpm."""
    r.change(lambda s: s.__setitem__((slice(None), 1), 30.0 / math.pi * s[:, 1]))


@defect("wrong_unit")
def degrees(r: Recording, rng: Random) -> None:
    """Angles are in degrees."""
    columns = rng.choice([[8], [9], [8, 9]])
    r.change(lambda s: s.__setitem__((slice(None), columns), np.degrees(s[:, columns])))


@defect("sign_flip")
def sign_flip(r: Recording, rng: Random) -> None:
    """A channel has the opposite sign."""
    column = rng.choice([*MOTION, *CURRENTS])

    def law(s: np.ndarray) -> None:
        s[:, column] = np.mod(-s[:, column], 2.0 * np.pi) if column == ANGLE else -s[:, column]

    r.change(law)


@defect("missing_topic")
def missing_topic(r: Recording, rng: Random) -> None:
    """A topic was not recorded."""
    gone = rng.choice(sorted({topic for _, topic, _ in r.others} - {WEIGHT_ON_WHEELS}))
    r.others = [m for m in r.others if m[1] != gone]


@defect("wrong_profile")
def wrong_profile(r: Recording, rng: Random) -> None:
    """The metadata, or metadata and command, are those of another test."""
    n = r.profile.name
    other = rng.choice([
        load_profile("extended" if n == "step" else "step"),
        step_profile(rng.uniform(0.1, 0.7), duration=r.profile.duration),
    ])
    r.profile = other


@defect("sample_rate", "wrong_unit")
def wrong_rate(r: Recording, rng: Random) -> None:
    """Another rate, or a clock that runs wrong."""
    factor = rng.choice([0.5, 2.0, 4.0, 1.0 / 1.024])
    if factor < 1.0:
        r.change(lambda s: s.__setitem__((slice(None), 0), s[:, 0] / factor))
        return
    samples = np.concatenate([block for _, block in r.blocks])[:: int(factor)]
    blocks = [samples[k:k + BLOCK_SIZE].copy() for k in range(0, len(samples), BLOCK_SIZE)]
    start = r.provenance.start_time
    r.blocks = [(start + round(1e9 * float(b[-1, 0])), b) for b in blocks]


@defect("test_not_complete")
def aborted(r: Recording, rng: Random) -> None:
    """The test was aborted or interrupted."""
    r.status = rng.choice(["aborted", "interrupted"])  # type: ignore[assignment]
    if rng.random() < 0.7:
        del r.blocks[place(r, rng):]


@defect("record_length")
def short(r: Recording, rng: Random) -> None:
    """The end was not recorded."""
    del r.blocks[-rng.randint(1, 4):]


@defect("foreign_software")
def foreign_software(r: Recording, rng: Random) -> None:
    """Another software recorded."""
    r.provenance = replace(
        r.provenance, software_version=rng.choice(["unknown", "9.4.1", "ACME-ECU 3.2", ""])
    )


@defect("not_finite")
def not_finite(r: Recording, rng: Random) -> None:
    """A value is no number."""
    _, block = r.blocks[place(r, rng)]
    block[rng.randrange(len(block)), rng.randrange(1, 10)] = rng.choice([math.nan, math.inf])


@defect("spike")
def spike(r: Recording, rng: Random) -> None:
    """A single value is far off."""
    _, block = r.blocks[place(r, rng)]
    column = rng.choice([*CURRENTS, SPEED, POSITION])
    block[rng.randrange(1, len(block) - 1), column] += rng.choice([-1.0, 1.0]) * {
        SPEED: 200.0, POSITION: 0.02,
    }.get(column, 60.0)


@defect("weight_on_wheels")
def off_wheels(r: Recording, rng: Random) -> None:
    """The aircraft leaves its wheels."""
    time, _ = r.blocks[place(r, rng)]
    r.others.append((time, WEIGHT_ON_WHEELS, encode_bool(False)))


@defect("wrong_unit")
def slow_units(r: Recording, rng: Random) -> None:
    """The bus in mV; the winding in K."""
    if rng.random() < 0.5:
        times = np.array([t for t, topic, _ in r.others if topic == DC_BUS])
        messages = encode_dc_bus(times, np.full(len(times), 48e3), np.full(len(times), 2.0))
        r.others = [m for m in r.others if m[1] != DC_BUS]
        r.others += [(int(t), DC_BUS, m) for t, m in zip(times, messages)]
    else:
        from ema_record.wire.sensors import encode_temperature

        times = np.array([t for t, topic, _ in r.others if topic == WINDING_TEMPERATURE])
        messages = encode_temperature(times, np.full(len(times), 298.0))
        r.others = [m for m in r.others if m[1] != WINDING_TEMPERATURE]
        r.others += [(int(t), WINDING_TEMPERATURE, m) for t, m in zip(times, messages)]


@defect("sensor_scale")
def sensor_gain(r: Recording, rng: Random) -> None:
    """A transducer reads 10 to 20 % too much or too little."""
    column = rng.choice([*CURRENTS, SPEED, POSITION])
    gain = 1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.2)
    r.change(lambda s: s.__setitem__((slice(None), column), gain * s[:, column]))


@defect("sensor_offset")
def sensor_offset(r: Recording, rng: Random) -> None:
    """A current sensor gets an offset during the test."""
    column, first = rng.choice(CURRENTS), rng.randrange(600, 6000)
    offset = rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 3.0)
    r.change(lambda s: s.__setitem__((slice(first, None), column), s[first:, column] + offset))


@defect("sensor_noise")
def sensor_noise(r: Recording, rng: Random) -> None:
    """A transducer picks up noise."""
    column = rng.choice([*CURRENTS, SPEED, POSITION])
    size = {SPEED: 20.0, POSITION: 1e-3}.get(column, 1.0) * rng.uniform(1.0, 2.0)
    generator = np.random.default_rng(rng.randrange(1 << 30))

    def law(s: np.ndarray) -> None:
        s[:, column] += generator.normal(0.0, size, len(s))

    r.change(law)


@defect("held_samples")
def held_samples(r: Recording, rng: Random) -> None:
    """A current is sampled less often than it is stored."""
    column, every = rng.choice(CURRENTS), rng.randint(2, 8)
    r.change(lambda s: s.__setitem__(
        (slice(None), column), s[np.arange(len(s)) // every * every, column]))
