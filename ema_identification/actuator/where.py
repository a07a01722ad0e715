"""Where: which signals disagree, against what, in which part of the test."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from ema_identification.actuator.evidence import Evidence, noise_covariance
from ema_identification.actuator.recalibration import Recalibration
from ema_identification.identification import Shape, Where


def _shares(ev: Evidence, null: Recalibration) -> list[tuple[float, str, str, str, str]]:
    """Return (excess, signal, against, place, feature) by signal and place, largest first."""
    groups: dict[tuple[str, str, str], list[tuple[float, str]]] = defaultdict(list)
    slopes = ev.slopes(null.centre)
    for block, f, slope in zip(ev.blocks, null.mean, slopes):
        noise = np.sqrt(np.diag(noise_covariance(block, runs=null.runs)))
        r = (block.values - f - slope @ (null.z - null.centre)) / noise
        texts = {s.name: s.text for s in block.library.fmap.plan.segments}
        texts |= {t.name: t.text for t in block.library.fmap.plan.transitions}
        for feature, x in zip(block.library.fmap.features, r):
            place = texts.get(feature.place, "whole record")
            groups[feature.signal, feature.against, place].append((float(x), feature.name))
    found = []
    for (signal, against, place), items in groups.items():
        values = np.array([x for x, _ in items])
        excess = float((np.log1p(values**2)).sum() - 0.5 * len(values))
        largest = items[int(np.argmax(np.abs(values)))][1]
        found.append((excess, signal, against, place, largest))
    return sorted(found, reverse=True)


def where_of(ev: Evidence, null: Recalibration) -> Where:
    """Return where the residual of the recalibrated model is largest."""
    _, signal, against, place, feature = _shares(ev, null)[0]
    return Where(signal=signal, against=against, text=f"{signal} against {against}: {place} "
                 f"(largest at {feature})")


def unknown_shape(ev: Evidence, null: Recalibration) -> Shape:
    """Return what is known of an effect that the catalogue does not hold."""
    where = where_of(ev, null)
    return Shape(port=where.signal, text=where.text)
