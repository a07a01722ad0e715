"""The synthetic panel: every effect on two rigs, and rigs with nothing missing."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

from benchmarks.rigs.synthetic import EFFECTS, RIGS, STRANGERS, Rig, make
from ema_identification.result import Identification
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
    done = _done(work)
    counts: Counter[str] = Counter()
    for rig, own, name in cases:
        key = f"{rig.name}-{100_000 * seed + own}-{name}"
        if key not in done:
            done[key] = _case(rig, 100_000 * seed + own, name)
            if work is not None:
                with work.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps([key, done[key]]) + "\n")
        answer, said = done[key]
        counts[answer] += 1
        if name or answer == "alarm":
            print(f"{answer:7s} {name or 'nothing':24s} on {key:30s} {said}", flush=True)
    print(f"{len(cases) - nulls} rigs with one effect: right {counts['right']}, "
          f"wrong {counts['wrong']}, missed {counts['missed']}; "
          f"{nulls} with nothing missing: {counts['alarm']} disagree")


def _done(work: Path | None) -> dict[str, tuple[str, str]]:
    """Return what a file of lines holds."""
    if work is None or not work.is_file():
        return {}
    lines = [json.loads(line) for line in work.read_text(encoding="utf-8").splitlines()]
    return {key: (answer, said) for key, (answer, said) in lines}


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
