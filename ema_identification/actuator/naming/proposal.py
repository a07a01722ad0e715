"""Which effects, and pairs of effects, are worth a fit with the simulator, and where it begins.

Starts come from two screenings, from ripple, from other sizes of what was fitted, and by
superposition for pairs. One more kind is for effects that are nearly one machine (`next_test`): a
short changes the constants of the phases as a static eccentricity along its phase does, with
another common factor. Where a fit of one is complete the other one is tried at just that place:
the screening, which keeps the tolerances small, may never lead there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.measure.tolerances import TOLERANCES
from ema_identification.actuator.naming.next_test import PHASES, phase_constants
from ema_identification.actuator.naming.ripple import periodic_candidates
from ema_identification.actuator.surrogate.evidence import Asked, Evidence
from ema_identification.actuator.surrogate.fit import EffectTerm, Fit, Start
from ema_identification.actuator.surrogate.likelihood import BAND, Recalibration, Robust
from ema_identification.actuator.surrogate.screening import (
    Screened,
    Sized,
    Sizing,
    bounded_gains,
    grid,
    residual,
    screen_catalogue,
    selectable,
    signature_of,
    stacked,
)
from ema_sim.effects.rotor_eccentricity import THIRD

SIZED, NEAR = 4, 3
"""Candidates from the comparison at all sizes, and about the recalibrated unit."""
VARIANTS = 2
"""Of one effect."""
FIRSTS = 6
"""Effects that are tried as the first of a pair."""
PAIRS = 4
SECONDS = 2
"""Effects that are tried beside a fitted one."""
SCANNED, SIZES = 3, 2
"""Effects that are tried at other sizes where no fit is complete, and sizes of each."""
FACTORS = (0.25, 0.5, 2.0, 4.0)
"""Those sizes, in units of the fitted one, of an effect with several coordinates."""
CHALLENGERS = 12
"""Effects that are tried against a small one."""


class Proposal(NamedTuple):
    """What the library says: the gain of the best candidate, and where fits begin."""

    gain: float
    starts: list[Start]


def propose(
    evidence: Evidence, null: Recalibration, *, without: Sequence[str] = (), seed: int = 0
) -> Proposal:
    """Return what might explain a unit, best candidates of two screenings.

    One is about runs at the recalibrated tolerances, sharp for small effects; the other compares
    the library at all its sizes with the measurement, for effects so large that recalibration
    went astray.
    """
    local = residual(evidence, null.centre, null.mean, runs=null.runs)
    near = screen_catalogue(evidence, local, without=without)
    gains = bounded_gains(evidence, null.centre, null.mean, null.runs, near)
    ranked = [s for _, s in sorted(zip(gains, near), key=lambda pair: -pair[0])]
    sizing = Sizing(evidence)
    sized = sorted((sizing.best(stacked(evidence, i)) for i in selectable(evidence, without)),
                   key=lambda s: s.cost)
    own = periodic_candidates(evidence, null, without=without, seed=seed)
    gains += bounded_gains(evidence, null.centre, null.mean, null.runs, own)
    starts = [_start(s) for s in _spread(sized, SIZED)]
    names = {s.terms[0].variant.name for s in starts}
    more: list[Screened] = [s for s in ranked if s.variant.name not in names][:NEAR]
    starts += [Start((_screened_term(evidence, s),), null.z) for s in (*more, *own)]
    return Proposal(gain=max(gains, default=0.0), starts=starts)


def _spread(sized: Sequence[Sized], keep: int) -> list[Sized]:
    """Return the best, of each effect at most `VARIANTS`."""
    found: list[Sized] = []
    for s in sized:
        same = [f for f in found if f.signature.variant.effect == s.signature.variant.effect]
        if len(same) < VARIANTS:
            found.append(s)
        if len(found) == keep:
            break
    return found


def _start(sized: Sized) -> Start:
    return Start((_term(sized),), sized.z)


def _term(sized: Sized) -> EffectTerm:
    return EffectTerm(variant=sized.signature.variant, signature=sized.signature, u=sized.u)


def _screened_term(evidence: Evidence, screened: Screened) -> EffectTerm:
    return EffectTerm(variant=screened.variant, signature=signature_of(evidence, screened),
                      u=screened.u)


def challengers(
    evidence: Evidence, finished: Sequence[Fit], *, without: Sequence[str] = ()
) -> list[Start]:
    """Return starts of further effects against a small one, nearest to the measurement first.

    A small effect is easily imitated by tolerances that recalibration moved, so the order of the
    library means little; effects of `finished` are left out.
    """
    names = {t.variant.effect for fit in finished for t in fit.terms}
    sizing = Sizing(evidence)
    sized = sorted((sizing.best(stacked(evidence, i))
                    for i in selectable(evidence, [*without, *names])), key=lambda s: s.cost)
    found: dict[str, Sized] = {}
    for s in sized:
        found.setdefault(s.signature.variant.effect, s)
    return [_start(s) for s in found.values()][:CHALLENGERS]


def rescaled(
    evidence: Evidence, rule: Robust, singles: Sequence[Fit], *, seed: int = 0
) -> list[Start]:
    """Return starts of the best effects at other sizes, the best fit itself first.

    A fit may stop at a size at which limit cycles of the simulator happen to resemble those of
    the unit. The simulator is therefore run over all sizes of the library.

    Parameters
    ----------
    evidence : the records.
    rule : metric by which sizes are compared.
    singles : fits, best first; none of them is complete.
    seed : of the runs.
    """
    sizing = Sizing(evidence)
    base = evidence.blocks[0].library.model.effects
    starts = [Start(singles[0].terms, singles[0].z)]
    done: set[str] = set()
    for fit in singles:
        (term,) = fit.terms
        if term.variant.effect in done or len(done) == SCANNED:
            continue
        done.add(term.variant.effect)
        points = grid(term.signature) if term.variant.size == 1 else [
            factor * term.u for factor in FACTORS]
        costs: list[tuple[float, Start]] = []
        asked = [Asked(sizing.tolerances(term.signature.at(u)), term.variant.effects(u, base),
                       rule.runs, seed) for u in points]
        for u, (z, *_), mean in zip(points, asked, evidence.means(asked)):
            if all(np.isfinite(f).all() for f in mean):
                costs.append((rule.cost(evidence, mean, z), Start((EffectTerm(
                    variant=term.variant, signature=term.signature, u=u),), z)))
        lowest = [c for k, c in enumerate(costs)
                  if c[0] <= min(other for other, _ in costs[max(k - 1, 0):k + 2])]
        starts += [start for _, start in sorted(lowest, key=lambda c: c[0])[:SIZES]]
    return starts


def pairs_of(
    evidence: Evidence, singles: Sequence[Fit], *, without: Sequence[str] = (), seed: int = 0
) -> list[Start]:
    """Return pairs of different effects: beside fitted ones, and by superposition."""
    found: list[Start] = []
    seen: set[frozenset[str]] = set()
    done: set[str] = set()
    for fit in singles:
        name = fit.terms[0].variant.effect
        if name in done or len(done) == SECONDS:
            continue
        done.add(name)
        for second in seconds(evidence, fit, without=without)[:SECONDS]:
            _add(found, seen, (*fit.terms, _term(second)), fit.z)
        for s in periodic_candidates(evidence, fit, without=[*without, name], seed=seed):
            _add(found, seen, (*fit.terms, _screened_term(evidence, s)), fit.z)
    most = len(found) + PAIRS
    sizing = Sizing(evidence)
    indices = selectable(evidence, without)
    firsts = _spread(sorted((sizing.best(stacked(evidence, i)) for i in indices),
                            key=lambda s: s.cost), FIRSTS)
    rows: list[tuple[float, Sized, Sized]] = []
    for first in firsts:
        about = Sizing(evidence, added=first.signature.at(first.u))
        for i in indices:
            signature = stacked(evidence, i)
            if signature.variant.effect != first.signature.variant.effect:
                second = about.best(signature)
                rows.append((second.cost, first, second))
    for _, first, second in sorted(rows, key=lambda row: row[0])[:3 * PAIRS]:
        if len(found) < most:
            _add(found, seen, (_term(first), _term(second)), second.z)
    return found


def _add(
    found: list[Start], seen: set[frozenset[str]], terms: tuple[EffectTerm, ...], z: np.ndarray
) -> None:
    key = frozenset(t.variant.name for t in terms)
    if key not in seen:
        seen.add(key)
        found.append(Start(terms, z))


def seconds(evidence: Evidence, fit: Fit, *, without: Sequence[str] = ()) -> list[Sized]:
    """Return what comes nearest to what a fit leaves, one variant an effect, best first."""
    names = {t.variant.effect for t in fit.terms}
    sizing = Sizing(evidence, about=fit)
    sized = sorted((sizing.best(stacked(evidence, i))
                    for i in selectable(evidence, [*without, *names])), key=lambda s: s.cost)
    found: list[Sized] = []
    for s in sized:
        if all(s.signature.variant.effect != f.signature.variant.effect for f in found):
            found.append(s)
    return found


ECCENTRIC = "rotor_eccentricity static"


def twins(evidence: Evidence, fit: Fit, *, without: Sequence[str] = ()) -> list[Start]:
    """Return starts of the effect that makes nearly the same machine as a fit; [] if none does.

    Parameters
    ----------
    evidence : the records.
    fit : of one effect.
    without : effects that are not to be considered.
    """
    (term,) = fit.terms
    base = evidence.blocks[0].library.model.effects
    made = phase_constants(fit.effects(base)) / phase_constants(base)
    phase = int(np.argmin(made))
    fraction = 1.0 - made[phase] / np.delete(made, phase).mean()
    if term.variant.effect == "turn_short":
        zeta, axis = fraction / (1.5 - 0.5 * fraction), phase * THIRD
        wanted = {ECCENTRIC: -zeta * np.array([np.cos(axis), np.sin(axis)])}
    elif term.variant.name == ECCENTRIC:
        wanted = {f"turn_short {PHASES[phase]} {mode}": np.array([fraction])
                  for mode in ("paper", "physical")}
    else:
        return []
    starts = []
    for index in selectable(evidence, without):
        variant = evidence.blocks[0].library.signatures[index].variant
        if variant.name in wanted:
            there = EffectTerm(variant=variant, signature=stacked(evidence, index),
                               u=wanted[variant.name])
            ratio = made * phase_constants(base) / phase_constants(
                variant.effects(there.u, base))
            starts.append(Start((there,), _with_constants(evidence, fit.z, ratio)))
    return starts


def _with_constants(evidence: Evidence, z: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Return tolerances with the constants of the phases changed by `ratio`, in their bands."""
    changes = {"motor.back_emf_constant": ratio.mean() - 1.0} | {
        f"motor.back_emf_deviation_{p}": r / ratio.mean() - 1.0 for p, r in zip(PHASES, ratio)}
    moved = z.copy()
    places = evidence.tolerances.of(0, np.arange(len(z)))  # those of the unit, in every record
    for place, tolerance in zip(places, TOLERANCES):
        moved[place] += changes.get(tolerance.name, 0.0) / tolerance.half_width
    return np.asarray(np.clip(moved, -BAND, BAND))
