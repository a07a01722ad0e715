"""What the rules look at, what a rule is, and what it finds.

The facts of a test are the samples of its record, and what a bag says beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from ema_record.actuator import Actuator, load_actuator
from ema_record.channels import (
    ALL,
    MOTOR_SPEED,
    N_CHANNELS,
    PHASE_CURRENTS,
    REFERENCE_CURRENTS,
    ROTOR_ANGLE,
    SURFACE_POSITION,
    TIME,
    median,
    recorded_columns,
)
from ema_record.profile import Profile
from ema_record.record import Provenance, Record, SampleBlock
from ema_record.spread import Conditions, load_spread
from ema_record.wire.types import NANOSECONDS

T = TypeVar("T")
Severity = Literal["error", "warning"]
SETTLED = 5e-3
"""After the inverter is switched on; before, sensors without noise rest at zero (s)."""
SLOWEST = 0.0253
"""Share of the motor's highest speed below which it counts as standing."""
REST_OFFSET = (0.0227, 10.0)
"""Reading of a current while the inverter is off: of the current limit, at least, and times the
offset of a good sensor."""
SUM_OFFSET = (0.01364, 6.0)
"""The same of the mean of the weighted sum of the currents over a part of the test."""
SLOW = 0.3795
"""Share of the motor's highest speed below which the drive has voltage to spare."""
LONGEST = 16
"""Samples for which a value is held; longer is a current that stands still, or a channel."""
IMPOSSIBLE = 3.0
"""Times the motor's highest speed that it never reaches."""
SCALE = 0.05
"""Relative distance of a channel from what it is compared with, of any type of actuator."""
CALIBRATE = "calibrate or replace the transducer, then record the test again"
SET_UNIT = "set the unit of the acquisition to that of the channel list, or use 'ema import'"
"""Remedies of a sensor whose scale or offset is off, and of a channel in another unit."""
WINDOW_TIME = 0.02
"""Time over which noise and travel are taken (s)."""
LEAST_WINDOW = 100
"""The same in samples, at low rates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Differences from sample to sample where time goes on by one interval, moving or not.

    Attributes
    ----------
    time : ndarray, shape (m,). Of the later sample (s).
    turned : ndarray, shape (m,). Motor speed times interval (rad).
    angle : ndarray, shape (m,). What the motor turned as the rotor angle says (rad); NaN without
        that channel.
    travel : ndarray, shape (m,). The same as the surface position says: its change times the gear
        ratio (rad); NaN without that channel.
    """

    time: np.ndarray
    turned: np.ndarray
    angle: np.ndarray
    travel: np.ndarray


@dataclass(frozen=True)
class BagFacts:
    """A test as recorded; the samples may be in any order and of any value."""

    actuator: Actuator
    """Nominal parameters of what was tested."""
    blocks: Sequence[SampleBlock]
    said: Profile | None
    """The test as the metadata say."""
    provenance: Provenance
    bus_voltage: np.ndarray
    """Shape (m,) (V)."""
    winding_temperature: np.ndarray
    """Shape (m,) (degC)."""
    command: Profile | None = None
    """The test as read off `/ema/command`."""
    topics: frozenset[str] = frozenset()
    """Those with messages; empty for a record that is no bag, like all below."""
    has_start: bool = True
    """Whether our own software recorded it."""
    recovered: Mapping[str, str] | None = None
    """What 'ema recover' noted in the bag."""
    weight_on_wheels: Sequence[bool] = ()
    errors: Sequence[str] = ()
    """Messages that cannot be decoded, one line each."""
    _derived: dict[object, Any] = field(default_factory=dict, repr=False)

    def derived(self, make: Callable[[BagFacts], T]) -> T:
        """Return what `make` makes of these facts, made once for all rules."""
        if make not in self._derived:
            self._derived[make] = make(self)
        made: T = self._derived[make]
        return made

    @property
    def profile(self) -> Profile | None:
        """Return the test profile as the record says."""
        return self.said or self.command

    @property
    def standing(self) -> float:
        """Motor speed below which it stands (rad/s)."""
        return SLOWEST * self.actuator.control.speed_limit

    @property
    def acceleration(self) -> float:
        """Highest acceleration of the motor (rad/s²): full torque on all that it turns."""
        a = self.actuator
        torque = min(a.motor.torque_limit,
                     2.0 * a.motor.back_emf_constant * a.inverter.current_limit)
        return torque / (a.motor.inertia + a.surface.inertia / a.gear.ratio**2)

    @property
    def run_up(self) -> float:
        """Time in which full torque brings the motor to its highest speed (s)."""
        return self.actuator.control.speed_limit / self.acceleration

    @property
    def twist(self) -> float:
        """How far shaft and lost motion part surface and motor, from one sense to the other (rad).

        That is the way between friction and load one way and the other.
        """
        a = self.actuator
        torque = max(a.surface.static_friction, a.surface.dynamic_friction) + self.conditions.load
        return 2.0 * torque / a.shaft.stiffness + a.shaft.backlash

    @cached_property
    def conditions(self) -> Conditions:
        """Bounds of good sensors and of the conditions of a test, as the kit says."""
        return load_spread().conditions

    @cached_property
    def columns(self) -> tuple[int, ...]:
        """Columns of `samples` that were recorded, in order; the others are NaN."""
        return recorded_columns(self._recorded) if self.blocks else ALL

    def has(self, *columns: int) -> bool:
        """Return whether all these columns were recorded."""
        return set(columns) <= set(self.columns)

    @property
    def currents(self) -> list[int]:
        """Columns of the phase currents that were recorded, two or three."""
        return [c for c in ALL[PHASE_CURRENTS] if c in self.columns]

    @property
    def has_references(self) -> bool:
        """Whether all three reference currents were recorded."""
        return self.has(*ALL[REFERENCE_CURRENTS])

    @property
    def uploaded(self) -> bool:
        """Whether the drive was read out after the move: nothing came before all was taken."""
        start = self.provenance.start_time
        if not start or not self.blocks or not self.blocks[0].log_time:
            return False
        last = max(float(block.samples[-1, TIME]) for block in self.blocks)
        return (self.blocks[0].log_time - start) / NANOSECONDS >= last

    def offset_bound(self, shares: tuple[float, float]) -> float:
        """Return a bound on the offset of currents (A): one of `REST_OFFSET`, `SUM_OFFSET`."""
        limit = self.actuator.inverter.current_limit
        return max(shares[0] * limit, shares[1] * self.conditions.current_offset)

    def vector(self, part: slice) -> np.ndarray:
        """Return phase or reference currents as rotating vectors, complex, shape (n,) (A).

        Their size is the amplitude of a phase. Of two currents the third is what makes the sum
        zero.
        """
        values = self.samples[:, part]
        absent = np.isnan(values).all(axis=0)
        third = -np.where(absent, 0.0, values).sum(axis=1, keepdims=True)
        turns = np.exp(2j * np.pi / 3.0 * np.arange(3))
        return np.asarray(np.where(absent, third, values) @ turns * (2.0 / 3.0))

    @property
    def window(self) -> int:
        """Samples over which noise and travel are taken."""
        if not self.interval > 0.0:
            return LEAST_WINDOW
        return max(LEAST_WINDOW, round(WINDOW_TIME / self.interval))

    @cached_property
    def surface(self) -> np.ndarray:
        """Position of the surface, shape (n,) (rad); without that channel, from the speed.

        It then begins where the profile does.
        """
        s = self.samples
        if self.has(SURFACE_POSITION) or not len(s):
            return s[:, SURFACE_POSITION]
        speed = s[:, MOTOR_SPEED] / self.actuator.gear.ratio
        steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(s[:, TIME])
        start = self.profile.start if self.profile else 0.0
        return np.concatenate([[start], start + np.cumsum(steps)])

    @cached_property
    def _recorded(self) -> np.ndarray:
        return np.concatenate([block.samples for block in self.blocks])

    def _finite(self, samples: np.ndarray) -> np.ndarray:
        """Return which values are finite, those of columns that were not recorded too."""
        finite = np.isfinite(samples)
        finite[:, [c for c in ALL if c not in self.columns]] = True
        return finite

    @cached_property
    def in_order(self) -> bool:
        """Whether every sample has a time, later than that of the one before it."""
        return bool((np.diff(self._recorded[:, TIME], prepend=-np.inf) > 0.0).all())

    @cached_property
    def samples(self) -> np.ndarray:
        """Finite samples in order of time, each time once, shape (n, 10), column by column."""
        if not self.blocks:
            return np.empty((0, N_CHANNELS))
        samples = self._recorded
        finite = self._finite(samples).all(axis=1)
        if not (finite.all() and self.in_order):
            samples = samples[finite]
            _, first = np.unique(samples[:, TIME], return_index=True)
            samples = samples[first]
        return np.asfortranarray(samples)

    @cached_property
    def unusable(self) -> np.ndarray:
        """Times of the samples that are not finite, shape (k,) (s), in order.

        A sample without a time has that of the last one before it.
        """
        if not self.blocks:
            return np.empty(0)
        samples = self._recorded
        finite = self._finite(samples)
        bad = ~finite.all(axis=1)
        timed = np.maximum.accumulate(np.where(finite[:, TIME], np.arange(len(samples)), 0))
        return np.sort(samples[timed, TIME][bad])

    @cached_property
    def interval(self) -> float:
        """Median interval of the samples (s); NaN below 2 samples."""
        time = self.samples[:, TIME]
        return float(median(np.diff(time))) if len(time) > 1 else float("nan")

    @property
    def too_fast(self) -> bool:
        """Whether the speed goes so far beyond the highest one that its unit is another."""
        speed = self.samples[:, MOTOR_SPEED]
        bound = IMPOSSIBLE * self.actuator.control.speed_limit
        return bool(len(speed)) and float(np.abs(speed).max()) > bound

    @cached_property
    def angle_in_degrees(self) -> bool:
        """Return whether the rotor angle goes beyond a turn in radians."""
        angle = self.samples[:, ROTOR_ANGLE]
        return bool(len(angle)) and float(np.abs(angle).max()) > 2.0 * np.pi + 0.5

    @cached_property
    def motion(self) -> Motion:
        """Return what moved from sample to sample."""
        s = self.samples
        step = np.diff(s[:, TIME])
        regular = np.abs(step - self.interval) < 0.1 * self.interval
        speed = 0.5 * (s[1:, MOTOR_SPEED] + s[:-1, MOTOR_SPEED])
        angle = s[:, ROTOR_ANGLE] * (np.pi / 180.0 if self.angle_in_degrees else 1.0)
        turned = np.mod(np.diff(angle) + np.pi, 2.0 * np.pi) - np.pi
        return Motion(
            time=s[1:, TIME][regular], turned=(speed * step)[regular],
            angle=self.actuator.motor_angle(turned[regular]),
            travel=self.actuator.gear.ratio * np.diff(s[:, SURFACE_POSITION])[regular],
        )


def facts_of_record(record: Record, actuator: Actuator | None = None) -> BagFacts:
    """Return a record for those rules that need no bag; `actuator` defaults to the kit's."""
    return BagFacts(
        actuator=load_actuator() if actuator is None else actuator,
        blocks=[SampleBlock(0, record.samples)] if len(record) else [],
        said=record.profile, provenance=record.provenance, bus_voltage=record.dc_bus[:, 1],
        winding_temperature=record.winding_temperature[:, 1],
    )


class Hit(NamedTuple):
    """One place where a rule is broken."""

    message: str
    time: float | None = None
    """Since the acceptance of the command (s); None: the whole record."""
    size: float | None = None
    unit: str = ""
    channel: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One defect of a recording."""

    rule: str
    level: Severity
    message: str
    time: float | None
    """Since the acceptance of the command (s); None: the whole record."""
    size: float | None
    unit: str
    """Of `size`."""
    channel: str
    """Channel or topic, empty where it is none."""
    remedy: str

    def to_dict(self) -> dict[str, object]:
        """Return the fields as plain types."""
        return asdict(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One kind of defect and how it is found."""

    name: str
    remedy: str
    find: Callable[[BagFacts], Iterable[Hit]]
    level: Severity = "error"

    def check(self, facts: BagFacts) -> list[Finding]:
        """Return what the rule finds in a bag."""
        return [Finding(rule=self.name, level=self.level, remedy=self.remedy, **hit._asdict())
                for hit in self.find(facts)]
