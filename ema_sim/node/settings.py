"""The parameters of the simulator node, and the actuator that they describe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from ema_record.actuator import Actuator
from ema_record.profile import load_profile, profile_names
from ema_record.wire.views import ViewDecimator
from ema_ros.parameters import KIT, ParameterSpec, Value
from ema_sim.effects.base import Choice
from ema_sim.effects.registry import EFFECTS, Effects
from ema_sim.effects.settings import effects_from_mapping
from ema_sim.model_file import Model
from ema_sim.session import NOISE_LEVELS, RATES, ActuatorSession

BLOCK_TIME = 0.02
"""Of the samples in a message (s)."""
BLOCK_SIZES = (10, 2000)
"""Least and most samples in a message."""
FIRST_TEST = "extended"
MODEL_FILE = ParameterSpec(
    name="model_file", default="", read_only=True,
    text="YAML file with actuator parameters, changes over the kit's, and effects; empty: none",
)

_FIXED = (
    KIT,
    MODEL_FILE,
    ParameterSpec(
        name="serial_number", default="SIM-0000", read_only=True, text="of the actuator",
    ),
    ParameterSpec(
        name="seed", default=0, lower=0, upper=2**31 - 1, read_only=True,
        text="of sensor noise and start angle: the same seed gives the same samples",
    ),
    ParameterSpec(
        name="noise", default=1.0, lower=NOISE_LEVELS[0], upper=NOISE_LEVELS[1], unit="1",
        text="factor on the sensor noise",
    ),
    ParameterSpec(
        name="switching", default=False, read_only=True,
        text="simulate the edges of a carrier (drives pwm and foc), not the means of its periods",
    ),
    ParameterSpec(
        name="real_time_factor", default=1.0, lower=0.0, upper=1000.0, unit="1",
        text="simulated seconds a second; 0: as fast as possible",
    ),
)


def parameter_specs(model: Model) -> list[ParameterSpec]:
    """Return all parameters of the node; the model gives defaults and the surface's travel."""
    stop = model.actuator.surface.end_stop
    size = round(BLOCK_TIME * model.actuator.acquisition.rate)
    specs = [
        *_FIXED,
        ParameterSpec(
            name="rate", default=model.actuator.acquisition.rate, lower=RATES[0],
            upper=RATES[1], unit="1/s", read_only=True, text="samples a second",
        ),
        ParameterSpec(
            name="block_size", default=min(max(size, BLOCK_SIZES[0]), BLOCK_SIZES[1]),
            lower=BLOCK_SIZES[0], upper=BLOCK_SIZES[1], read_only=True,
            text="samples a message of /ema/samples",
        ),
        ParameterSpec(
            name="initial_position", default=max(_start_of_tests(), -stop),
            lower=-stop, upper=stop, unit="rad", read_only=True,
            text="surface position at the start of the node",
        ),
    ]
    for name, effect in EFFECTS.items():
        for field in effect.fields:
            value = getattr(getattr(model.effects, name), field.name)
            kind = field.kind
            dotted = f"{name}.{field.name}"
            text = f"{effect.summary.rstrip('.')}: {kind.text}"
            if isinstance(kind, Choice):
                specs.append(ParameterSpec(
                    name=dotted, default=kind.options[int(value)], text=text,
                    options=kind.options,
                ))
            else:
                specs.append(ParameterSpec(
                    name=dotted, default=float(value), text=text, unit=kind.unit,
                    lower=kind.lower, upper=kind.upper,
                ))
    return specs


def _start_of_tests() -> float:
    """Return where the kit's test ``extended`` begins (rad), else its first one; 0 without any."""
    names = sorted(profile_names(), key=lambda name: (name != FIRST_TEST, name))
    return load_profile(names[0]).start if names else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatorSettings:
    """What the parameters of the node say."""

    actuator: Actuator
    effects: Effects
    serial_number: str
    seed: int
    noise: float
    rate: float
    switching: bool
    block_size: int
    real_time_factor: float
    initial_position: float

    def decimator(self) -> ViewDecimator:
        """Return what makes the decimated topics of one run."""
        return ViewDecimator(self.rate, self.actuator.acquisition.view_rate)

    def session(self, position: float) -> ActuatorSession:
        """Return the actuator at rest at `position` (rad)."""
        return ActuatorSession(
            self.actuator, self.effects, seed=self.seed, noise=self.noise, rate=self.rate,
            position=position, switching=self.switching,
        )


def settings_from(values: Mapping[str, Value], model: Model) -> SimulatorSettings:
    """Return the settings of checked parameter values (all of `parameter_specs`)."""
    effects = effects_from_mapping(
        {name: value for name, value in values.items() if "." in name}, model.effects)
    own: dict[str, Any] = {
        f.name: values[f.name] for f in fields(SimulatorSettings) if f.name in values}
    return SimulatorSettings(actuator=model.actuator, effects=effects, **own)
