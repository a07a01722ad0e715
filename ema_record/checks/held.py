"""The rule on held values: samples of a current that were stored and not taken.

A converter that is coarse, or a current that is quiet, repeats values too. That is told apart:
changes of a held channel are larger than the steps of its converter, or come in a fixed beat; and
a long run of one value is another matter (`values.stuck`).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ema_record.channels import CHANNELS, REFERENCE_CURRENTS, TIME, median
from ema_record.checks.facts import SETTLED, BagFacts, Hit, Rule

HELD = 0.05
"""Share of the samples of a driven phase current that repeat the one before."""
COARSE = 0.5
"""Added to it over the median change in steps of the converter: what rounding repeats, doubled."""
FINE = 2.0
"""Median change, in those steps, from which rounding explains few repeats."""
BEAT = 0.5
"""Changes that follow a change at once, of those by chance, that only a fixed beat has."""
LONGEST = 16
"""Samples for which a value is held; longer is a current that stands still."""
DRIVEN = 1e-3
"""Current that counts as driven, of the limit, where the references were not recorded."""


def held(facts: BagFacts) -> Iterator[Hit]:
    """Find phase currents that often repeat the sample before: samples were not taken."""
    s = facts.samples
    off = facts.profile.inverter_off + SETTLED if facts.profile else 0.0
    s = s[int(np.searchsorted(s[:, TIME], off)):]
    if facts.has_references:
        driven = (s[1:, REFERENCE_CURRENTS] != 0.0).any(axis=1)
    else:
        least = DRIVEN * facts.actuator.inverter.current_limit
        driven = (np.abs(s[1:, facts.currents]) > least).any(axis=1)
    if driven.sum() < facts.window:
        return
    for column in facts.currents:
        share, first = held_share(np.abs(np.diff(s[:, column])), driven)
        if share > HELD:
            name = CHANNELS[column].name
            yield Hit(f"{100 * share:.0f} % of the samples of {name} repeat the one before",
                      float(s[1 + first, TIME]), share, "", name)


def held_share(change: np.ndarray, driven: np.ndarray) -> tuple[float, int]:
    """Return the share of samples that are held, 0 where rounding explains it, and the first.

    Parameters
    ----------
    change : ndarray, shape (n,). Absolute changes from sample to sample (A).
    driven : ndarray of bool, shape (n,). Where they count.
    """
    same = change == 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    driven = driven.copy()
    long = edges[1::2] - edges[::2] >= LONGEST
    for begin, end in zip(edges[::2][long].tolist(), edges[1::2][long].tolist()):
        driven[begin:end] = False
    repeats, changes = driven & same, change[driven & ~same]
    if not (len(changes) and repeats.any()):
        return 0.0, 0
    share = float(repeats.sum() / driven.sum())
    steps = float(median(changes) / changes.min())
    after = ~same[:-1] & driven[1:]  # samples after a change
    follows = float((after & ~same[1:]).sum() / max(1, int(after.sum())))
    beaten = follows < BEAT * (1.0 - share)
    rough = steps > FINE and share > HELD + COARSE / steps
    return (share if beaten or rough else 0.0), int(np.argmax(repeats))


RULES = (
    Rule(name="held_samples", find=held,
         remedy="check the transducer, its screen and its plug, then record the test again"),
)
