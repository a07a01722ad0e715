"""Records without a defect: every unit, condition and fault that a good recorder may meet.

Both profiles, noise 0.5 to 2, -40 to 70 degC, +-19 N m, current sensors within +-1 % and
+-0.05 A, other serial numbers and start times; half with a fault of ours up to a large one,
the others with no, one or two effects of the catalogue at up to a quarter of their ranges. The
transducers of a good bag are good ones: effects of the port ``sensor`` stay out, but for those
tolerances.
"""

from __future__ import annotations

from random import Random

from ema_record.profile import load_profile
from ema_record.record import Record
from ema_sim.effects import EFFECTS, parse_effects
from ema_sim.effects.base import Quantity
from ema_sim.simulate import simulate

STRANGERS = sorted(
    name for name, effect in EFFECTS.items()
    if effect.port != "sensor" and name not in ("surface_load", "winding_temperature")
)


def conditions(rng: Random) -> list[str]:
    """Return the settings of one test's conditions."""
    found = [f"surface_load.constant={rng.uniform(-19.0, 19.0):.6g}",
             f"winding_temperature.temperature={rng.uniform(-40.0, 70.0):.6g}"]
    for phase in "abc":
        found += [f"current_sensor_gain.phase_{phase}={rng.uniform(-0.01, 0.01):.6g}",
                  f"current_sensor_offset.phase_{phase}={rng.uniform(-0.05, 0.05):.6g}"]
    return found


def fault(rng: Random) -> list[str]:
    """Return the settings of a fault of ours, small to large."""
    name = rng.choice(["turn_short", "rotor_eccentricity", "motor_friction", "surface_friction",
                       "backlash"])
    if name == "turn_short":
        return [f"turn_short.fraction={rng.uniform(0.0, 0.6):.6g}",
                f"turn_short.phase={rng.choice('abc')}",
                f"turn_short.mode={rng.choice(['paper', 'physical'])}"]
    if name == "rotor_eccentricity":
        mode = rng.choice(["paper", "common", "shifted", "static"])
        return [f"rotor_eccentricity.zeta={rng.uniform(-0.4, 0.4):.6g}",
                f"rotor_eccentricity.mode={mode}"]
    largest = {"motor_friction": 1.5, "surface_friction": 3.0, "backlash": 0.01}[name]
    return [f"{name}.increase={rng.uniform(0.0, largest):.6g}"]


def strangers(rng: Random) -> list[str]:
    """Return settings of no, one or two effects of moderate size."""
    settings: list[str] = []
    for name in rng.sample(STRANGERS, rng.choice([0, 1, 1, 2])):
        for field in EFFECTS[name].fields:
            if isinstance(field.kind, Quantity):
                default = float(field.default)
                edge = field.kind.upper if rng.random() < 0.7 else field.kind.lower
                value = default + rng.uniform(0.0, 0.25) * (edge - default)
                settings.append(f"{name}.{field.name}={value:.6g}")
    return settings


def good_record(rng: Random) -> tuple[Record, list[str]]:
    """Return a record without a defect and what is in it."""
    settings = [*conditions(rng), *(fault(rng) if rng.random() < 0.5 else strangers(rng))]
    record = simulate(
        load_profile(rng.choice(["step", "extended"])), effects=parse_effects(settings),
        seed=rng.randrange(1 << 30), noise=rng.uniform(0.5, 2.0),
        serial_number=f"EMA-{rng.randrange(999):03}",
        start_time=1_790_000_000 * 10**9 + rng.randrange(10**15),
    )
    return record, settings
