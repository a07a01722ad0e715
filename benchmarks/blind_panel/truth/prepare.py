"""Before units are identified: draw and seal what is missing, list the tasks, make the bags."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from benchmarks.blind_panel.judging import in_question
from benchmarks.blind_panel.tasks import BAGS, IDENTIFIED, SEALED, Task, write_tasks
from benchmarks.blind_panel.truth.answers import Answer, Panel, drawn
from benchmarks.blind_panel.truth.bags import make_bags, make_next_bag
from benchmarks.blind_panel.truth.seal import commitment_of, parts, seal, unseal
from benchmarks.ledger import Ledger
from ema_cli.console import progress
from ema_record.profile import load_profile_dict
from ema_sim.campaign.workers import done_by_workers


def opened(out: Path, panel: Panel) -> list[list[Answer]]:
    """Return the answers of those units of a panel that are sealed, in its rounds."""
    found = {(a.stratum, a.k): a for part in parts(out / SEALED) for a in unseal(part)
             if (a.seed, a.tests) == (panel.seed, panel.tests)}
    return [[found[unit] for unit in units if unit in found] for units in panel.rounds()]


def prepare(out: Path, panel: Panel, workers: int) -> None:
    """Seal the units that are new, print all commitments, then make tasks and bags.

    In each round tasks are in the order of their random names: their places tell nothing.
    """
    known = {(answer.stratum, answer.k) for answers in opened(out, panel) for answer in answers}
    new = [drawn(panel, *unit) for units in panel.rounds() for unit in units if unit not in known]
    if new:
        seal(new, out / SEALED)
    for part in parts(out / SEALED):
        print(f"answers sealed, part {part.name}, SHA-256 {commitment_of(part)}", flush=True)
    order = [answer for answers in opened(out, panel)
             for answer in sorted(answers, key=lambda answer: answer.id)]
    write_tasks([Task(id=a.id, tests=a.tests, without=a.without,
                      kit="" if a.kit is None else a.kit.name) for a in order], out)
    (out / BAGS).mkdir(exist_ok=True)
    todo = [answer for answer in order if not (out / BAGS / answer.id).exists()]
    done = done_by_workers(partial(make_bags, folder=out / BAGS), todo, jobs=workers)
    with progress("bags", len(todo)) as advance:
        for number, _ in enumerate(done, start=1):
            advance(number)


def record_proposed(out: Path, panel: Panel) -> None:
    """Record the tests that were proposed for a set of names, whether that is right or not."""
    ledger = Ledger(out / IDENTIFIED)
    for answer in (answer for answers in opened(out, panel) for answer in answers):
        said = ledger.run(answer.id, dict) if answer.id in ledger.keys else None
        if said is not None and not answer.accepted and in_question(said):
            profile = load_profile_dict(said["next_profile"], f"{answer.id}: proposed test")
            make_next_bag(answer, profile, out / BAGS)
