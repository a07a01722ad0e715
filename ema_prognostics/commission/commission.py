"""`commission`: a kit from a description of an actuator and records of healthy units.

Draft with the description and its tests; recorder measured; model corrected; fleet simulated
around it; discrepancy; cascade trained and validated on other simulated units and, leaving one
unit out, on the acceptance records. The kit gets its name only when all is done and good enough;
the work of a run that was stopped is kept beside it and taken up.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ema_prognostics.cascade.find import Cascade
from ema_prognostics.cascade.model_body import DiscrepancyPart, View, ViewPart
from ema_prognostics.cascade.model_file import Body, model_of, save_model
from ema_prognostics.commission.acceptance import (
    Acceptance,
    measured_recorder,
    read_acceptance,
)
from ema_prognostics.commission.bound import linear_bound
from ema_prognostics.commission.calibrate import Calibration, calibrate, wider
from ema_prognostics.commission.discrepancy import (
    expected,
    fit_discrepancy,
    widened,
    with_discrepancy,
)
from ema_prognostics.commission.draft import MARK, make_draft, own_draft
from ema_prognostics.commission.quality import (
    check_described,
    check_good,
    fleet_spread,
    judge_left_out,
    largest,
    too_many_alarms,
)
from ema_prognostics.commission.report import report_page
from ema_prognostics.features.vector import steady
from ema_prognostics.training.evaluation import evaluated
from ema_prognostics.training.faults import draw_stranger
from ema_prognostics.training.fleet import (
    DrawFault,
    DrawType,
    FleetFeatures,
    draw_of_mix,
    simulate_fleets,
)
from ema_prognostics.training.rates import rate
from ema_prognostics.training.train_model import (
    VALIDATION_SEED,
    VIEWS,
    Progress,
    TrainingFleets,
    TrainingSettings,
)
from ema_prognostics.training.view_training import sound_rows, stricter, train_view
from ema_record.actuator import FORMERLY, Actuator, load_actuator
from ema_record.actuator_type import actuator_hash, actuator_hashes
from ema_record.data_sheet.new_kit import with_values
from ema_record.errors import EmaError, OutputError
from ema_record.files import exists
from ema_record.kit import ACTUATOR, CASCADE, LIBRARY, REPORT, VALIDATION, using_kit
from ema_record.record import Record
from ema_record.spread import UnitTolerances, load_spread
from ema_record.version import VERSION
from ema_sim.effects import Effects
from ema_sim.model_file import Model

FULL = TrainingSettings(units=700, healthy=900, strangers=350, validation=150,
                        validation_healthy=400, validation_strangers=50)
QUICK = TrainingSettings(units=120, healthy=200, strangers=60, validation=40, hidden=12,
                         validation_healthy=100, validation_strangers=10, iterations=120)
ALARMS = 5e-4
"""Most of the rate of false alarms of a family on its own fleet: one of some 1800 healthy tests,
the least that these tell. A type is known from few units, and one at an end of its tolerances is
there in all its tests: a small error of the model moves it over a threshold."""
SPREAD_UNITS = 48
"""Healthy units from which the scatter of the features is read before the model is corrected."""
LIBRARY_SHARE = 0.80, 0.98
"""Of the whole, for the library; it has so many parts."""
MakeLibrary = Callable[[Sequence[Record], Path, Progress], bool]
"""Keeps in a folder what such records tell of the type for `ema identify`, and makes the present
kit's library, or leaves that to its first use; returns which. Goes on where it was."""


def commission(
    paths: Sequence[str | Path], description: str | Path, out: str | Path, *, quick: bool = False,
    seed: int = 1, jobs: int = -1, progress: Progress = lambda _what, _part: None,
    library: MakeLibrary | None = None,
) -> dict[str, Any]:
    """Make a kit; return what its `validation.json` holds.

    Parameters
    ----------
    paths : acceptance records: bags of healthy units.
    description : `actuator.yaml` of the type, for example of `ema new-actuator`.
    out : folder of the new kit.
    quick : a small training, to try the way.
    seed : of the training.
    jobs : processes that simulate, -1 for all cores.
    progress : called with what goes on and how much of the whole is done, 0 to 1.
    library : makes the library for `ema identify`; None: nothing is kept for it.

    Raises
    ------
    UsageError
        The records cannot serve, the model does not describe them, or the kit would not be good
        enough; nothing stands under the name `out` then.
    OutputError
        `out` exists or cannot be written.
    """
    target = Path(out)
    if os.path.lexists(target):
        raise exists(target)
    draft = target.with_name(target.name + ".unfinished")
    progress("reading the description", 0.0)
    with own_draft(draft):
        try:
            make_draft(Path(description), draft)
            with using_kit(draft):
                actuator = load_actuator()
                acceptance = read_acceptance(paths, actuator)
                found = _Work(acceptance, draft, quick=quick, seed=seed, jobs=jobs,
                              progress=progress, library=library).run(actuator)
        except EmaError:
            if not (draft / "work").is_dir():  # nothing that a second run could take up
                shutil.rmtree(draft, ignore_errors=True)
            raise
        shutil.rmtree(draft / "work", ignore_errors=True)
        (draft / MARK).unlink(missing_ok=True)
        try:
            draft.rename(target)
        except OSError as error:
            raise OutputError(f"{target}: {error.strerror or error}: the kit is {draft}") from None
    return found


class _Work:
    """One commissioning at work."""

    def __init__(self, acceptance: Acceptance, draft: Path, *, quick: bool, seed: int, jobs: int,
                 progress: Progress, library: MakeLibrary | None) -> None:
        self._acceptance, self._draft = acceptance, draft
        self._size = QUICK if quick else FULL
        self._quick, self._seed, self._jobs = quick, seed, jobs
        self._progress, self._library = progress, library
        self._folder = draft / "work"

    def run(self, described: Actuator) -> dict[str, Any]:
        """Return what `validation.json` holds; the files of the kit are written."""
        kind = self._acceptance.kind
        recorder = measured_recorder(
            described, self._acceptance.records, load_spread().conditions)
        self._write_actuator(recorder)
        described_fleet = self._fleet(recorder, "spread of the type", SPREAD_UNITS,
                                      self._seed + 2, healthy=True, begin=0.0, end=0.02)
        tolerances = load_spread().tolerances
        calibration = calibrate(
            self._acceptance, recorder, described_fleet, tolerances, seed=self._seed,
            jobs=self._jobs,
            progress=lambda part: self._progress("correcting the model", 0.02 + 0.13 * part))
        self._write_actuator(calibration.actuator)
        actuator = load_actuator()  # the numbers as they are written
        size = self._size
        fleets = self._fleets(calibration, "trains", (size.units, size.healthy, size.strangers),
                              self._seed, 0.15, 0.58)
        held = self._fleets(
            calibration, "validates",
            (size.validation, size.validation_healthy, size.validation_strangers),
            self._seed + VALIDATION_SEED, 0.58, 0.70)
        healthy = fleets.healthy
        (names, rows), units = self._acceptance.features(actuator), self._acceptance.units
        model, spread = expected(healthy, names, rows), fleet_spread(names, healthy)
        check_described(names, rows := steady(names, rows, model), model, spread)
        discrepancy = fit_discrepancy(names, rows, units, model, spread)
        self._progress("training", 0.70)
        views = self._views(fleets, discrepancy)
        held = TrainingFleets(*(with_discrepancy(f, discrepancy, self._seed + 1) for f in held))
        held_out: dict[str, Any] = {kind: evaluated(views, held)}
        if strict := too_many_alarms(held_out[kind]):
            # Thresholds of all healthy tests so far, judged on units that set none.
            views = self._stricter(views, discrepancy, healthy, held.healthy)
            again = self._fleet(
                actuator, "another healthy fleet", self._size.validation_healthy,
                self._seed + 2 * VALIDATION_SEED, healthy=True, begin=0.78, end=0.80,
                draw_type=calibration.draw)
            held = held._replace(healthy=with_discrepancy(again, discrepancy, self._seed + 2))
        accepted, factors = judge_left_out(
            Cascade(views["fleet"]), names, rows, units, model, spread)
        if max(factors) > 1.0:
            views["fleet"] = widened(views["fleet"], *factors)
        if strict or max(factors) > 1.0:  # the rates are those of the kit as it is
            held_out = {kind: evaluated(views, held)}
        self._write_actuator(
            calibration.actuator, wider(tolerances, calibration.actuator, calibration.open))
        found = self._validation(calibration, held_out, accepted, discrepancy)
        found["guard_widened"], found["strangers_widened"] = factors
        found["stricter"] = strict
        found["bound"] = {"fleet": linear_bound(fleets.faults, healthy, own=False),
                          "baseline": linear_bound(fleets.faults, healthy, own=True)}
        check_good(found)
        body = Body(
            views={f"{kind}/{view}": part for view, part in views.items()}, paper=None,
            discrepancy={kind: discrepancy}, actuator=actuator_hash(),
            training={"seed": self._seed, "quick": self._quick, "software_version": VERSION,
                      "settings": asdict(self._size), "held_out": held_out},
        )
        found["library"] = self._make_library()
        self._progress("writing the kit", 0.98)
        (self._draft / CASCADE).unlink(missing_ok=True)
        model_file = model_of(body)
        save_model(model_file, self._draft / CASCADE)
        found["cascade_sha256"] = model_file.sha256
        (self._draft / VALIDATION).write_text(json.dumps(found, indent=1), encoding="utf-8")
        (self._draft / REPORT).write_text(
            report_page(found), encoding="utf-8", errors="backslashreplace")
        return found

    def _make_library(self) -> bool:
        """Make the kit's library for such records as the first; return whether one is made."""
        if self._library is None:
            return False
        begin, end = LIBRARY_SHARE
        return self._library(self._acceptance.records, self._draft / LIBRARY, lambda what, share:
                             self._progress(what, begin + (end - begin) * share))

    def _write_actuator(self, actuator: Actuator, tolerances: UnitTolerances | None = None
                        ) -> None:
        """Write the description with other values; the hashes of what it was are kept with it."""
        file = self._draft / ACTUATOR
        former = actuator_hashes()
        text = with_values(file.read_text(encoding="utf-8"), actuator, tolerances)
        text = re.sub(rf"^{FORMERLY}:.*\n?([ -].*\n?)*", "", text, flags=re.MULTILINE)
        text = text.rstrip("\n") + (
            f"\n{FORMERLY}: {json.dumps(list(former))}  # of the records taken with it\n")
        file.write_text(text, encoding="utf-8")

    def _fleet(self, actuator: Actuator, what: str, units: int, seed: int, *, begin: float,
               end: float, healthy: bool = False, draw: DrawFault = draw_of_mix,
               draw_type: DrawType | None = None) -> FleetFeatures:
        kind = self._acceptance.kind
        return simulate_fleets(
            (kind,), units, seed, healthy=healthy, draw=draw, draw_type=draw_type,
            jobs=self._jobs, folder=self._folder, model=Model(actuator, Effects()),
            progress=lambda k, n: self._progress(
                f"{what}, {k} of {n} units", begin + (end - begin) * k / n))[kind]

    def _fleets(self, calibration: Calibration, what: str, units: Sequence[int], seed: int,
                begin: float, end: float) -> TrainingFleets:
        """Return fleets that do `what`, of so many units: with faults, healthy, strangers."""
        found, done = [], 0
        for name, count, draw in zip(("with faults", "healthy", "of strangers"), units,
                                     (draw_of_mix, draw_of_mix, draw_stranger)):
            share = (end - begin) / sum(units)
            found.append(self._fleet(
                load_actuator(), f"fleet {name} that {what}", count, seed,
                healthy=name == "healthy", begin=begin + share * done,
                end=begin + share * (done + count), draw=draw, draw_type=calibration.draw))
            done += count
        return TrainingFleets(*found)

    def _views(self, fleets: TrainingFleets, discrepancy: DiscrepancyPart
               ) -> dict[View, ViewPart]:
        faults, healthy, strange = (with_discrepancy(f, discrepancy, self._seed) for f in fleets)
        parts: dict[View, ViewPart] = {}
        for at, view in enumerate(VIEWS):
            parts[view] = train_view(
                faults, healthy, self._acceptance.kind, view, seed=self._seed, strangers=strange,
                hidden=self._size.hidden, iterations=self._size.iterations, alarms=ALARMS,
                progress=lambda what, v=view, a=at: self._progress(  # type: ignore[misc]
                    f"network {what}, {v}", 0.70 + 0.05 * a))
        return parts

    def _stricter(self, views: dict[View, ViewPart], discrepancy: DiscrepancyPart,
                  healthy: FleetFeatures, held: FleetFeatures) -> dict[View, ViewPart]:
        """Return views that healthy tests, those that validated among them, pass more often."""
        fleets = with_discrepancy(healthy, discrepancy, self._seed), held
        return {view: stricter(part, self._acceptance.kind, view, np.vstack(
            [sound_rows(fleet, view) for fleet in fleets]), ALARMS)
            for view, part in views.items()}

    def _validation(
        self, calibration: Calibration, held_out: dict[str, Any], accepted: list[str],
        discrepancy: DiscrepancyPart,
    ) -> dict[str, Any]:
        records = [
            {"bag": Path(r.provenance.source).name, "serial_number": r.provenance.serial_number,
             "left_out": outcome}
            for r, outcome in zip(self._acceptance.records, accepted)]
        return {
            "software_version": VERSION, "quick": self._quick, "seed": self._seed,
            "profile": self._acceptance.kind, "settings": asdict(self._size),
            "units": list(self._acceptance.serials), "records": records,
            "healthy_left_out_unknown": rate([o == "unknown" for o in accepted])._asdict(),
            "parameters": calibration.changes, "left_open": calibration.open,
            "largest_before": largest(calibration.names, calibration.before),
            "largest_after": largest(calibration.names, calibration.after),
            "discrepancy": dict(zip(discrepancy.names, discrepancy.mean)),
            "spread": {name: part._asdict() for name, part in load_spread()._asdict().items()},
            "held_out": held_out,
            "actuator": {name: part._asdict()
                         for name, part in calibration.actuator._asdict().items()},
        }
