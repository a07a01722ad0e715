"""Make libraries of `ema identify` for the present kit: ``python -m ema_identification TEST...``.

They are put into the kit's folder, in place of those of the same tests, with what healthy units
leave beside their own earlier records, on two tests together, and on each test when another one
was fitted. So the shipped ones are made: ``python -m ema_identification step extended``, some
minutes of one core.
"""

from __future__ import annotations

import argparse
from itertools import permutations

from threadpoolctl import threadpool_limits

from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.decision.joint import joint_unit
from ema_identification.actuator.decision.proposals import scores
from ema_identification.actuator.fleet.units import FULL, conditions_of
from ema_identification.actuator.gap import HeldOut
from ema_identification.actuator.library.baseline import with_baselines
from ema_identification.actuator.library.build import fleet_library
from ema_record import array_cache as cache
from ema_record.errors import EmaError
from ema_record.kit import LIBRARY, kit_path
from ema_record.profile import load_profile
from ema_sim.model_file import load_model_file


def main() -> None:
    """Build what is not there and of this code; remove what it replaces."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("tests", nargs="+", help="names or files of profiles")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    folder = kit_path(LIBRARY)
    try:
        profiles = [load_profile(test) for test in given.tests]
    except EmaError as error:
        parser.error(str(error))
    units = []
    with threadpool_limits(limits=1):  # as `identify` makes it
        for profile in profiles:
            before = {p: cache.load(p.stem, folder) for p in folder.glob("library_*.npz")}
            library = fleet_library(load_model_file(), profile, workers=given.workers,
                                    folder=folder)
            now = set(folder.glob("library_*.npz"))
            for path, kept in before.items():
                if now - set(before) and kept and str(kept.get("test")) == profile.name:
                    path.unlink()
            row, values = (known[0] for known in library.aside)
            units.append(TestedUnit(library=library, values=values, conditions=conditions_of(row)))
        for path in (path for what in ("changed", "gaps", "joint")
                     for path in folder.glob(f"{what}*.npz")):
            path.unlink()
        for unit in units:
            with_baselines(unit.library, FULL, workers=given.workers, folder=folder)
        for first, second in permutations(units, 2):
            HeldOut(unit=first, fitted=second).kept(folder)
            joint_unit([first, second], scores, folder)


if __name__ == "__main__":
    main()
