"""Which laws are worth fitting: the whole catalogue, read off the library without a run.

About the recalibrated unit a law's gain is linear, in closed form (`linear_gains`): by it the test
for nothing and the search for a second law go. A large law is not a small one scaled up: its
signatures are compared size by size about the middle of the fleet too (`sized`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.fleet.surrogate import Whitener, worst
from ema_identification.actuator.laws.catalogue import Signature, ripple
from ema_identification.actuator.laws.terms import EffectTerm, LawFit

ANGLES, CHORDS = 8, 3
"""Directions of a vector at each of its levels; steps towards the unit."""


class Scores(NamedTuple):
    """In what a unit may be rare."""

    cost: float
    """A feature."""
    gain: float
    """Of the best law (`gain_of`)."""
    gap: float
    """`worst`."""
    ripple: float
    """Of the torque, at the order that is off most (`ripple_power`): most have no signature."""


class LawProposal(NamedTuple):
    """A law at a size, and what it would leave."""

    signature: Signature
    u: np.ndarray
    z: np.ndarray
    cost: float

    @property
    def term(self) -> EffectTerm:
        """The law, to be fitted."""
        return EffectTerm(variant=self.signature.variant, signature=self.signature, u=self.u)


def selectable(unit: TestedUnit, without: Sequence[str]) -> list[Signature]:
    """Return the signatures that may be named: not hidden, not of a measured condition."""
    return [s for s in unit.library.signatures if s.variant.effect not in without
            and s.variant.condition not in unit.conditions.measured]


def _directions(signature: Signature) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return (coordinates, features added) of single sizes; of vectors each part's least."""
    found = []
    for k, (levels, values) in enumerate(zip(signature.levels, signature.values)):
        for x, row in zip(levels, values):
            if x != 0.0:
                u = np.zeros(signature.variant.size)
                u[k] = x
                found.append((u, row))
    return found


def linear_gains(
    unit: TestedUnit, fit: LawFit, white: Whitener, signatures: Sequence[Signature]
) -> list[LawProposal]:
    """Return each law at the size of its largest linear gain, best first.

    What a law gains while everything else that is fitted gives way: g²/h, g the pull along it, h
    its square less what the other columns can do; numbers at a bound do not give way. `cost` is
    J less the gain.
    """
    rest = unit.values - fit.mean
    target = white.residual(rest)
    inside = np.append(np.ones(fit.free, dtype=bool), np.abs(fit.z) < unit.edge - 1e-6)
    others = white.columns(fit.slopes[:, inside], rest)
    weight = np.append(np.zeros(fit.free), unit.weight)[inside]
    normal = others.T @ others + np.diag(weight + 1e-9)
    places = [_directions(s) for s in signatures]
    if not any(places):
        return []
    columns = white.columns(np.array([row for known in places for _, row in known]).T, rest)
    across = others.T @ columns
    at = np.append(np.zeros(fit.free), fit.z - unit.centre)[inside]
    owed = np.linalg.solve(normal, others.T @ target - weight * at)  # a last step of the others
    pull = columns.T @ target - across.T @ owed
    square = (columns**2).sum(axis=0) - (across * np.linalg.solve(normal, across)).sum(axis=0)
    found: dict[str, LawProposal] = {}
    start = 0
    for signature, known in zip(signatures, places):
        part = slice(start, start + len(known))
        start += len(known)
        u, gain = _largest_gain(signature, [u for u, _ in known], pull[part],
                                np.maximum(square[part], 1e-12), columns[:, part],
                                across[:, part], normal)
        found[signature.variant.name] = LawProposal(signature, u, fit.z, fit.cost - gain)
    return sorted(found.values(), key=lambda p: p.cost)


def _largest_gain(
    signature: Signature, places: Sequence[np.ndarray], pull: np.ndarray, square: np.ndarray,
    columns: np.ndarray, across: np.ndarray, normal: np.ndarray,
) -> tuple[np.ndarray, float]:
    known = [k for k, levels in enumerate(signature.levels) if len(levels) > 1]
    if len(known) == 1:  # along the curve: a part of each size, at most twice it
        part = np.clip(pull / square, 0.0, 2.0)
        gains = 2.0 * part * pull - part**2 * square
        best = int(np.argmax(gains))
        return part[best] * places[best], float(gains[best])
    least = []
    for k in known:  # a vector: the parts together, each by its least size
        along = [i for i, u in enumerate(places) if u[k] > 0.0]
        least.append(min(along, key=lambda i: places[i][k]))
    own, others = columns[:, least], across[:, least]
    whole = own.T @ own - others.T @ np.linalg.solve(normal, others)
    ridge = 1e-9 * np.trace(whole) + 1e-12  # a law may do nothing
    part = np.linalg.solve(whole + ridge * np.eye(len(known)), pull[least])
    u = np.clip(np.sum([value * places[i] for value, i in zip(part, least)], axis=0),
                signature.variant.low, signature.variant.high)
    return u, float(max(part @ pull[least], 0.0))


def at_known_sizes(proposals: Sequence[LawProposal]) -> list[LawProposal]:
    """Return each law in its direction at each size that the library knows."""
    return [p._replace(u=np.clip(p.u * size / np.linalg.norm(p.u), p.signature.variant.low,
                                 p.signature.variant.high))
            for p in proposals if np.any(p.u)
            for size in np.unique(np.abs(np.concatenate(p.signature.levels))) if size > 0.0]


def sized(unit: TestedUnit, signatures: Sequence[Signature]) -> list[LawProposal]:
    """Return each law at the library's size that comes nearest, all else fitted to it roughly.

    The unit is found by steps of plain least squares with the slopes where it is expected.
    """
    white, middle = unit.whitener(0), unit.centre
    plain = replace(white, straight=True)
    columns = plain.columns(unit.slope(middle), np.zeros(unit.size))
    inverse = np.linalg.inv(columns.T @ columns + np.diag(unit.weight))
    points = [(s, u) for s in signatures for u in _points(s)]
    if not points:
        return []
    wanted = unit.values[:, None] - np.array([s.at(u) for s, u in points]).T
    centre, weight = middle[:, None], unit.weight[:, None]
    edge = np.broadcast_to(unit.edge, len(middle))[:, None]
    z = np.tile(centre, (1, len(points)))
    for _ in range(CHORDS):
        rest = plain.residual(wanted - unit.means(z.T).T)
        z = np.clip(z + inverse @ (columns.T @ rest - weight * (z - centre)), -edge, edge)
    left = white.residual(wanted - unit.means(z.T).T)
    cost = (left**2).sum(axis=0) + (weight * (z - centre) ** 2).sum(axis=0)
    best: dict[str, LawProposal] = {}
    for i in np.argsort(cost):
        signature, u = points[i]
        best.setdefault(signature.variant.name,
                        LawProposal(signature, u, z[:, i], float(cost[i])))
    return sorted(best.values(), key=lambda p: p.cost)


def _points(signature: Signature) -> list[np.ndarray]:
    levels, size = signature.levels, signature.variant.size
    if size == 2 and all(len(x) > 1 for x in levels) and math.isclose(
            levels[0].max(), levels[1].max()):
        return [float(r) * np.array([math.cos(a), math.sin(a)])
                for r in levels[0] if r > 0.0 for a in 2.0 * math.pi * np.arange(ANGLES) / ANGLES]
    found = []
    for k, row in enumerate(levels):
        dense = np.unique(np.concatenate([row, 0.5 * (row[1:] + row[:-1])]))
        for x in dense[dense != 0.0]:
            u = np.zeros(size)
            u[k] = x
            found.append(u)
    return found


def scores(unit: TestedUnit) -> Scores:
    """Return the numbers in which a unit without a law may be rare, on the quadratic."""
    fit, white = unit.without_law(), unit.whitener(0)
    return scores_of(unit, fit, linear_gains(unit, fit, white, selectable(unit, ())))


def scores_of(unit: TestedUnit, fit: LawFit, gains: Sequence[LawProposal]) -> Scores:
    """Return the scores of a fit without a law, of which `gains` are those of laws."""
    deviation = np.sqrt(np.diag(unit.covariance(fit.runs)))
    gain = gain_of(fit.cost, gains[0].cost, unit.size) if gains else 0.0
    ripple = max(ripple_left(unit, fit, deviation).values(), default=0.0)
    return Scores(
        fit.cost / unit.size, gain, worst([(unit.values - fit.mean) / deviation])[0], ripple)


def gain_of(cost: float, lower: float, size: int) -> float:
    """Return a fall of the cost in units of what is left a feature."""
    return (cost - lower) / max(lower / size, 1e-9)


MOST_OFF = 10.0
LOWEST, RIPPLE_RUNS, COGGING, RIPPLE_SIZES = 3, 4, 0.05, (1.0, 4.0)
"""Periods a turn from which on ripple is looked for, in all lines; lower ones are windings'. Runs
at a size, of dry friction or of its twist of the shaft; sizes, in this, from which fits begin."""


def ripple_power(unit: TestedUnit, rest: np.ndarray) -> dict[int, float]:
    """Return by periods a turn the mean square of what is left of the torque lines there.

    `rest` in deviations, shape (d,); beyond `MOST_OFF` a line counts no more.
    """
    power: dict[int, list[float]] = {}
    pairs = unit.library.model.actuator.motor.pole_pairs
    for feature, x in zip(unit.library.fmap.features, rest):
        kind, line, of = feature.name.rpartition(".")[2].rpartition("torque_line_")
        order = int(of.split("_")[0]) if line else 0
        if kind in ("turn_", "") and order >= LOWEST:
            periods = order if kind else order * pairs  # of the rotor's turn, of the electrical
            power.setdefault(periods, []).append(min(abs(float(x)), MOST_OFF) ** 2)
    return {periods: float(np.mean(of)) for periods, of in power.items()}


def ripple_left(unit: TestedUnit, fit: LawFit, deviation: np.ndarray) -> dict[int, float]:
    """Return the lesser `ripple_power` of those that a fit leaves on its runs and on the library.

    A few runs that ring have lines of their own. `deviation` : of what the runs leave, shape (d,).
    """
    power, known = (ripple_power(unit, (unit.values - mean) / scale) for mean, scale in (
        (fit.mean, deviation), (unit.known(fit.terms, fit.z), unit.whitener(0).deviation)))
    return {periods: min(of, known[periods]) for periods, of in power.items()}


def ripples(
    unit: TestedUnit, fit: LawFit, white: Whitener, without: Sequence[str]
) -> list[LawProposal]:
    """Return ripple at the order whose torque lines are off most, signatures simulated."""
    power = ripple_left(unit, fit, white.deviation)
    if not power:
        return []
    periods = max(power, key=power.__getitem__)
    a, found = unit.library.model.actuator, []
    for effect, level in (
            ("cogging_torque", COGGING * a.motor.dynamic_friction),
            ("gear_mesh_ripple", COGGING * 0.5 * a.surface.dynamic_friction / a.shaft.stiffness)):
        if effect in without:
            continue
        variant = ripple(effect, periods, *(level * x for x in RIPPLE_SIZES))
        levels = np.sort(np.append(variant.levels[0], 0.0))
        flat = Signature(variant=variant, levels=(levels,) * 2,
                         values=(np.zeros((len(levels), unit.size)),) * 2)
        steps = [EffectTerm(variant=variant, signature=flat, u=level * x) for x in np.eye(2)]
        base, *there = unit.run_all([(fit.terms, fit.z), *(
            ((*fit.terms, t), fit.z) for t in steps)], RIPPLE_RUNS, 17)
        if np.isfinite([base, *there]).all():
            found += linear_gains(unit, fit, white, [replace(flat, values=tuple(
                np.outer(levels / level, f - base) for f in there))])
    return found


def alternating(lists: Sequence[Sequence[LawProposal]], most: int) -> list[LawProposal]:
    """Return the first of each list in turn, at most two variants of one effect."""
    found: list[LawProposal] = []
    rows = range(max((len(x) for x in lists), default=0))
    for p in (x[row] for row in rows for x in lists if row < len(x)):
        alike = [f.signature.variant for f in found
                 if f.signature.variant.effect == p.signature.variant.effect]
        known = p.signature.variant.name in {v.name for v in alike}
        if len(found) < most and len(alike) < 2 and not known and np.any(p.u):
            found.append(p)
    return found
