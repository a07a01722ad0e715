"""The workflow with the decision of this package: `decide` on a record, said as the others say it.

It takes one measured and at most one held-out record, and any number from when the unit was
accepted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from threadpoolctl import threadpool_limits

from ema_identification.actuator.checks import check_records
from ema_identification.actuator.decision.acceptance import with_acceptance
from ema_identification.actuator.decision.baseline import changed_unit, with_baselines
from ema_identification.actuator.decision.decide import FleetAnswer, decide
from ema_identification.actuator.decision.fit import LawFit, TestedUnit
from ema_identification.actuator.decision.fleet import (
    FULL,
    NAMES,
    LibrarySizes,
    fleet_unit,
)
from ema_identification.actuator.decision.gap import HeldOut, fitted_gap, gaps_of_healthy
from ema_identification.actuator.decision.library import fleet_library
from ema_identification.actuator.decision.show import panels_of, steps_of
from ema_identification.actuator.measure.features import nominal_rate
from ema_identification.actuator.measure.recorder import recorded_alike, whole
from ema_identification.actuator.measure.runs import Progress, silent
from ema_identification.actuator.measure.tolerances import RecordConditions, align
from ema_identification.actuator.naming.estimates import choices_of, model_file_text
from ema_identification.actuator.surrogate.fit import with_terms
from ema_identification.actuator.words import groups_of, where_of
from ema_identification.result import (
    Candidate,
    Formula,
    Identification,
    NamedEffect,
    Parameter,
    Shape,
)
from ema_record.errors import UsageError
from ema_record.record import Record
from ema_sim.effects import EFFECTS
from ema_sim.effects.base import Quantity
from ema_sim.model_file import Model

DRAWS = 400
GAP_UNIT = ("rms of the tenth of the features that are off most, in standard deviations of what "
            "the model without a law may be off on this record when nothing is missing")


def identify_by_fleet(
    measured: Sequence[Record], model: Model, *, validate: Sequence[Record] = (),
    baseline: Sequence[Record] = (), without: Sequence[str] = (), progress: Progress = silent,
    workers: int = 1, seed: int = 0, sizes: LibrarySizes = FULL,
) -> Identification:
    """Return what the model lacks to explain a record; parameters as of `identify`.

    Raises
    ------
    UsageError
        More than one measured or more than one held-out record.
    """
    case = FleetCase((*measured, *validate, *baseline), model, sizes, seed, workers, progress)
    check_records([case.whole(r) for r in measured], [case.whole(r) for r in validate],
                  case.model, without)
    if len(measured) > 1 or len(validate) > 1:
        raise UsageError(f"{len(measured)} measured and {len(validate)} held-out records: this "
                         "decision takes one of each")
    with threadpool_limits(limits=1):
        unit = case.unit(measured[0])
        held = None
        if validate:
            other = case.unit(validate[0], signatures=False)
            held = HeldOut(unit=other, fitted=unit, healthy=gaps_of_healthy(other, unit))
        found = _said(unit, decide(unit, held, without=without, progress=progress), model)
        return found if not baseline else replace(
            found, since=_since(case, unit, baseline, without, model))


def changes_since(
    measured: Record, baseline: Sequence[Record], model: Model, *, without: Sequence[str] = (),
    progress: Progress = silent, workers: int = 1, seed: int = 0, sizes: LibrarySizes = FULL,
) -> Identification:
    """Return what has changed since the baseline; parameters as of `identify`."""
    case = FleetCase((measured, *baseline), model, sizes, seed, workers, progress)
    check_records([case.whole(measured)], (), case.model, without)
    with threadpool_limits(limits=1):
        return _since(case, case.unit(measured), baseline, without, model)


class FleetCase:
    """Records of one unit, by one recorder, and the libraries of their tests."""

    def __init__(self, records: Sequence[Record], model: Model, sizes: LibrarySizes, seed: int,
                 workers: int, progress: Progress) -> None:
        self.model, self.sizes, self.seed = recorded_alike(records, model), sizes, seed
        self.workers, self.progress = workers, progress

    def whole(self, record: Record) -> Record:
        """Return the record with all channels."""
        return whole(record, self.model.actuator)

    def unit(self, record: Record, *, signatures: bool = True) -> TestedUnit:
        """Return the record as it is judged; `signatures`: laws may be named on it."""
        known = with_acceptance(fleet_library(
            self.model, record.profile, rate=nominal_rate(record), signatures=signatures,
            sizes=self.sizes, seed=self.seed, workers=self.workers, progress=self.progress),
            seed=self.seed)
        record = self.whole(record)
        return TestedUnit(library=known, values=known.fmap.extract(record), seed=self.seed,
                          conditions=align(record, self.model), workers=self.workers)


def _since(case: FleetCase, unit: TestedUnit, baseline: Sequence[Record],
           without: Sequence[str], model: Model) -> Identification:
    """Return what has changed since the baseline."""
    for record in baseline:
        if tuple(record.profile.points) != tuple(unit.library.fmap.profile.points) or not (
                math.isclose(nominal_rate(record), unit.library.fmap.rate)):
            name = record.provenance.source or record.profile.name
            raise UsageError(f"baseline {name}: not the command and rate of the measured record: "
                             "give one of the same test")
    before = [case.unit(record) for record in baseline]
    library, apart = with_baselines(
        replace(unit.library, left=None), case.sizes, seed=case.seed, workers=case.workers,
        progress=case.progress)
    changed = changed_unit(replace(unit, library=library), before, apart)
    return _said(changed, decide(changed, without=without, progress=case.progress), model)


def covariance_of(unit: TestedUnit, fit: LawFit) -> np.ndarray:
    """Return the covariance of the coordinates of all laws and of all that healthy units have."""
    white = unit.whitener(fit.runs)
    columns = white.columns(fit.slopes, unit.values - fit.mean)
    weight = np.append(np.full(fit.free, 1e-12), unit.weight)
    return np.asarray(np.linalg.inv(columns.T @ columns + np.diag(weight)))


def parameters_of(unit: TestedUnit, fit: LawFit, index: int) -> tuple[Parameter, ...]:
    """Return the parameters of a law with intervals of 90 %, by draws of its coordinates."""
    begin = sum(t.variant.size for t in fit.terms[:index])
    term = fit.terms[index]
    part = slice(begin, begin + term.variant.size)
    draws = np.random.default_rng(0).multivariate_normal(
        term.u, covariance_of(unit, fit)[part, part], size=DRAWS)
    draws = np.clip(draws, term.variant.low, term.variant.high)
    kinds = {f.name: f.kind for f in EFFECTS[term.variant.effect].fields}
    found = []
    for name, value in term.variant.settings(term.u).items():
        kind, middle = kinds[name], float(value)
        if not isinstance(kind, Quantity):
            continue
        values = np.array([float(term.variant.settings(u)[name]) for u in draws])
        if kind.unit == "rad" and name in ("phase", "angle"):
            values = middle + np.angle(np.exp(1j * (values - middle)))
        low, high = (float(x) for x in np.quantile(values, (0.05, 0.95)))
        found.append(Parameter(name=f"{term.variant.effect}.{name}", value=middle,
                               low=min(low, middle), high=max(high, middle), unit=kind.unit))
    return tuple(found)


def _said(unit: TestedUnit, answer: FleetAnswer, model: Model) -> Identification:
    models = [answer.null] if answer.fit is None else [answer.null, answer.fit]
    gap = fitted_gap(unit, models) if answer.gap is None else answer.gap
    values = gap.values[0], gap.values[-1]
    evidence = cast("Any", SimpleNamespace(blocks=(unit,)))
    white = unit.whitener(answer.null.runs)
    groups = groups_of(evidence, [(unit.values - answer.null.mean) / white.deviation])
    where = where_of(groups)
    findings = []
    for k, term in enumerate(() if answer.fit is None else answer.fit.terms):
        assert answer.fit is not None
        name = term.variant.effect
        effect = EFFECTS[name]
        findings.append(NamedEffect(
            effect=name, equivalent=answer.equivalent[k], choices=choices_of(term),
            formula=Formula(effect.summary, effect.equation, effect.reference),
            parameters=parameters_of(unit, answer.fit, k), where=where,
            p_value=answer.p_value[k], gap_before=values[0], gap_after=values[1]))
    shape = None
    if answer.verdict == "unknown effect":
        ports = list(dict.fromkeys(str(EFFECTS[f.names[-1]].port) for f in answer.fits))[:2]
        shape = Shape(port=", ".join(ports) or "controller",
                      text=f"{', '.join(ports)}: {where.text}")
    shares = tuple(f"{f.effect} closes {share:.0%} of what the model leaves"
                   for f, share in zip(findings, answer.closed))
    return Identification(
        verdict=answer.verdict, gap_before=values[0], gap_after=values[1],
        noise_floor=gap.floor, gap_unit=GAP_UNIT, held_out=answer.gap is not None,
        findings=tuple(findings), rivals=_rivals(unit, answer),
        reasons=(*shares, *answer.reasons), unknown=shape,
        recalibrated=_recalibrated(unit, answer.null if answer.fit is None else answer.fit),
        model_text="" if answer.verdict == "contradicted" else _model_text(unit, answer, model),
        steps=steps_of(unit, answer, groups, gap), panels=panels_of(unit, answer))


def _rivals(unit: TestedUnit, answer: FleetAnswer) -> tuple[Candidate, ...]:
    named = set() if answer.fit is None else {*answer.fit.names, *sum(answer.equivalent, ())}
    found: dict[str, Candidate] = {}
    for fit in answer.fits:
        if len(fit.terms) == 1 and fit.names[0] not in named:
            found.setdefault(fit.names[0], Candidate(
                effect=fit.names[0], score=float(np.sqrt(fit.cost / unit.size)), p_value=1.0,
                reason=f"fitted: cost {fit.cost / unit.size:.2f} a feature"))
    return tuple(found.values())


def _recalibrated(unit: TestedUnit, fit: LawFit) -> tuple[Parameter, ...]:
    deviation = np.sqrt(np.diag(covariance_of(unit, fit)))[fit.free:]
    return tuple(
        Parameter(name=name, value=float(x), low=float(max(x - 1.645 * s, -1.0)),
                  high=float(min(x + 1.645 * s, 1.0)), unit="half widths")
        for name, x, s in zip(NAMES, fit.z, deviation))


def _model_text(unit: TestedUnit, answer: FleetAnswer, model: Model) -> str:
    """Return the model file: the hardware as recalibrated, and the laws."""
    fit = answer.null if answer.fit is None else answer.fit
    effects = with_terms(fit.terms, model.effects)
    actuator, _ = fleet_unit(  # conditions and sensor errors stay out
        unit.library.model, unit.library.spread, fit.z, RecordConditions(), effects)
    return model_file_text(actuator, effects)
