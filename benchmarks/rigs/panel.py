"""The synthetic panel: every effect on two rigs, and rigs with nothing missing."""

from __future__ import annotations

from collections import Counter

from benchmarks.rigs.synthetic import EFFECTS, RIGS, STRANGERS, make
from ema_identification.identification import Identification
from ema_identification.rig.workflow import identify_rig

SIZE = 0.3
"""Of an effect, in units of the rms input without it."""
NEEDS = {"stribeck_friction": {"coulomb_friction"}, "presliding_hysteresis": {"coulomb_friction"}}
"""What an effect of the panel consists of beside itself."""


def judged(name: str, found: Identification) -> str:
    """Return ``right``, ``wrong`` or ``missed`` for one effect."""
    sets = [{f.effect, *f.equivalent} for f in found.findings]
    if name in STRANGERS:
        if sets:
            return "wrong"
        return "right" if found.unknown is not None else "missed"
    needed = {name} | NEEDS.get(name, set())
    if any(not (named & needed) for named in sets):
        return "wrong"
    return "right" if any(name in named for named in sets) else "missed"


def panel(nulls: int) -> None:
    """Print what is found on synthetic rigs.

    Parameters
    ----------
    nulls : int
        Number of records with nothing missing; half of them with coloured noise.

    """
    rigs = list(RIGS.values())
    counts: Counter[str] = Counter()
    for index, name in enumerate(EFFECTS):
        for k in range(2):
            rig = rigs[(index + 3 * k) % len(rigs)]
            found = identify_rig([make(rig, 5000 + 10 * index + k, {name: SIZE})])
            answer = judged(name, found)
            counts[answer] += 1
            said = ", ".join("/".join((f.effect, *f.equivalent)) for f in found.findings)
            unknown = found.unknown.text if found.unknown is not None else ""
            print(f"{answer:7s} {name:24s} on {rig.name:8s} {found.verdict}: {said} {unknown}",
                  flush=True)
    alarms = 0
    for seed in range(nulls):
        rig = rigs[seed % len(rigs)]
        found = identify_rig([make(rig, 9000 + seed, coloured=seed % 2 == 1)])
        if found.verdict != "no disagreement":
            alarms += 1
            print(f"alarm on {rig.name} seed {9000 + seed}: {found.verdict} "
                  f"{[f.effect for f in found.findings]} {found.unknown}", flush=True)
    print(f"effects: {dict(counts)}; nothing missing: {alarms} of {nulls} disagree")
