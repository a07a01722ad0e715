"""Ripple of any period: the clearest torque line that is left makes a candidate of its order."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.effect_library import Signature
from ema_identification.actuator.evidence import Evidence
from ema_identification.actuator.held_out import whitened
from ema_identification.actuator.recalibration import Recalibration
from ema_identification.actuator.refit import Fit
from ema_identification.actuator.screening import Screened, best_of, residual
from ema_identification.actuator.variants import ripple

STRONG = 8.0
"""Least residual of a line (standard deviations, re and im)."""
COHERENT = 0.85
"""Least part of the power of a line that has one phase in all sections."""
ALONE = 20.0, 0.95
"""The same two for the sections of one speed alone: two of them agree by chance more often."""
LOWEST = 3
"""Lower orders belong to windings and commutation."""
RIPPLES = ("cogging_torque", "gear_mesh_ripple")
RUNS = 4
SHARE = 0.05
"""Of the size of an effect found before, by which it may give way (times 100, `residual`)."""
SHAFT_SHARE = 1e-5
"""Transmission error (rad) that makes a ripple of some 0.01 N m."""


class _Line(NamedTuple):
    """A line of one order in the sections of one group."""

    common: float
    """Power of one phase (variances, re and im)."""
    coherence: float
    """The same, of all its power."""
    amplitude: float
    """N m."""
    place: str


def largest_line(
    evidence: Evidence, residual: Sequence[np.ndarray]
) -> tuple[int, float, str] | None:
    """Return order, amplitude (N m) and segment of the clearest torque line that is left.

    A ripple of the machine has one phase in rotor angle in all sections of the test, or one that
    turns over with the direction; a limit cycle that keeps step with the rotor in one section has
    neither.
    """
    block, r = evidence.blocks[0], residual[0]
    deviation = block.library.null.deviation(block.conditions.noise)
    segments = {s.name: s for s in block.library.fmap.plan.segments}
    found: dict[int, dict[str, complex]] = defaultdict(lambda: defaultdict(complex))
    widths: dict[tuple[int, str], float] = defaultdict(float)
    for feature, x, sd in zip(block.library.fmap.features, r, deviation):
        if ".torque_line_" in feature.name:
            order = int(feature.name.split("_")[2])
            found[order][feature.place] += float(x * sd) * (
                1.0 if feature.name.endswith("_re") else 1j)
            widths[order, feature.place] += 0.5 * float(sd)**2
    groups = [(list(segments), STRONG, COHERENT)] + [
        ([n for n, s in segments.items() if round(abs(s.speed), 3) == v], *ALONE)
        for v in sorted({round(abs(s.speed), 3) for s in segments.values()}, reverse=True)]
    clear: dict[int, list[_Line]] = defaultdict(list)
    for among, strong, coherent in groups:
        for order, places in found.items():
            chosen = [p for p in among if p in places]
            if len(chosen) < 2:
                continue
            lines = np.array([places[p] for p in chosen])
            weight = 1.0 / np.array([widths[order, p] for p in chosen])
            sense = np.sign([segments[p].speed for p in chosen])
            along = max((_along(lines, weight), _along(sense * lines, weight)), key=np.sum)
            power = weight * np.abs(lines)**2
            common = float(along.sum())
            if (common > max(2.0 * strong**2, coherent * power.sum())
                    and common - along.max() > strong**2):
                clear[order].append(_Line(
                    common=common, coherence=common / float(power.sum()),
                    amplitude=2e-3 * float(power @ np.abs(lines) / power.sum()),
                    place=chosen[int(np.argmax(power))]))
    if not clear:
        return None
    order = max(clear, key=lambda o: max(line.common for line in clear[o]))
    line = max(clear[order], key=lambda x: x.coherence)
    return order, line.amplitude, segments[line.place].text


def _along(lines: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the power of each line along the phase that most of their power has.

    How large a line is may differ among sections: at low speed the shaft holds the rotor, and the
    current sees less of the same ripple.
    """
    whole = weight * np.abs(lines) @ lines
    if whole == 0.0:
        return np.zeros(len(lines))
    return np.asarray(weight * np.maximum(0.0, (lines * np.conj(whole / abs(whole))).real)**2)


def free_columns(fit: Fit) -> list[np.ndarray]:
    """Return what a share of each fitted coordinate adds, shape (d,) each.

    In units of the features, not of the coordinate: a transmission error of 1 rad would move them
    by so much that nothing else counted.
    """
    sizes = np.repeat([float(np.linalg.norm(t.u)) for t in fit.terms],
                      [t.variant.size for t in fit.terms])
    return list((SHARE * fit.slopes[:, :fit.free] * sizes).T)


def periodic_candidates(
    evidence: Evidence, about: Recalibration | Fit, *, without: Sequence[str] = (), seed: int = 0,
) -> list[Screened]:
    """Return ripple effects with the order of the clearest line that `about` leaves."""
    line = largest_line(evidence, whitened(evidence, about))
    if line is None or line[0] < LOWEST:
        return []
    order, torque, _ = line
    base = evidence.blocks[0].library.model
    turn = order * base.actuator.motor.pole_pairs
    if isinstance(about, Fit):
        effects, centre = about.effects(base.effects), about.z
        free = free_columns(about)
    else:
        effects, centre, free = base.effects, about.centre, []
    rest = residual(evidence, centre, about.mean, runs=about.runs, free=free)
    found = []
    for effect in RIPPLES:
        if effect in without:
            continue
        level = torque if effect == "cogging_torque" else SHAFT_SHARE
        variant = ripple(effect, turn, level)
        values = []
        for k in range(2):
            u = np.zeros(2)
            u[k] = level
            runs = evidence.mean(centre, variant.effects(u, effects), runs=RUNS, seed=seed + 20)
            values.append(np.concatenate(runs) - np.concatenate(about.mean))
        if not np.isfinite(values).all():
            continue
        own = Signature(
            variant=variant, levels=(np.array([-level, 0.0, level]),) * 2,
            values=tuple(np.array([-v, np.zeros_like(v), v]) for v in values))
        screened = best_of(own, -1, rest)
        if math.hypot(*screened.u) > 0.0:
            found.append(Screened(variant=variant, index=-1, u=screened.u, cost=screened.cost,
                                  z=about.z, own=own))
    return found
