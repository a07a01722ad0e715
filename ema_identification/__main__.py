"""Make libraries of `ema identify` for the present kit: ``python -m ema_identification TEST...``.

They are put into the kit's folder, in place of those of the same tests, with what healthy units
leave beside their own earlier records, on two tests together, and on each test when another one
was fitted. So the shipped ones are made: ``python -m ema_identification step extended``, some
minutes of one core. One that the present code would make, though another made it, is signed anew.
"""

from __future__ import annotations

import argparse
from itertools import permutations
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.decision.joint import joint_unit
from ema_identification.actuator.decision.proposals import scores
from ema_identification.actuator.gap import HeldOut
from ema_identification.actuator.library.baseline import with_baselines
from ema_identification.actuator.library.build import MADE_BY, fleet_library
from ema_identification.actuator.measure.tolerances import conditions_of
from ema_record import array_cache as cache
from ema_record.errors import EmaError
from ema_record.kit import LIBRARY, kit_path
from ema_record.profile import load_profile
from ema_sim.model_file import load_model_file


def main() -> None:
    """Build what is not there and would not be made by this code; remove what it replaces."""
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
            before = _libraries(folder, profile.name)
            library = fleet_library(load_model_file(), profile, workers=given.workers,
                                    folder=folder)
            now, key = _libraries(folder, profile.name), cache.key_of(module=MADE_BY)
            if built := [path for path, kept in now.items() if str(kept["made_by"]) == key
                         and str(before.get(path, {}).get("made_by")) != key]:
                for path in set(before) - set(built) | {
                        path for what in ("changed", "gaps", "joint")
                        for path in folder.glob(f"{what}*.npz")}:
                    path.unlink()
            for path, kept in now.items():
                if not built and str(kept["made_by"]) != key:  # the present code makes the same
                    cache.save(path.stem, kept | {"made_by": np.array(key)}, folder,
                               compressed=True)
            row, values = (known[0] for known in library.aside)
            units.append(TestedUnit(library=library, values=values, conditions=conditions_of(row)))
        for unit in units:
            with_baselines(unit.library, workers=given.workers, folder=folder)
        for first, second in permutations(units, 2):
            HeldOut(unit=first, fitted=second).kept(folder)
            joint_unit([first, second], scores, folder)


def _libraries(folder: Path, test: str) -> dict[Path, dict[str, np.ndarray]]:
    """Return what is kept of the libraries of a test."""
    found = {path: cache.load(path.stem, folder) for path in folder.glob("library_*.npz")}
    return {path: kept for path, kept in found.items() if kept and str(kept.get("test")) == test}


if __name__ == "__main__":
    main()
