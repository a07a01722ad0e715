"""The terms of a model file as a balance with bounds, and a factor that is common to all of them.

Known terms that are all off by one factor look like a wrong gain of the input.
"""

from __future__ import annotations

import math

import numpy as np

from ema_identification.rig.fit.balance import Design, InputBalance
from ema_identification.rig.fit.model import KnownTerm, RigModel
from ema_identification.rig.fit.regression import CoefficientBounds
from ema_identification.rig.laws import LAWS
from ema_identification.rig.laws.base import Term
from ema_rig.record import LOAD_QUANTITY

CARRIED = 1e-6
"""A free regressor that the others repeat to this share of its power is left out."""


def known_balance(model: RigModel, design: Design) -> tuple[InputBalance, tuple[str, ...]]:
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
    balance = InputBalance(
        design=design, terms=tuple(terms),
        bounds=CoefficientBounds(low=np.array(low), high=np.array(high)))
    for index, name in enumerate(balance.names):
        at = balance.span(index).start
        if name == "control_delay" and math.isfinite(high[at]):  # its middle is a shift in time
            balance = balance.later(0.5 * (low[at] + high[at]), at)
            break
    for index in reversed(range(len(balance.terms))):
        span = balance.span(index)
        if np.isinf(balance.bounds.high[span]).all() and repeated(balance, span):
            notes.append(f"{balance.terms[index].law.name}: left out, this record does not "
                         "excite it beside the other terms")
            balance = balance.without(index)
    return balance, tuple(notes)


def repeated(balance: InputBalance, span: slice) -> bool:
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


ALIKE = 0.05
"""Spread of the factors, over their mean, within which they count as one."""


def common_factor(start: InputBalance, end: InputBalance) -> float | None:
    """Return the factor by which all known terms differ from the model, None without one.

    Parameters
    ----------
    start : the model as given; terms with bounds are known.
    end : with what was found; one of the known terms was replaced.

    Returns
    -------
    float or None
        Only where two known terms or more share it and it is beyond `ALIKE`.
    """
    factors = []
    replaced = False
    for index, term in enumerate(start.terms):
        span = start.span(index)
        low, high = start.bounds.low[span], start.bounds.high[span]
        if len(low) != 1 or term.law.dynamic or not np.isfinite(high[0]) or not low[0] + high[0]:
            continue
        own = index
        if end.replaced(index):
            replaced = True
            own = len(end.names) - 1 - end.names[::-1].index(term.law.name)
        value = float(end.fit.coefficients[end.span(own)][0])
        factors.append(2.0 * value / float(low[0] + high[0]))
    if not replaced or len(factors) < 2:
        return None
    mean = float(np.mean(factors))
    if max(factors) - min(factors) > ALIKE * abs(mean) or abs(mean - 1.0) <= ALIKE:
        return None
    return mean
