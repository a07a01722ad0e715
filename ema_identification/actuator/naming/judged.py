"""What held-out records change in an answer: settled, named after all, or one effect less."""

from __future__ import annotations

from dataclasses import replace

from ema_identification.actuator.naming.answer import COMPLETE, FARTHEST, FELL, Answer
from ema_identification.actuator.naming.gap import Gap, gap_of
from ema_identification.actuator.surrogate.evidence import Evidence
from ema_sim.model_file import Model

SHOWS, CLOSED = 1.5, 1.2
"""Noise floors at which a held-out record shows a gap, and up to which it is closed."""


def settled(answer: Answer, before: Gap, after: Gap) -> Answer:
    """Return the answer after the held-out record: it may show that nothing is left.

    A large effect makes limit cycles that repeat less well than those of an effect-free unit, so
    its fit can look incomplete; the noise floor of the updated model itself knows of that.
    """
    closed = before.value >= SHOWS * before.floor and after.value <= CLOSED * after.floor
    if answer.verdict != "partly explained" or not closed:
        return answer
    return replace(answer, verdict="explained", reasons=(
        "the fitted record holds more than the noise of an effect-free unit, but the held-out "
        f"record holds no more than the updated model's own: {after.value:.1f}, floor "
        f"{after.floor:.1f}",))


def predicted(
    ev: Evidence, held: Evidence, answer: Answer, before: Gap, model: Model, seed: int
) -> tuple[Answer, Gap] | None:
    """Return the answer that held-out records give where the fit alone names nothing.

    The best effect is named if it explains most of the record, predicts the held-out records to
    their floor, and the next best name does not. None if that is not so.
    """
    fits = sorted(answer.fits, key=lambda f: f.cost)
    others = [f for f in fits if f.terms[0].variant.effect != fits[0].terms[0].variant.effect
              ] if fits else []
    if not others or before.value < SHOWS * before.floor:
        return None
    best = fits[0]
    above = best.cost - ev.usual
    if best.cost > FARTHEST * ev.usual or above > FELL * (answer.null_cost - ev.usual):
        return None
    gap, rival = (gap_of(ev, held, f, f.effects(model.effects), seed=seed)
                  for f in (best, others[0]))
    if gap.value > CLOSED * gap.floor or rival.value < 2.0 * gap.value:
        return None
    scale = ev.blocks[0].library.scale
    p = scale.p_gain((answer.null_cost - best.cost) / max(best.cost / ev.size, 1e-9))
    return replace(answer, verdict="partly explained", fit=best, equivalent=((),), p_value=(p,)
                   ), gap


def without_second(answer: Answer, usual: float) -> Answer:
    """Return the answer with one of its two effects, after held-out records spoke against two.

    `usual` is the cost that a complete model leaves.
    """
    one, fit = answer.simpler, answer.fit
    assert one is not None and fit is not None
    kept = [t.variant.effect for t in fit.terms].index(one.terms[0].variant.effect)
    return replace(
        answer, verdict="explained" if one.cost < COMPLETE * usual else "partly explained",
        fit=one, simpler=None, equivalent=(answer.equivalent[kept],),
        p_value=(answer.p_value[kept],), reasons=(
            f"the held-out record is predicted no worse without "
            f"{fit.terms[1 - kept].variant.effect}, so that is not named",))
