"""The synthetic panel: every effect on two rigs, and rigs with nothing missing."""

from __future__ import annotations

from collections import Counter
from functools import partial
from pathlib import Path

from benchmarks.ledger import Ledger
from ema_identification.rig.workflow import identify_rig
from support.rigs import EFFECTS, RIGS, Rig, judged, make

SIZE = 0.3
"""Of an effect, in units of the rms input without it."""


def panel(nulls: int, *, seed: int = 0, work: Path | None = None) -> None:
    """Print what is found on synthetic rigs.

    Parameters
    ----------
    nulls : int
        Number of records with nothing missing; half of them with coloured noise.
    seed : int
        Draws other motions and noise.
    work : Path, optional
        Lines of JSON of what is done; those that are there are not done again.

    """
    rigs = list(RIGS.values())
    cases = [(rigs[(index + 3 * k) % len(rigs)], 5000 + 10 * index + k, name)
             for index, name in enumerate(EFFECTS) for k in range(2)]
    cases += [(rigs[k % len(rigs)], 9000 + k, "") for k in range(nulls)]
    ledger = Ledger(work)
    counts: Counter[str] = Counter()
    for rig, own, name in cases:
        key = f"{rig.name}-{100_000 * seed + own}-{name}"
        answer, said = ledger.run(key, partial(_case, rig, 100_000 * seed + own, name))
        counts[answer] += 1
        if name or answer == "alarm":
            print(f"{answer:7s} {name or 'nothing':24s} on {key:30s} {said}", flush=True)
    print(f"{len(cases) - nulls} rigs with one effect: right {counts['right']}, "
          f"wrong {counts['wrong']}, missed {counts['missed']}; "
          f"{nulls} with nothing missing: {counts['alarm']} disagree")


def _case(rig: Rig, seed: int, name: str) -> tuple[str, str]:
    """Return the judgement of one rig, and what was said of it."""
    if name:
        found = identify_rig([make(rig, seed, {name: SIZE})])
        answer = judged(name, found)
    else:
        found = identify_rig([make(rig, seed, coloured=seed % 2 == 1)])
        answer = "quiet" if found.verdict == "no disagreement" else "alarm"
    names = ", ".join("/".join((f.effect, *f.equivalent)) for f in found.findings)
    unknown = found.unknown.text if found.unknown is not None else ""
    return answer, f"{found.verdict}: {names} {unknown}".rstrip()
