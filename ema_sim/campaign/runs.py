"""From a plan to single runs: what run number `index` of a campaign is, alone."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple, get_args, get_type_hints

import numpy as np

from ema_record.actuator import PARTS, Actuator
from ema_record.actuator_type import actuator_hash
from ema_record.errors import UsageError, bounded, unknown_name
from ema_record.profile import Profile, load_profile
from ema_record.record import Record
from ema_sim.campaign.distributions import Distribution, Value, stream
from ema_sim.campaign.plan import CampaignPlan
from ema_sim.effects.base import Choice
from ema_sim.effects.registry import EFFECTS, Effects
from ema_sim.effects.settings import effects_from_mapping
from ema_sim.model_file import load_model_file
from ema_sim.session import NOISE_LEVELS
from ema_sim.simulate import simulate

ACTUATOR = "actuator"
GENERAL = {"noise": NOISE_LEVELS, "start_angle": (0.0, 2.0 * math.pi)}
"""Parameters of a run that belong to no part, with their bounds."""
MAX_POINTS = 1_000_000
"""Most combinations of the grids."""


class ParameterBounds(NamedTuple):
    """What a parameter may be."""

    lower: float
    upper: float
    unit: str
    whole: bool = False
    options: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One run of a campaign: the arguments of `simulate`."""

    index: int
    seed: int
    profile: Profile
    actuator: Actuator
    effects: Effects
    noise: float
    start_angle: float | None
    rate: float | None
    switching: bool
    kit: str
    """Hash of the kit's actuator, see `Provenance.actuator`."""
    drawn: Mapping[str, Value]
    """What the plan names, by dotted name, relative ones multiplied out."""

    def simulate(self) -> Record:
        """Make the run."""
        record = simulate(
            self.profile, actuator=self.actuator, effects=self.effects, seed=self.seed,
            noise=self.noise, rate=self.rate, start_angle=self.start_angle,
            serial_number=f"SIM-{self.index:04d}", switching=self.switching,
        )
        return replace(record, provenance=replace(record.provenance, actuator=self.kit))


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """A plan with everything that it names loaded and checked; it can be sent to workers."""

    plan: CampaignPlan
    profiles: tuple[Profile, ...]
    actuator: Actuator
    effects: Effects
    runs: int
    kit: str
    """Hash of the kit's actuator."""

    def run(self, index: int) -> Run:
        """Return run number `index`; it depends on the plan and the index only."""
        place, point = index, {}
        for name, values in self._axes():
            point[name] = values[place % len(values)]
            place //= len(values)
        plan, drawn = self.plan, {}
        for name, setting in plan.parameters.items():
            if not isinstance(setting, Distribution):
                value: Value = setting
            elif setting.grid is not None:
                value = point[name]
            else:
                value = self._draw(name, setting, index)
            drawn[name] = self._absolute(name, setting, value)
        actuator, effects = _apply(self.actuator, self.effects, drawn)
        angle = drawn.get("start_angle")
        return Run(
            index=index,
            seed=int(stream(plan.seed, index, "seed").generate_state(1, np.uint64)[0] >> 1),
            profile=self.profiles[int(point[""])],
            actuator=actuator,
            effects=effects,
            noise=float(drawn.get("noise", 1.0)),
            start_angle=None if angle is None else float(angle),
            rate=plan.rate,
            switching=plan.switching,
            kit=self.kit,
            drawn=drawn,
        )

    def digest(self) -> str:
        """Return a hash of all that decides the runs: the plan and the files that it names."""
        content = {
            "plan": self.plan.model_dump(mode="json", exclude={"name", "profile", "model"}),
            "runs": self.runs,
            "profiles": [p.model_dump(mode="json") for p in self.profiles],
            "actuator": self.actuator,
            "effects": self.effects,
            "kit": self.kit,
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def _axes(self) -> list[tuple[str, tuple[Value, ...]]]:
        grids: list[tuple[str, tuple[Value, ...]]] = [("", tuple(range(len(self.profiles))))]
        for name, setting in self.plan.parameters.items():
            if isinstance(setting, Distribution) and setting.grid is not None:
                grids.append((name, setting.grid))
        return grids

    def _absolute(self, name: str, setting: object, value: Value) -> Value:
        if isinstance(setting, Distribution) and setting.relative:
            return float(value) * _nominal(self.actuator, name)
        return int(value) if bounds_of(name).whole else value

    def _draw(self, name: str, setting: Distribution, index: int) -> Value:
        rng = np.random.Generator(np.random.PCG64(stream(self.plan.seed, index, name)))
        bounds = bounds_of(name)
        scale = _nominal(self.actuator, name) if setting.relative else 1.0
        try:
            return setting.draw(rng, *sorted((bounds.lower / scale, bounds.upper / scale)))
        except ValueError as error:
            raise UsageError(
                f"parameter {name}: {error}: move the mean or narrow the deviation"
            ) from None


def prepare(plan: CampaignPlan) -> Campaign:
    """Load what a plan names and check every value that it can give.

    Raises
    ------
    UsageError
        An unknown name, a value out of bounds, a grid too large.
    """
    profiles = tuple(load_profile(name) for name in plan.profile)
    model = load_model_file(plan.model)
    points = len(profiles)
    for name, setting in plan.parameters.items():
        _check(name, setting, model.actuator)
        if isinstance(setting, Distribution) and setting.grid is not None:
            points *= len(setting.grid)
    if points > MAX_POINTS:
        raise UsageError(f"the grids have {points} combinations, at most {MAX_POINTS}: thin them")
    varies = any(isinstance(s, Distribution) and s.grid is None for s in plan.parameters.values())
    if plan.runs is None and (varies or points == 1):
        raise UsageError("runs: how many is not said: give 'runs: 1000'")
    return Campaign(
        plan=plan, profiles=profiles, actuator=model.actuator, effects=model.effects,
        runs=plan.runs if plan.runs is not None else points, kit=actuator_hash(),
    )


@cache
def bounds_of(name: str) -> ParameterBounds:
    """Return the bounds of a parameter, by dotted name."""
    if name in GENERAL:
        return ParameterBounds(*GENERAL[name], "times nominal" if name == "noise" else "rad")
    part, _, parameter = name.partition(".")
    if part == ACTUATOR:
        return _actuator_bounds(parameter)
    if part not in EFFECTS:
        raise unknown_name(
            "parameter", name, [*GENERAL, *(f"{e}.{s}" for e in EFFECTS
                                            for s in EFFECTS[e].severity)],
            "give actuator.<part>.<name>, <effect>.<parameter>, noise or start_angle",
        )
    fields = {f.name: f for f in EFFECTS[part].fields}
    if parameter not in fields:
        raise unknown_name(f"parameter of effect {part}", parameter, fields,
                           "'ema effects' lists them")
    kind = fields[parameter].kind
    if isinstance(kind, Choice):
        return ParameterBounds(-math.inf, math.inf, "", options=kind.options)
    return ParameterBounds(kind.lower, kind.upper, kind.unit)


def _actuator_bounds(name: str) -> ParameterBounds:
    part, _, parameter = name.partition(".")
    if part not in PARTS:
        raise unknown_name("part of the actuator", part, PARTS, "see config/actuator.yaml")
    hints = get_type_hints(PARTS[part], include_extras=True)
    if parameter not in hints:
        raise unknown_name(f"parameter of actuator.{part}", parameter, hints,
                           "see config/actuator.yaml")
    kind, *notes = get_args(hints[parameter])
    field = next(note for note in notes if hasattr(note, "json_schema_extra"))
    marks, extra = field.metadata, field.json_schema_extra
    if "choices" in extra:
        return ParameterBounds(-math.inf, math.inf, "", options=tuple(extra["choices"]))
    lower = next(float(m.ge) for m in marks if hasattr(m, "ge"))
    upper = next(float(m.le) for m in marks if hasattr(m, "le"))
    return ParameterBounds(lower, upper, extra["unit"], whole=kind is int)


def _check(name: str, setting: Distribution | Value, actuator: Actuator) -> None:
    """Raise UsageError unless all that `setting` can give is within the bounds."""
    bounds = bounds_of(name)
    relative = isinstance(setting, Distribution) and setting.relative
    if relative and not name.startswith(f"{ACTUATOR}."):
        raise UsageError(f"parameter {name}: relative serves only actuator.<part>.<name>")
    listed = not isinstance(setting, Distribution) or setting.kind in ("choice", "grid")
    if (bounds.options or bounds.whole) and not listed:
        raise UsageError(
            f"parameter {name}: {'a named option' if bounds.options else 'a whole number'}: "
            "give a choice or a grid"
        )
    if relative and bounds.options:
        raise UsageError(f"parameter {name}: relative serves only numbers")
    scale = _nominal(actuator, name) if relative else 1.0
    if scale == 0.0:
        raise UsageError(f"parameter {name}: 0 by itself, relative to which all is 0: leave "
                         "'relative' out and give values")
    for value in setting.extremes if isinstance(setting, Distribution) else (setting,):
        if bounds.options:
            if str(value) not in bounds.options:
                raise unknown_name(name, str(value), bounds.options,
                                   f"choose one of {', '.join(bounds.options)}")
            continue
        number = _number(name, value) * scale
        if bounds.whole and number != int(number):
            raise UsageError(f"parameter {name}: {number:g} is not a whole number")
        bounded(f"parameter {name}", number, bounds.lower, bounds.upper, bounds.unit)


def _number(name: str, value: Value) -> float:
    try:
        number = float(value)
    except (ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise UsageError(f"parameter {name}: {str(value)[:60]!r} is not a number")
    return number


def _nominal(actuator: Actuator, name: str) -> float:
    _, part, parameter = name.split(".")
    return float(getattr(getattr(actuator, part), parameter))


def _apply(
    actuator: Actuator, effects: Effects, drawn: Mapping[str, Value]
) -> tuple[Actuator, Effects]:
    settings = {}
    for name, value in drawn.items():
        first, _, rest = name.partition(".")
        if first == ACTUATOR:
            part, _, parameter = rest.partition(".")
            bounds = bounds_of(name)
            if bounds.options:
                number: float = bounds.options.index(str(value))
            else:
                number = int(value) if bounds.whole else float(value)
            changed = getattr(actuator, part)._replace(**{parameter: number})
            actuator = actuator._replace(**{part: changed})
        elif name not in GENERAL:
            settings[name] = value
    return actuator, effects_from_mapping(settings, effects) if settings else effects
