"""Step `recalibrate`: the terms of a model file as a balance with bounds."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ema_identification.rig.balance import Balance
from ema_identification.rig.design import Design
from ema_identification.rig.laws import LAWS, Law, Term
from ema_identification.rig.laws.base import amplitude_phase
from ema_identification.rig.model import KnownTerm, RigModel
from ema_identification.rig.regression import Bounds
from ema_record.rig import LOAD_QUANTITY

CARRIED = 1e-6
"""A free regressor that the others repeat to this share of its power is left out."""


def known_balance(model: RigModel, design: Design) -> tuple[Balance, tuple[str, ...]]:
    """Return the balance of the model's terms, and notes on terms that were left out.

    A free term whose regressor the record does not excite (none of it left beside the others)
    is left out and said so.
    """
    axis = design.trajectory.axis
    known = list(model.terms)
    if design.trajectory.has_disturbance and "disturbance" not in {t.effect for t in known}:
        same = axis.input == LOAD_QUANTITY[axis.motion]
        known.append(KnownTerm(effect="disturbance", parameters={"gain": 1.0} if same else {}))
    terms, low, high, notes = [], [], [], []
    for entry in known:
        term = term_of(entry)
        if not term.law.applies(design.trajectory) and not entry.parameters:
            notes.append(f"{entry.effect}: left out, the record has nothing of it")
            continue
        values, free = nominal_coefficients(entry)
        room = entry.tolerance * (math.hypot(*values) if values else 0.0)
        if term.law.looked_for:  # its phase is that of one record
            room, values = room + math.hypot(*values), [0.0] * len(values)
        terms.append(term)
        least = 0.0 if term.law.positive else -math.inf
        low += [least if free else max(value - room, least) for value in values]
        high += [math.inf if free else value + room for value in values]
    design, low, high = _delayed(design, terms, low, high)
    balance = Balance(design=design, terms=tuple(terms),
                      bounds=Bounds(low=np.array(low), high=np.array(high)))
    for index in reversed(range(len(balance.terms))):
        span = balance.span(index)
        if np.isinf(balance.bounds.high[span]).all() and _repeated(balance, span):
            notes.append(f"{balance.terms[index].law.name}: left out, this record does not "
                         "excite it beside the other terms")
            balance = balance.without(index)
    return balance, tuple(notes)


def _delayed(
    design: Design, terms: list[Term], low: list[float], high: list[float]
) -> tuple[Design, list[float], list[float]]:
    """Return the design under a delay that the model has, and the bounds of what is left."""
    at = 0
    for term in terms:
        if term.law.name == "control_delay" and np.isfinite(high[at]):
            lead = 0.5 * (low[at] + high[at])
            low, high = low.copy(), high.copy()
            low[at], high[at] = low[at] - lead, high[at] - lead
            return design.led(lead), low, high
        at += len(term.law.coefficients)
    return design, low, high


def _repeated(balance: Balance, span: slice) -> bool:
    """Return whether other columns explain a column nearly whole."""
    own = balance.columns[:, span]
    others = np.delete(balance.columns, range(span.start, span.stop), axis=1)
    power = float(np.sum(own**2))
    if power == 0.0:
        return True
    if others.shape[1] == 0:
        return False
    scale = np.sqrt(np.maximum(np.mean(others**2, axis=0), 1e-300))
    found, *_ = np.linalg.lstsq(others / scale, own, rcond=1e-10)
    return float(np.sum((own - others / scale @ found) ** 2)) < CARRIED * power


def term_of(entry: KnownTerm) -> Term:
    """Return the term that a line of the model file means."""
    law = LAWS[entry.effect]
    return Term(law=law, shape=tuple(entry.parameters[name] for name in law.shape))


def nominal_coefficients(entry: KnownTerm) -> tuple[list[float], bool]:
    """Return the linear coefficients of a line of the model file, and whether they are free."""
    law = LAWS[entry.effect]
    if law.periodic:
        if "amplitude" not in entry.parameters:
            return [0.0, 0.0], True
        size, phase = entry.parameters["amplitude"], entry.parameters["phase"]
        return [size * math.cos(phase), size * math.sin(phase)], False
    values = [entry.parameters.get(name) for name in law.coefficients]
    free = any(value is None for value in values)
    return [0.0 if value is None else value for value in values], free


def physical(law: Law, shape: Sequence[float], coefficients: np.ndarray) -> dict[str, float]:
    """Return all parameters of a term by name, periodic ones as amplitude and phase."""
    named = dict(zip(law.shape, (float(value) for value in shape)))
    if law.periodic:
        size, phase = amplitude_phase(float(coefficients[0]), float(coefficients[1]))
        return {**named, "amplitude": size, "phase": phase}
    return {**named, **dict(zip(law.coefficients, (float(c) for c in coefficients)))}
