"""The six machines of the benchmark, and their kits."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final, NamedTuple

from ema_record.actuator import Actuator, load_actuator
from ema_record.errors import EmaError
from ema_record.kit import ACTUATOR, CASCADE, using_kit
from ema_record.profile import Profile
from ema_record.spread import TypeSpread, load_spread

FOLDER = Path(__file__).parent / "machines"
TEST_NAME: Final = "extended"


class BenchMachine(NamedTuple):
    """One type of actuator."""

    name: str
    actuator: Actuator
    spread: TypeSpread

    @property
    def description(self) -> Path:
        """Its file."""
        return FOLDER / self.name / ACTUATOR


def machine_names() -> list[str]:
    """Return the names of the machines, in order."""
    return sorted(path.parent.name for path in FOLDER.glob(f"*/{ACTUATOR}"))


def load_machine(name: str) -> BenchMachine:
    """Return the machine of that name."""
    with using_kit(FOLDER / name):
        return BenchMachine(name, load_actuator(), load_spread())


def default_test(a: Actuator) -> Profile:
    """Return the test that the product makes for an actuator."""
    from ema_record.profiles.design import default_profiles

    return default_profiles(a)[TEST_NAME]


def commission_kit(machine: BenchMachine, records: list[Path], kit: Path, *, quick: bool,
                   jobs: int) -> dict[str, object]:
    """Make the kit of a machine from acceptance records, as `ema commission` does.

    Returns
    -------
    How long it took (s), and why there is no kit; empty: there is one.
    """
    from ema_prognostics.commission.commission import commission

    if (kit / CASCADE).is_file():
        return {"seconds": None, "refused": ""}
    started, refused = time.monotonic(), ""
    try:
        commission(records, machine.description, kit, quick=quick, jobs=jobs)
    except EmaError as error:
        refused = str(error)
    return {"seconds": time.monotonic() - started, "refused": refused}
