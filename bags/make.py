"""Make the example bags of this folder: ``python bags/make.py [FOLDER]``.

Each is `ema simulate` with the options in the table of README.md, the long ones without the
decimated topics for people. What was hidden is named here and there, never in a bag. Bags that
exist are never overwritten.
"""

from __future__ import annotations

import sys
from pathlib import Path

from ema_record.bag.read import write_bag
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate

START_TIME = 1_790_000_000_000_000_000
"""Acceptance of the first test (ns since the epoch): fixed, so that bags can be repeated."""
PROFILES = ("step", "extended")
HIDDEN: dict[str, tuple[str, ...]] = {
    "healthy": (),
    "turn_short": ("turn_short.fraction=0.1", "turn_short.phase=b"),
    "rotor_eccentricity": ("rotor_eccentricity.zeta=0.04", "rotor_eccentricity.mode=paper"),
    "friction": ("motor_friction.increase=0.6",),
    "backlash": ("backlash.increase=0.002",),
    "model_gap": (
        "stribeck_friction.increase=0.8", "stribeck_friction.speed=12",
        "surface_load.constant=11", "winding_temperature.temperature=41",
        "bus_voltage_change.change=-0.04",
    ),
}
"""What is hidden in each actuator; its place is the serial number and the seed."""
WITH_VIEWS = ("step",)
"""Profiles whose bags keep the decimated topics: all of them would be 10 MB."""


def bag_name(seed: int, profile: str) -> str:
    """Return the name of a bag, which does not tell either."""
    return f"sim_{seed:04d}_{profile}"


def commands() -> dict[str, list[str]]:
    """Return the `ema` arguments that make each bag, by its name."""
    found = {}
    for seed, effects in enumerate(HIDDEN.values()):
        for profile in PROFILES:
            name = bag_name(seed, profile)
            found[name] = ["simulate", "--profile", profile, "--seed", str(seed),
                           "--serial-number", f"SIM-{seed:04d}"]
            for effect in effects:
                found[name] += ["--effect", effect]
            found[name] += ["--out", f"bags/{name}"]
    return found


def main(folder: Path) -> None:
    """Make all bags in `folder`."""
    for seed, effects in enumerate(HIDDEN.values()):
        for index, profile in enumerate(PROFILES):
            record = simulate(
                load_profile(profile), effects=parse_effects(effects), seed=seed,
                serial_number=f"SIM-{seed:04d}",
                start_time=START_TIME + (10 * seed + index) * 60 * 10**9,
            )
            path = folder / bag_name(seed, profile)
            views = profile in WITH_VIEWS
            print(write_bag(record, path, views=views))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent)
