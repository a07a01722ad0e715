"""Decide: nothing missing, one effect, two, or one that the catalogue does not hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ema_identification.actuator.evidence import Evidence
from ema_identification.actuator.naming import fit_candidates, gain_of, propose
from ema_identification.actuator.pairs import fit_pairs, seconds, swapped
from ema_identification.actuator.recalibration import Recalibration
from ema_identification.actuator.refit import Fit, Term, polish, refit
from ema_identification.actuator.runs import Progress, silent
from ema_identification.actuator.screening import stacked
from ema_identification.identification import Outcome

LEVEL = 0.002
"""A gain that useless effects reach more often names nothing."""
GOOD_FIT = 1e-3
"""A complete model leaves a larger cost only so often."""
POOR_FIT = 1e-7
"""A cost this improbable is a disagreement even if no effect of the catalogue helps."""
NEARLY = 4.0
"""Largest cost a feature, in units of a complete model's, at which an effect may be named."""
EXPLAINED = 0.95
"""Least part of the misfit that an effect must take away to be named though some is left."""
SECOND_GAIN = 80.0
"""Least gain of a second effect where the first explains the record well."""
POLISHED = 2
"""Pairs that are fitted further."""
AHEAD = 4.0
"""How many times as much the next effect must leave where a fit is not complete."""
LEFT = "what is left is more than noise; no further effect takes it away"
CLEAR = 2.0
"""Least distance of each of two effects from absent (standard deviations)."""
SET_MARGIN = 14.0
"""Costs that differ by less, in units of the cost a feature, do not tell two effects apart."""
SET_SHARE = (0.02, 0.15)
"""The same, of the misfit that was explained and at most of the cost (error of simulation)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What was decided.

    Attributes
    ----------
    verdict : of the identification.
    fit : of the effects that are added; None for none.
    fits : all single candidates that were fitted, best first.
    equivalent : for each term of `fit`, fits that the data cannot tell from it.
    p_value : for each term, of the hypothesis that it adds nothing.
    gain : of the best candidate on the recalibrated model.
    reasons : for people.
    """

    verdict: Outcome
    fit: Fit | None = None
    fits: tuple[Fit, ...] = ()
    equivalent: tuple[tuple[Fit, ...], ...] = ()
    p_value: tuple[float, ...] = ()
    gain: float = 0.0
    reasons: tuple[str, ...] = ()


def decide(
    evidence: Evidence, null: Recalibration, *, without: Sequence[str] = (),
    progress: Progress = silent, seed: int = 0,
) -> Answer:
    """Return the answer to a recalibrated model's residual."""
    scale, size = evidence.blocks[0].library.scale, evidence.size
    proposal = propose(evidence, null, without=without, seed=seed)
    if not proposal.screened:
        gain = 0.0
    else:
        gain = gain_of(proposal.near, proposal.screened[0], size)
    p_gain, p_null = scale.p_gain(gain), scale.p_fit(null.cost / size)
    if p_gain > LEVEL and p_null > POOR_FIT:
        return Answer(verdict="no disagreement", gain=gain, reasons=(
            f"the best effect of the catalogue would lower the misfit by {gain:.0f}; useless "
            f"effects reach that with probability {p_gain:.2g}",
            f"cost {null.cost / size:.2f} a feature: a complete model leaves more with "
            f"probability {p_null:.2g}",
        ))
    fits = fit_candidates(evidence, proposal.chosen, null, seed=seed)
    singles = [f for f in fits if np.isfinite(f.cost)]
    if singles:  # the fit may gain what the screening, linear, did not see
        gained = (null.cost - singles[0].cost) / max(singles[0].cost / size, 1e-9)
        p_gain = min(p_gain, scale.p_gain(gained))
    progress("name", 0.6)
    if singles:  # the simulator may do better than the library's signatures
        fell = (null.cost - singles[0].cost) / max(singles[0].cost / size, 1e-9)
        p_gain = min(p_gain, scale.p_gain(fell))
    if singles and scale.p_fit(singles[0].cost / size) > GOOD_FIT:
        return _with_second(evidence, null, singles, gain, p_gain, without, seed)
    if singles:
        singles[0] = polish(evidence, singles[0], null.mean, seed=seed)
        if scale.p_fit(singles[0].cost / size) > GOOD_FIT:
            return _with_second(evidence, null, singles, gain, p_gain, without, seed)
    pairs = fit_pairs(evidence, singles, proposal.far, null, without=without, seed=seed)
    pairs = sorted((*(polish(evidence, f, null.mean, seed=seed) for f in pairs[:POLISHED]),
                    *pairs[POLISHED:]), key=lambda f: f.cost)
    single = singles[0].cost if singles else np.inf
    pairs = [f for f in pairs if np.isfinite(f.cost) and _needed(f)
             and single - f.cost > SECOND_GAIN * f.cost / size]
    if pairs and scale.p_fit(pairs[0].cost / size) > GOOD_FIT:
        alone = _pruned(evidence, pairs[0], null, seed)
        if alone is not None:
            return _one("explained", [alone, *singles], null, size, gain, p_gain, ())
        pairs = swapped(evidence, pairs, null, without=without, seed=seed)
        return _two(pairs, singles, null, size, gain, p_gain)
    complete = float(np.exp(scale.fit[0]))
    if pairs and _stands_out(pairs[0], singles, null):
        pairs = swapped(evidence, pairs, null, without=without, seed=seed)
        return replace(_two(pairs, singles, null, size, gain, p_gain), verdict="partly explained",
                       reasons=(LEFT,))
    if singles and _stands_out(singles[0], singles[1:], null):
        return _one("partly explained", singles, null, size, gain, p_gain, (LEFT,))
    if singles and _nearly(singles[0], null, size, complete):
        return _one("partly explained", singles, null, size, gain, p_gain, (
            LEFT,))
    return Answer(verdict="unknown effect", fits=tuple(singles), gain=gain, reasons=(
        f"something is missing: cost {null.cost / size:.1f} a feature after recalibration, "
        f"{complete:.1f} is usual",
        "no effect of the catalogue, and no two, explain it: the best leaves "
        + (f"{singles[0].cost / size:.1f}" if singles else "everything"),
    ))


def _stands_out(fit: Fit, others: Sequence[Fit], null: Recalibration) -> bool:
    """Whether a fit takes away nearly all, and everything else leaves many times as much.

    Entries that merely imitate something unknown come in crowds; the right one stands alone.
    """
    names = {t.variant.effect for t in fit.terms}
    rest = [f.cost for f in others if {t.variant.effect for t in f.terms} != names]
    return (fit.cost < (1.0 - EXPLAINED) * null.cost
            and fit.cost * AHEAD < min(rest, default=np.inf))


def _nearly(fit: Fit, null: Recalibration, size: int, complete: float) -> bool:
    return (fit.cost / size < NEARLY * complete
            and null.cost - fit.cost > EXPLAINED * (null.cost - size * complete))


def _margin(best: Fit, null_cost: float, size: int) -> float:
    explained = max(0.0, null_cost - best.cost)
    return SET_MARGIN * best.cost / size + min(
        SET_SHARE[0] * explained, SET_SHARE[1] * best.cost)


def _rivals(fits: Sequence[Fit], null_cost: float, size: int) -> tuple[Fit, ...]:
    """Return fits of other effects that are as good as the first."""
    best, found = fits[0], []
    names = {best.terms[-1].variant.effect}
    for fit in fits[1:]:
        name = fit.terms[-1].variant.effect
        if name not in names and fit.cost - best.cost < _margin(best, null_cost, size):
            names.add(name)
            found.append(fit)
    return tuple(found[:2])


def _one(
    verdict: Outcome, singles: Sequence[Fit], null: Recalibration, size: int, gain: float,
    p: float, reasons: tuple[str, ...],
) -> Answer:
    return Answer(verdict=verdict, fit=singles[0], fits=tuple(singles), gain=gain,
                  equivalent=(_rivals(singles, null.cost, size),), p_value=(p,), reasons=reasons)


def _with_second(
    evidence: Evidence, null: Recalibration, singles: Sequence[Fit], gain: float, p: float,
    without: Sequence[str], seed: int,
) -> Answer:
    """Return one effect that explains the record, with a second one where that helps clearly."""
    size, best = evidence.size, singles[0]
    one = _one("explained", singles, null, size, gain, p, ())
    rest, more = seconds(evidence, best, null, without=without, keep=1)
    if not more or gain_of(rest, more[0], size) < SECOND_GAIN:
        return one
    term = Term(variant=more[0].variant, signature=stacked(evidence, more[0].index), u=more[0].u)
    both = refit(evidence, [best.terms[0], term], best.z, null.mean, seed=seed)
    fell = (best.cost - both.cost) / max(both.cost / size, 1e-9)
    if fell < SECOND_GAIN or not _needed(both):
        return one
    alone = _pruned(evidence, both, null, seed)
    if alone is not None:
        return _one("explained", [alone, *singles[1:]], null, size, gain, p, ())
    scale = evidence.blocks[0].library.scale
    return Answer(verdict="explained", fit=both, fits=tuple(singles), gain=gain,
                  equivalent=(_rivals(singles, null.cost, size), ()),
                  p_value=(p, scale.p_gain(fell)))


def _two(
    pairs: Sequence[Fit], singles: Sequence[Fit], null: Recalibration, size: int, gain: float,
    p: float,
) -> Answer:
    """Return two effects, with what either might be instead."""
    best = pairs[0]
    names = [t.variant.effect for t in best.terms]
    equal: list[list[Fit]] = [[], []]
    for fit in pairs[1:]:
        if fit.cost - best.cost > _margin(best, null.cost, size):
            continue
        other = [t.variant.effect for t in fit.terms]
        for k in (0, 1):
            kept, moved = names[1 - k], [n for n in other if n != names[1 - k]]
            if kept in other and len(moved) == 1 and moved[0] != names[k]:
                equal[k].append(fit)
    return Answer(verdict="explained", fit=best, fits=tuple(singles), gain=gain,
                  equivalent=(tuple(equal[0][:2]), tuple(equal[1][:2])), p_value=(p, p))


def _pruned(evidence: Evidence, pair: Fit, null: Recalibration, seed: int) -> Fit | None:
    """Return the fit of one effect of a pair if the other is not needed, else None.

    It starts where the pair ended, so a single fit that had stopped short is mended too.
    """
    size = evidence.size
    for term in pair.terms:
        alone = refit(evidence, [term], pair.z, null.mean, seed=seed)
        if alone.cost - pair.cost < SECOND_GAIN * pair.cost / size:
            return alone
    return None


def _needed(fit: Fit) -> bool:
    """Whether every effect of a fit is clearly away from zero (prune)."""
    at = 0
    for term in fit.terms:
        n = term.variant.size
        known = [k for k in range(n) if len(term.signature.levels[k]) > 1]
        block = np.ix_([at + k for k in known], [at + k for k in known])
        u = term.u[known]
        matrix = fit.covariance[block] + 1e-30 * np.eye(len(known))
        if float(u @ np.linalg.solve(matrix, u)) < CLEAR**2:
            return False
        at += n
    return True
