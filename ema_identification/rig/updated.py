"""Step `add`: the model file with what was found."""

from __future__ import annotations

import numpy as np

from ema_identification.rig.known import physical
from ema_identification.rig.model import (
    DEFAULT_TOLERANCE,
    KnownTerm,
    RigModel,
    Settings,
    dump_rig_model,
)
from ema_identification.rig.regression import covariance, half_width
from ema_identification.rig.steps import Story

MOST = 1.0
"""Largest tolerance that is written."""


def updated_text(given: RigModel, story: Story) -> str:
    """Return the YAML of the model with all terms that were found.

    Every term gets its value and a tolerance that holds its interval; terms that were free
    in the model stay free.
    """
    balance, blocks = story.found.balance, story.blocks
    trajectory = story.trajectory
    free = {term.effect for term in given.terms if not term.parameters}
    variance = covariance(balance.free_columns, balance.fit.residual, blocks)
    place = np.cumsum(~balance.fixed) - 1
    terms = []
    for index, term in enumerate(balance.terms):
        span = balance.span(index)
        if balance.replaced(index):
            continue
        if index < len(story.start.terms) and term.law.name in free:
            terms.append(KnownTerm(effect=term.law.name))
            continue
        values = balance.fit.coefficients[span]
        if term.law.name == "control_delay":
            values = values + balance.design.lead
        wide = [half_width(variance[place[k], place[k]], blocks)
                for k in range(span.start, span.stop) if not balance.fixed[k]]
        size = float(np.linalg.norm(values)) or 1.0
        tolerance = min(MOST, max(DEFAULT_TOLERANCE, 1.5 * max(wide, default=0.0) / size))
        terms.append(KnownTerm(effect=term.law.name,
                               parameters=physical(term.law, term.shape, values),
                               tolerance=float(f"{tolerance:.3g}")))
    settings = Settings(**{
        **given.settings.model_dump(exclude_none=True),
        **({} if given.settings.decimate else {"band": float(f"{trajectory.band:.6g}")}),
        "standstill": float(f"{trajectory.standstill:.6g}"),
    })
    names = ", ".join(f.effect for f in story.findings) or "nothing"
    return dump_rig_model(
        RigModel(rig=given.rig if given.rig != "rig" else trajectory.axis.name,
                 terms=tuple(terms), settings=settings),
        f"Updated by ema identify: added {names}.\nInput: "
        f"{trajectory.axis.input_channel.label}; {trajectory.axis.motion} axis.")
