"""The units of the panel: what is hidden, what is known of its sizes, how their tests are made.

Effects are of medium and large size (`benchmarks.blind_panel.truth.hidden`). Each test of a unit
is another day; one more may follow, whose profile is not known before the others are judged.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.any_actuator.cases import _stranger
from benchmarks.any_actuator.described import Damage
from benchmarks.any_actuator.machines import FOLDER
from benchmarks.any_actuator.records import BenchTest, record_of
from benchmarks.any_actuator.units import draw_test
from benchmarks.blind_panel.truth.hidden import HIDEABLE, draw_effect, draw_pair
from ema_identification.actuator.fleet.units import (
    draw_fleet_conditions,
    fleet_unit,
    of_day,
    unit_numbers,
    unlisted,
)
from ema_record.actuator import Actuator, load_actuator
from ema_record.kit import using_kit
from ema_record.profile import Profile, load_profile
from ema_record.profiles.design import default_profiles
from ema_record.record import Record
from ema_record.spread import UnitTolerances, load_spread
from ema_sim.effects import parse_effects
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate, start_of

DAMAGES: dict[str, tuple[str, float | None]] = {
    "turn_short": ("short", 0.03), "rotor_eccentricity": ("eccentricity", 0.03),
    "motor_friction": ("motor_friction", 0.6), "surface_friction": ("surface_friction", 0.6),
    "backlash": ("backlash", 1e-3), "cogging_torque": ("cogging", None),
    "torque_constant_drop": ("demagnetisation", 0.15), "bus_voltage_sag": ("sag", None),
    "phase_resistance_imbalance": ("resistance", 0.5), "hall_misalignment": ("hall", 0.1),
    "gear_mesh_ripple": ("mesh", None),
}
"""Effect: field of `Damage` and its size; None: as the benchmark of the kit draws it."""
OTHER_LAW = ("gear_mesh_ripple",)
"""Of the second simulator: another law than the catalogue's, so *unknown* is right there. Its mesh
error is in series with the shaft only: neither the motor feels its slope (the catalogue's law
transforms the torque with dθ_out/dθ, as virtual work asks) nor the shaft's damping. At its size,
0.2 of the twist by dry friction, that slope is as large as the gear's own."""
LISTED_DAMAGES = tuple(name for name in DAMAGES if name not in OTHER_LAW)
STRANGE = tuple(name for name, hidden in HIDEABLE.items() if hidden.without is not None)
STRANGE_DAMAGES = tuple(name for name in DAMAGES if name in STRANGE)
PWM, FOC = FOLDER / "joint_48v", FOLDER / "valve_12v"
"""Kits of machines with a carrier: currents in blocks, and in the rotor's axes."""
ALIKE = ("turn_short", "rotor_eccentricity", "cogging_torque")
"""Effects that a short test tells apart from another one least often: strata for sets of names."""
RANGE = 1.3
"""Of bands that are wider than the description says."""


class HiddenUnit(NamedTuple):
    """A unit under test: what is hidden, what the catalogue lacks, its records."""

    names: tuple[str, ...]
    without: tuple[str, ...]
    records: tuple[Record, ...]
    again: Callable[[Profile], Record]
    """One more test of the unit as it is now, on another day."""
    truth: dict[str, float | str]
    """Parameters of the catalogue's laws as they are hidden, dotted names."""
    both: Callable[[int, str], tuple[Record, Record]]
    """The first test on one day, with all that is hidden and without one effect, same noise."""
    accepted: tuple[Record, ...] = ()
    """From before something was hidden, of the first test."""
    kit: Path | None = None
    """Of another machine than the default one."""
    place: np.ndarray | None = None
    """Where the unit is in its bands, half widths, if it is of our own simulator."""


LATER = (("motor.stribeck_speed", "noise.position", "start.position", "start.twist"),
         ("converters.speed_offset",))
"""Numbers of a unit that came later, together: drawn apart, so that earlier units stay as they
were."""


def own_unit(
    seed: int, k: int, tests: tuple[str, ...], *, hidden: int = 0, listed: bool = False,
    strange: bool = False, bands: float = 1.0, accepted: bool = False, kit: Path | None = None,
    only: tuple[str, ...] = tuple(HIDEABLE),
) -> HiddenUnit:
    """Return a unit of our own simulator with `hidden` effects; `only` : one of these.

    `listed` : only what recalibration lists is off, latencies and the rest as given.
    """
    model, spread = load_model_file(), load_spread()
    rng = np.random.default_rng([seed, 77, k])
    known = unit_numbers(model.actuator)
    width, later = len(known), [[known.index(name) for name in names] for names in LATER]
    old = np.setdiff1d(np.arange(width), np.concatenate(later))

    def streams(which: int) -> list[np.random.Generator]:
        return [np.random.default_rng([seed, which + 10 * n, k]) for n in range(len(later))]

    def numbers(rng: np.random.Generator, more: list[np.random.Generator]) -> np.ndarray:
        found = np.empty(width)
        found[old] = rng.uniform(-1.0, 1.0, len(old))
        for places, one in zip(later, more):
            found[places] = one.uniform(-1.0, 1.0, len(places))
        return found

    more = streams(80)
    z = bands * numbers(rng, more)
    if listed:
        usual = unlisted(model.actuator)
        z[-len(usual):] = [-1.0 if name.endswith(("latency", "stribeck_speed")) else 0.0
                           for name in usual]
    pool = STRANGE if strange else only
    order = np.random.default_rng([seed, 76]).permutation(len(pool))
    names: tuple[str, ...] = ()
    if hidden:
        names = draw_pair(rng) if hidden == 2 else (pool[order[k % len(pool)]],)
    settings: dict[str, float | str] = {}
    for name in names:
        settings |= draw_effect(name, 1 + int(rng.integers(2)), rng)

    def tested(profile: Profile, given: Mapping[str, float | str] = settings,
               rng: np.random.Generator = rng, repeat: int | None = None) -> Record:
        today = np.where(of_day(width), numbers(
            rng, more if repeat is None else streams(81)), z)
        day = draw_fleet_conditions(copy.deepcopy(rng), spread)
        rng.uniform(size=4)  # what it drew when one noise was all sensors'
        actuator, effects = fleet_unit(model, spread, today, day, parse_effects(
            [f"{a}={b}" for a, b in given.items()], model.effects))
        return simulate(profile, actuator=actuator, effects=effects,
                        seed=int(rng.integers(2**31)) if repeat is None else repeat,
                        start_angle=day.start_angle,
                        start=start_of(model.actuator, profile, today[-2:]))

    def both(repeat: int, name: str) -> tuple[Record, Record]:
        others = {at: value for at, value in settings.items() if at.split(".")[0] != name}
        with_it, without = (tested(test_of(tests[0], kit), given, np.random.default_rng(
            [seed, 79, k]), repeat) for given in (settings, others))
        return with_it, without

    before = tuple(tested(test_of(test, kit), {}) for test in tests[:accepted])
    return HiddenUnit(names, (HIDEABLE[names[0]].without or ()) if strange else (),
                      tuple(tested(test_of(test, kit)) for test in tests), tested, settings,
                      both, before, kit, z)


def test_of(name: str, kit: Path | None) -> Profile:
    """Return a test by its name, as the product makes it for the machine of a kit."""
    return load_profile(name) if kit is None else default_profiles(load_actuator())[name]


def second_unit(
    seed: int, k: int, tests: tuple[str, ...], *, hidden: int = 0, strange: bool = False,
    bands: float = 1.0, accepted: bool = False, kit: Path | None = None,
    only: tuple[str, ...] = LISTED_DAMAGES,
) -> HiddenUnit:
    """Return a unit of the second simulator, all of the kit's `tolerances` off."""
    a, spread = load_actuator(), load_spread()
    tolerances = UnitTolerances(**{
        name: band**bands if name == "viscous_factor" else band * bands
        for name, band in spread.tolerances._asdict().items()})
    rng = np.random.default_rng([seed, 78, k])
    names: tuple[str, ...] = ()
    pool = STRANGE_DAMAGES if strange else only
    if hidden:
        order = np.random.default_rng([seed, 75]).permutation(len(pool))
        names = draw_pair(rng, pool) if hidden == 2 else (pool[order[k % len(pool)]],)
    damage = Damage()
    for name in names:
        field, size = DAMAGES[name]
        if kit is not None and field == "backlash":  # in the machine's own measure
            size = a.wind_up / a.gear.ratio
        fields: dict[str, Any] = {field: size, "phase": int(rng.integers(3)),
                                  "angle": float(rng.uniform(-3.0, 3.0))}
        if size is None:
            fields[field] = getattr(_stranger(a, field, rng), field)
        damage = damage._replace(**fields)
    truth: dict[str, float | str] = {}
    for name in names:
        truth |= catalogued(a, name, damage)
    without = (HIDEABLE[names[0]].without or ()) if strange else ()
    done = [0]
    profiles = [test_of(test, kit) for test in tests]

    def test_on(day: int, given: Damage) -> BenchTest:
        return draw_test(a, tolerances, spread.conditions, (seed + hidden + strange, k), day,
                         given, own=False)

    def tested(profile: Profile, given: Damage = damage) -> Record:
        done[0] += 1
        return record_of(test_on(done[0] - 1, given), profile)

    def both(repeat: int, name: str) -> tuple[Record, Record]:
        field = DAMAGES[name][0]
        others = damage._replace(**{field: getattr(Damage(), field)})
        with_it, without = (record_of(test_on(0, given)._replace(seed=repeat), profiles[0])
                            for given in (damage, others))
        return with_it, without

    records = tuple(tested(profile) for profile in profiles)
    before = tuple(tested(profile, Damage()) for profile in profiles[:accepted])
    return HiddenUnit(names, without, records, tested, truth, both, before, kit)


def catalogued(a: Actuator, name: str, d: Damage) -> dict[str, float | str]:
    """Return a damage of the second simulator as the catalogue's law has it, dotted names.

    Empty where no parameter of the catalogue means the same.
    """
    phase = "abc"[d.phase]
    laws: dict[str, dict[str, float | str]] = {
        "turn_short": {"fraction": d.short, "phase": phase, "mode": "physical"},
        "rotor_eccentricity": {"zeta": d.eccentricity, "angle": d.angle,
                               "mode": "shifted" if d.shifted else "common"},
        "motor_friction": {"increase": d.motor_friction},
        "surface_friction": {"increase": d.surface_friction},
        "backlash": {"increase": d.backlash},
        "cogging_torque": {"amplitude": d.cogging, "periods": 6.0 * a.motor.pole_pairs,
                           "phase": 0.0},
        "torque_constant_drop": {"drop": d.demagnetisation},
        "bus_voltage_sag": {"resistance": d.sag},
        "phase_resistance_imbalance": {"increase": d.resistance, "phase": phase},
        "hall_misalignment": {"angle": d.hall},
        "gear_mesh_ripple": {"amplitude": d.mesh, "periods": 17.0, "phase": 0.0},
    }
    return {f"{name}.{field}": value for field, value in laws[name].items()}


def of_kit(kit: Path, make: Callable[..., HiddenUnit], *which: object, **how: object
           ) -> HiddenUnit:
    """Return a unit of the machine of a kit."""
    with using_kit(kit):
        unit = make(*which, kit=kit, **how)

    def again(profile: Profile) -> Record:
        with using_kit(kit):
            return unit.again(profile)

    return unit._replace(again=again)


STRATA: dict[str, partial[HiddenUnit]] = {
    "own, nothing": partial(own_unit, listed=True),
    "own, one effect": partial(own_unit, listed=True, hidden=1),
    "own, unlisted off, nothing": partial(own_unit),
    "own, unlisted off, one effect": partial(own_unit, hidden=1),
    "own, unlisted off, two effects": partial(own_unit, hidden=2),
    "own, bands x 1.3, nothing": partial(own_unit, bands=RANGE),
    "own, bands x 1.3, one effect": partial(own_unit, bands=RANGE, hidden=1),
    "second, bands x 1.3, nothing": partial(second_unit, bands=RANGE),
    "second, nothing": partial(second_unit),
    "second, one effect": partial(second_unit, hidden=1),
    "own, unlisted off, alike": partial(own_unit, hidden=1, only=ALIKE),
    "second, alike": partial(second_unit, hidden=1, only=ALIKE),
    "second, two effects": partial(second_unit, hidden=2),
    "second, outside the catalogue": partial(second_unit, hidden=1, strange=True),
    "own, two effects": partial(own_unit, listed=True, hidden=2),
    "own, outside the catalogue": partial(own_unit, listed=True, hidden=1, strange=True),
    "own, accepted, nothing": partial(own_unit, accepted=True),
    "own, accepted, then one effect": partial(own_unit, hidden=1, accepted=True),
    "second, accepted, nothing": partial(second_unit, accepted=True),
    "second, accepted, then one effect": partial(second_unit, hidden=1, accepted=True),
    "pwm, own, nothing": partial(of_kit, PWM, own_unit),
    "pwm, second, nothing": partial(of_kit, PWM, second_unit),
    "pwm, second, one effect": partial(of_kit, PWM, second_unit, hidden=1),
    "foc, own, nothing": partial(of_kit, FOC, own_unit),
    "foc, second, nothing": partial(of_kit, FOC, second_unit),
    "foc, second, one effect": partial(of_kit, FOC, second_unit, hidden=1),
}


def kit_of(stratum: str) -> Path | None:
    """Return the kit of a stratum's machine, None if it is the default one."""
    made = STRATA[stratum]
    return made.args[0] if made.func is of_kit else None
