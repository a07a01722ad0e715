"""The same few parameters in every record of an axis, so that they can be followed over records.

One set of terms, one band and one standstill for all records; each record is fitted alone, without
bounds, so that what is not there scatters about zero and the intervals stay honest.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import yaml
from threadpoolctl import threadpool_limits

from ema_identification.result import Parameter
from ema_identification.rig.fit.balance import Design, InputBalance
from ema_identification.rig.fit.estimates import parameters
from ema_identification.rig.fit.known import repeated, term_of
from ema_identification.rig.fit.model import RigModel, Settings
from ema_identification.rig.fit.regression import Blocks, CoefficientBounds, fit, make_blocks
from ema_identification.rig.laws import LAWS
from ema_identification.rig.laws.base import Term
from ema_identification.rig.prepare import even_pieces, prepare
from ema_identification.rig.search.alternatives import refined, without_skew
from ema_identification.rig.search.shapes import freest_columns, smooth_shapes
from ema_identification.rig.signals.trajectory import Trajectory
from ema_identification.rig.signals.two_sides import lost_and_wound
from ema_identification.rig.workflow import Progress, identify_rig
from ema_record.errors import RecordError
from ema_rig.record import OUTPUT_POSITION, POSITION, RigRecord

ALWAYS = ("inertia", "viscous_friction", "coulomb_friction", "offset")
"""Followed in any record."""
WITH_OWN_SHAPE = {"backlash": "gap", "presliding_hysteresis": "distance",
                  "compliance": "frequency"}
"""Laws whose shape is looked for in every record anew: it is what wears."""
KEPT = {"backlash": ("gap",)}
"""Parameters of a law that are followed, where not all are."""
LEFT_OUT = ("phase", "order", "rest", "middle", "damping")
"""Parameters that say where, not how much."""
MISSED = 0.02
"""A law with a shape of its own is in a record if its held-out squares rise by this share without
it."""


@dataclass(frozen=True, kw_only=True)
class Followed:
    """What one record gives."""

    source: str
    parameters: tuple[Parameter, ...] = ()
    why: str = ""
    """It gives nothing."""


@threadpool_limits.wrap(limits=1)
def follow(
    records: Sequence[RigRecord], model: RigModel | None = None,
    say: Progress = lambda _w, _s: None,
) -> tuple[Followed, ...]:
    """Return the parameters of each record, all fitted alike.

    Parameters
    ----------
    records : of one axis, in their order.
    model : its terms are followed, beside `ALWAYS`; without it those that `identify_rig` names in
        the first and in the last record that can be used.
    say : takes what is being done, and the share that is done.
    """
    found: dict[int, Followed] = {}
    ready: dict[int, Trajectory] = {}
    settings = Settings() if model is None else model.settings
    for index, record in enumerate(records):
        say(f"reading record {index + 1}", 0.3 * index / len(records))
        try:
            ready[index] = prepare([record], settings)
        except RecordError as error:
            found[index] = Followed(source=record.source, why=str(error))
    if ready:
        usable = [records[index] for index in ready]
        terms = _terms(usable, model, say)
        common = settings.model_copy(update={
            "band": float(np.median([t.band for t in ready.values()])),
            "standstill": float(np.median([t.standstill for t in ready.values()]))})
        for done, index in enumerate(ready):
            say(f"fitting record {index + 1}", 0.5 + 0.5 * done / len(ready))
            try:
                found[index] = _fitted(records[index], common, terms)
            except RecordError as error:
                found[index] = Followed(source=records[index].source, why=str(error))
    return tuple(found[index] for index in range(len(records)))


def _terms(usable: Sequence[RigRecord], model: RigModel | None, say: Progress) -> tuple[Term, ...]:
    """Return the terms that are followed, each law and shape once."""
    models = [model] if model is not None else []
    if model is None:
        for place, record in enumerate({id(r): r for r in (usable[0], usable[-1])}.values()):
            say(f"identifying the {('first', 'last')[place]} record", 0.3 + 0.1 * place)
            answer = identify_rig([record])
            models.append(RigModel.model_validate(yaml.safe_load(answer.model_text)))
    found = {name: [Term(law=LAWS[name])] for name in ALWAYS}
    for one in models:
        fresh = [term_of(entry) for entry in one.terms]
        for term in fresh:
            others = found.setdefault(term.law.name, [])
            if not others or (term.law.repeats and not _near(term, others, fresh)):
                others.append(term)
    return tuple(term for terms in found.values() for term in terms)


def _near(term: Term, others: Iterable[Term], fresh: Sequence[Term]) -> bool:
    """Return whether a wave is one of the others, within a hundredth of its order."""
    return any(abs(term.shape[0] / other.shape[0] - 1.0) < 0.01
               for other in others if not any(other is own for own in fresh))


def _fitted(record: RigRecord, settings: Settings, terms: Sequence[Term]) -> Followed:
    """Return the parameters of one record."""
    trajectory = prepare([record], settings)
    design = Design(trajectory)
    kept = [term for term in terms
            if term.law.applies(trajectory) and term.law.name not in WITH_OWN_SHAPE]
    balance = _free(design, kept)
    for index in reversed(range(len(balance.terms))):
        if repeated(balance, balance.span(index)):
            balance = balance.without(index)
    smooth = smooth_shapes(trajectory)
    blocks = make_blocks(
        trajectory, fit(freest_columns(balance.columns, smooth), trajectory.target).residual)
    balance = without_skew(balance, blocks)
    values: list[Parameter] = []
    for term in terms:
        if term.law.name in WITH_OWN_SHAPE and term.law.applies(trajectory):
            balance, own = _with_own_shape(balance, blocks, term)
            values += own
    for index, term in enumerate(balance.terms):
        if term.law.name not in WITH_OWN_SHAPE:
            values += _named(balance, index, blocks)
    return Followed(source=record.source,
                    parameters=(*sorted(values, key=_rank), *_between(record, trajectory)))


def _free(design: Design, terms: Sequence[Term]) -> InputBalance:
    """Return a balance whose coefficients have no bounds."""
    count = sum(len(term.law.coefficients) for term in terms)
    return InputBalance(design=design, terms=tuple(terms), bounds=CoefficientBounds(
        low=np.full(count, -np.inf), high=np.full(count, np.inf)))


def _with_own_shape(
    balance: InputBalance, blocks: Blocks, term: Term
) -> tuple[InputBalance, list[Parameter]]:
    """Return the balance with a law whose shape is that of this record, and its parameters.

    Where the record does not miss the law, its size is none, and the upper end of its interval is
    what the band would just resolve.
    """
    trajectory = balance.design.trajectory
    law = term.law
    grid = [Term(law=law, shape=tuple(shape)) for shape in law.grid(trajectory)]
    if not grid:
        return balance, []
    tried = [_free(balance.design, (*balance.terms, other)) for other in grid]
    left = [float(np.sum(other.fit.residual**2)) for other in tried]
    best = refined(balance, grid[int(np.argmin(left))])
    full = _free(balance.design, (*balance.terms, best))
    before, after = balance.squares(blocks), full.squares(blocks)
    size = WITH_OWN_SHAPE[law.name]
    if before < (1.0 + MISSED) * after or (law.positive and full.fit.coefficients[-1] < 0.0):
        if size == "frequency":  # no resonance in the band is no number
            return balance, []
        least = grid[0].shape[law.shape.index(size)]
        own = parameters(full, len(full.terms) - 1, blocks)
        return balance, [replace(p, value=0.0, low=0.0, high=least) for p in own
                         if p.name == f"{law.name}.{size}"]
    return full, _named(full, len(full.terms) - 1, blocks)


def _named(balance: InputBalance, index: int, blocks: Blocks) -> list[Parameter]:
    """Return the parameters of a term that are followed; waves with their order in the name."""
    law = balance.terms[index].law
    found = []
    for p in parameters(balance, index, blocks):
        own = p.name.partition(".")[2]
        if own in LEFT_OUT or own not in KEPT.get(law.name, (own,)):
            continue
        several = law.repeats and law.shape
        found.append(replace(p, name=f"{p.name}({balance.terms[index].shape[0]:.4g})")
                     if several else p)
    return found


def _rank(p: Parameter) -> tuple[int, str]:
    name = p.name.partition(".")[0]
    return (ALWAYS.index(name) if name in ALWAYS else len(ALWAYS)), p.name


def _between(record: RigRecord, trajectory: Trajectory) -> list[Parameter]:
    """Return lost motion and wind-up, where both sides are measured."""
    if not (record.has(POSITION) and record.has(OUTPUT_POSITION)):
        return []
    found = lost_and_wound(even_pieces(record, []), trajectory.band)
    if isinstance(found, str):
        return []
    return [Parameter(name=name, value=value, low=low, high=high, unit=unit)
            for name, unit, (value, low, high) in zip(
                ("sides.lost_motion", "sides.wind_up"),
                (record.axis.position_unit, "s²"), found)]
