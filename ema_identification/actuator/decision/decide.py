"""The decision, whole: nothing, one law, two, a set of names, or something unknown.

1. *Nothing* unless the misfit, the largest useless gain, the gap or the largest ripple, each in
   units of what the share `LEVEL` of healthy units exceeds, is surely rarer than `LEVEL` among
   them (rank among some that built nothing of the library, with the bound that holds for these
   very ones, Vovk 2012), on its quadratic and again on runs. What is not even rarer than
   1 - `SURE` ends here; else a law must add to nothing: gain more than useless ones, both fitted
   as hard and begun where the other ended. So it must where that is usual once the unit's
   numbers may leave their bands a little (`EDGE`), beside such a unit.
2. Laws are proposed from the library (wide, cheap), fitted with the simulator (`ROUNDS`), and
   compared by one evidence: log E = -½ ν ln J - ½ k ln ν - m ln(N / `LEVEL`), J the cost, k
   coordinates, ν the independent numbers of a record, m laws of N. This is the likelihood of a
   scale that is not known, with prices of a coordinate (Schwarz 1978) and of a law. Where the best
   law explains nothing, or two are in question, it is fitted up to `EDGE` of the bands too, of two
   that explain each one, also from where both ended. Where no law nor two explain, and the best
   model not even its own runs (it sticks and slips), all begins again with the noise of these.
3. A model *explains* if its cost is usual among healthy units; each law in it must have a gain
   of its own beyond the useless ones', beside the other one fitted as hard: a test of the level
   `LEVEL`, corrected for the search. A law to which a second one adds so much is no answer alone.
   The answer is the smallest set of names with `SURE` of the evidence, the simplest model in it;
   more than `LARGEST_SET`, or no model that explains, is unknown.
4. What is named is measured anew, by runs over all that it may be (`intervals`). A model with a
   law whose size is not told from none there is no answer, unless no fit without the law, begun
   where the model's is and fitted as hard, explains. Nor is a model of other laws then: none is
   needed. Of two laws the other one may be.
5. Held-out records judge: names that do not lower their gap, or leave it large and close less
   than most of it (`MOST`), are contradicted, and there is no silence where it is large: laws are
   tried then too. What is named on a usual record must add to nothing (1), or close most of a gap
   that this leaves, a rare one. Where no model explains, a single law that
   closes most of misfit and gap is named, and that something remains beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ema_identification.actuator.decision.answer import FleetAnswer, instead_of, stages_of
from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.decision.intervals import p_sizes
from ema_identification.actuator.decision.models import LARGEST_SET, Models, noisy
from ema_identification.actuator.decision.proposals import scores
from ema_identification.actuator.decision.ranks import LEVEL, both_of, p_nothing, share_of
from ema_identification.actuator.laws.terms import SURE, LawFit, LawJudge
from ema_identification.actuator.measure.runs import Progress, silent
from ema_identification.result import after_validation

EDGE = 1.3
"""Requirement: half widths of its band up to which a number may be off and nothing is missing."""
MOST = 0.75
"""Requirement: share of the squares that what is named closes where more is left than noise, of
the misfit and of a held-out gap, both beyond what half of the healthy units leave."""
OUT = f"numbers of the unit are up to {EDGE - 1.0:.0%} of their half band beyond it"


def decide(
    unit: TestedUnit, held: LawJudge | None = None, *, witness: LawJudge | None = None,
    without: Sequence[str] = (), progress: Progress = silent,
) -> FleetAnswer:
    """Return the answer to a record.

    Parameters
    ----------
    unit : the record.
    held : held-out record of the same unit, if there is one.
    witness : one that only bears out a law beside which something remains, default `held`.
    without : effects that are not to be considered.
    progress : called with what is being done and how much of it is.
    """
    case, healthy = Models(unit, without), unit.library.healthy
    both = p_nothing(scores(unit), healthy), case.p_without()
    p, look = max(both), both[0] <= 1.0 - SURE or both[1] <= LEVEL
    usual, rival = _usual(case, p, held), case
    if usual is not None and usual.verdict == "no disagreement" and not look:
        return usual
    progress("name", 0.1)
    beyond = Models(replace(unit, edge=EDGE * unit.edge), without)
    case.nothing = min(case.nothing, beyond.null.cost)
    if usual is None:
        far = max(p_nothing(scores(beyond.unit), healthy), beyond.p_without())
        usual, rival = _usual(beyond, far, held, EDGE), beyond
    singles = case.singles()
    silence = usual if rival is beyond and usual and usual.verdict == "no disagreement" else None
    if silence is not None and not any(map(case.explains, singles)):
        return silence
    progress("name", 0.5)
    pairs = case.pairs(singles)
    progress("name", 0.9)
    wider = [beyond.refitted(singles[0])] if singles and (
        pairs or not case.explains(singles[0])) else []
    if pairs and case.explains(pairs[0]):
        wider += beyond.each_alone(pairs[0], wider)
    fits = case.finished([*singles, *wider, *pairs])
    explaining = [f for f in fits if case.explains(f)]
    own = noisy(unit, fits[0]) if fits and not explaining else unit
    if own.scatter.any() and not unit.scatter.any():
        return decide(own, held, witness=witness, without=without, progress=progress)
    answer = _named(case, FleetAnswer(
        verdict="unknown effect", null=case.null, p_nothing=p, fits=tuple(fits)), explaining)
    if usual is not None:
        if answer.fit is None and usual.verdict == "no disagreement":
            return usual
        if _edge(case, answer.fit) > 1.0:  # so may the numbers of none
            rival = beyond
        nothing = rival.hardest(fits)
        quiet = _silence(usual, held, (nothing,), p, _edge(case, nothing))
        if answer.fit is None or not (
                (held is not None and quiet is None and silence is None
                 and held.gap([nothing, answer.fit], _edge(case, answer.fit)).closes(MOST))
                or rival.adds(answer.fit, nothing)):
            return quiet or usual
    witness = witness or held
    if witness is not None and answer.verdict == "unknown effect" and not answer.equivalent:
        answer = _in_part(case, answer, witness)
    answer = _measured(case, beyond, answer, explaining)
    if usual is not None and answer.fit is None:
        return usual
    if held is None:
        return answer
    gap = held.gap(stages_of(answer), _edge(case, answer.fit), known=answer.known)
    verdict, said = after_validation(
        answer.verdict, gap.values[0], gap.values[-1], gap.bound, "healthy units", gap.left(MOST))
    if usual is not None and (verdict == "contradicted" or gap.values[-1] >= gap.values[0]):
        return usual
    return replace(answer, gap=gap, verdict=verdict, reasons=(*said, *answer.reasons))


def _edge(case: Models, fit: LawFit | None) -> float:
    """Return how many half widths of its band a number of the unit is off in a fit, at most."""
    beyond = fit is not None and bool((np.abs(fit.z) > case.unit.edge + 1e-6).any())
    return EDGE if beyond else 1.0


def _usual(
    case: Models, p: float, held: LawJudge | None, edge: float = 1.0
) -> FleetAnswer | None:
    """Return silence where `p` is usual; unknown where the held-out record is off all the same.

    By itself or both together, on the quadratic and again on runs. None where `p` is not usual.
    """
    if p <= LEVEL:
        return None
    said = f"{f'{OUT}; ' if edge > 1.0 else ''}of healthy units, up to {p:.2g} are as far off"
    answer = FleetAnswer(
        verdict="no disagreement", null=case.quadratic, p_nothing=p, reasons=(said,))
    if held is None:
        return answer
    if found := _silence(answer, held, (case.quadratic, case.null), p, edge):
        return found
    gap = held.gap([case.null], edge)
    return replace(answer, gap=gap, verdict="unknown effect", reasons=(
        said, f"the held-out record is off by {gap.values[0]:.3g}; healthy units by up to "
        f"{gap.bound:.3g} (95 %)"))


def _silence(answer: FleetAnswer, held: LawJudge | None, fits: Sequence[LawFit], p: float,
             edge: float) -> FleetAnswer | None:
    """Return that nothing is missing where one of `fits`, of no law, leaves a usual gap."""
    if held is None:
        return None
    for fit in fits:
        gap = held.gap([fit], edge)
        own = share_of(int((gap.healthy >= gap.values[0]).sum()), len(gap.healthy))
        if min(own, both_of(p, own)) > LEVEL:
            return replace(answer, gap=gap, verdict="no disagreement", null=fit,
                           reasons=answer.reasons[:1])
    return None


def _named(case: Models, answer: FleetAnswer, explaining: list[LawFit]) -> FleetAnswer:
    """Return the answer with the names that the evidence leaves."""
    tested: list[tuple[LawFit, tuple[float, ...], tuple[LawFit, ...]]] = [
        (fit, (case.p_own(fit, case.nothing),), (case.null,))
        for fit in explaining if len(fit.terms) == 1]
    for pair in [f for f in explaining if len(f.terms) == 2][:LARGEST_SET]:
        less = tuple(case.each_alone(pair, answer.fits)[::-1])  # of each law, without it
        tested.append((pair, tuple(case.p_own(pair, f.cost) for f in less), less))
        tested += [(f, (case.p_own(f, case.nothing),), (case.null,))
                   for f in less if case.explains(f)]
    good = [row for row in tested if max(row[1]) <= LEVEL]
    more = [set(fit.names) for fit, *_ in good if len(fit.terms) > 1]
    good = [row for row in good if not any(set(row[0].names) < names for names in more)]
    if not good:
        return replace(answer, reasons=(
            "no law of the catalogue, nor two, leave what a healthy unit leaves"
            f"{_nearest(case, answer.fits)}",))
    weights: dict[frozenset[str], float] = {}
    top = max(case.evidence(row[0]) for row in good)
    for fit, *_ in good:
        key = frozenset(fit.names)
        weights[key] = max(weights.get(key, 0.0), float(np.exp(case.evidence(fit) - top)))
    ordered = sorted(weights, key=lambda k: -weights[k])
    share = np.cumsum([weights[k] for k in ordered]) / sum(weights.values())
    kept = ordered[:int(np.searchsorted(share, SURE)) + 1]
    chosen, p_value, less = min(  # the simplest that no second law adds to
        (row for row in good if frozenset(row[0].names) in kept),
        key=lambda row: (len(row[0].terms), -case.evidence(row[0])))
    equivalent = tuple(instead_of(chosen, name, kept) for name in chosen.names)
    if max(len(e) for e in equivalent) >= LARGEST_SET:
        return replace(answer, equivalent=(tuple(sorted(set().union(*kept))),), reasons=(
            f"{len(kept)} explanations are equally good",))
    excess = max(case.null.cost - chosen.cost, 1e-9)
    closed = tuple(float(np.clip((f.cost - chosen.cost) / excess, 0.0, 1.0)) for f in less)
    return replace(answer, verdict="explained", fit=chosen, equivalent=equivalent,
                   p_value=p_value, closed=closed,
                   alone=less[::-1] if len(less) > 1 else ())


def _measured(case: Models, beyond: Models, answer: FleetAnswer, explaining: list[LawFit]
              ) -> FleetAnswer:
    """Return the answer measured, of models in which the size of each law is told from none."""
    unnamed: list[str] = []
    while answer.fit is not None:
        fit = answer.fit
        of, out = (case, ()) if _edge(case, fit) == 1.0 else (beyond, (OUT,))
        known, best = of.remeasured(fit)
        if of.needs(fit, p_sizes(known, fit), answer.alone):
            return replace(answer, known=known, fit=best, reasons=(*out, *answer.reasons))
        unnamed.append(" and ".join(fit.variants))
        explaining = [f for f in (*explaining, *answer.alone)
                      if case.explains(f) and set(f.names) < set(fit.names)]
        answer = FleetAnswer(
            verdict="unknown effect", null=answer.null, p_nothing=answer.p_nothing,
            fits=answer.fits, reasons=(f"less is left with {', or '.join(unnamed)}, "
                                       "but no size of it is told from none",))
        again = _named(case, answer, explaining)
        answer = again if again.fit is not None else answer
    return answer


def _nearest(case: Models, fits: Sequence[LawFit]) -> str:
    """Return which law comes nearest, if it gains more than useless ones do, and how near."""
    for fit in fits:
        if len(fit.terms) == 1 and np.isfinite(fit.cost):
            if case.p_own(fit, case.nothing) > LEVEL:
                break
            return (f"; the nearest, {fit.variants[0]}, closes "
                    f"{100.0 * min(_share(case, fit), 1.0):.0f} % of the misfit")
    return ""


def _share(case: Models, fit: LawFit) -> float:
    """Return the share that a fit closes of the misfit beyond what half of healthy units leave."""
    return float((case.null.cost - fit.cost) / max(case.null.cost - case.usual, 1e-9))


def _in_part(case: Models, answer: FleetAnswer, held: LawJudge) -> FleetAnswer:
    """Return the answer with the law, or the set, that closes most of misfit and held-out gap.

    Within the bands: beyond them numbers of the unit make up for what the law does not do.
    """
    singles = [f for f in answer.fits if len(f.terms) == 1 and np.isfinite(f.cost)
               and _edge(case, f) == 1.0]
    if not singles:
        return answer
    best = singles[0]
    closed, p = _share(case, best), case.p_own(best, case.nothing)
    if closed < MOST or p > LEVEL:
        return answer
    sure = case.evidence(best) + np.log(1.0 - SURE)
    names = {f.names[0] for f in singles if case.evidence(f) > sure} - set(best.names)
    gap = held.gap([case.null, best])
    if len(names) >= LARGEST_SET or not gap.closes(MOST):
        return answer
    return replace(
        answer, verdict="partly explained", fit=best, equivalent=(tuple(sorted(names)),),
        p_value=(p,), closed=(closed,), reasons=(
            "beside it something remains that no law of the catalogue explains",))
