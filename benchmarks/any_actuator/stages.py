"""The stages of the benchmark on its six machines, each taken up where it was stopped."""

from __future__ import annotations

import sys
import time
from argparse import Namespace
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.any_actuator.cases import ACCEPTANCE, TEST, Counts, draw_cases, sizes_of
from benchmarks.any_actuator.judging import decided_by, file_key, judge_cases
from benchmarks.any_actuator.machines import (
    TEST_NAME,
    BenchMachine,
    commission_kit,
    default_test,
    load_machine,
    machine_names,
)
from benchmarks.any_actuator.records import record_of
from benchmarks.any_actuator.table import markdown, outcomes, why_unknown
from benchmarks.any_actuator.units import draw_type
from benchmarks.ledger import Ledger
from ema_prognostics.verdict.judge import Judge
from ema_record.actuator import Actuator, load_actuator
from ema_record.bag.read import write_bag
from ema_record.kit import CASCADE, kit_folder, using_kit
from ema_record.profile import load_profile
from ema_record.spread import load_spread

DEFAULT = Counts(units=200, healthy=200, each_fault=20, strangers=24, sensor_faults=20)
ACCEPTED = Counts(units=4, healthy=8, each_fault=0, strangers=0, sensor_faults=0)
TESTED = Counts(units=20, healthy=100, each_fault=20, strangers=20, sensor_faults=20)


def say(name: str) -> Callable[[int, int], None]:
    """Return what shows how far a stage is."""
    started = time.monotonic()

    def show(done: int, of: int) -> None:
        if done % 50 == 0 or done == of:
            print(f"  [{time.monotonic() - started:5.0f} s] {name}: {done} of {of}",
                  file=sys.stderr, flush=True)
    return show


def _part(counts: Counts, part: float) -> Counts:
    return Counts(*(round(part * n) if part * n >= 1.0 else min(n, 1) for n in counts))


def default(options: Namespace) -> None:
    """Judge a kit on the second simulator's units of its own actuator."""
    with using_kit(options.kit):
        a, spread, profile = load_actuator(), load_spread(), load_profile(options.profile)
        kit = kit_folder()
        sizes = sizes_of(a, kit)
        cases = draw_cases(a, spread, _part(DEFAULT, options.part), sizes, seed=options.seed,
                           fleet=TEST, duration=profile.duration, own=options.own)
        if options.only:
            cases = [c for c in cases if c.group in options.only]
        name = decided_by(options.profile, options.seed, options.own, options.part, sizes)
        rows = judge_cases(cases, profile, Judge(), Ledger(options.work / "default.jsonl"), name,
                           say("default"))
    print(markdown({"default kit": rows}))
    print("\n" + outcomes(rows))
    print("\nwhy healthy records are not judged:\n" + why_unknown(rows))


def _machines(options: Namespace) -> list[BenchMachine]:
    return [load_machine(name) for name in options.machine or machine_names()]


def _acceptance(options: Namespace, machine: BenchMachine) -> Path:
    return Path(options.work) / machine.name / "acceptance"


def _kit(options: Namespace, machine: BenchMachine) -> Path:
    return Path(options.work) / machine.name / ("kit-quick" if options.quick else "kit")


def _built(options: Namespace, machine: BenchMachine) -> Actuator:
    """Return the type as it is: off its description, unless that is said to be exact."""
    a = machine.actuator._replace(acquisition=machine.actuator.acquisition._replace(
        commutation_latency=options.commutation_latency))
    if options.exact:
        return a
    return draw_type(a, (options.seed, machine_names().index(machine.name)))


def make(options: Namespace) -> None:
    """Write the acceptance records of each machine as bags."""
    for machine in _machines(options):
        folder = _acceptance(options, machine)
        profile = default_test(machine.actuator)
        cases = draw_cases(_built(options, machine), machine.spread, ACCEPTED, {},
                           seed=options.seed, fleet=ACCEPTANCE, duration=profile.duration,
                           own=True)
        folder.mkdir(parents=True, exist_ok=True)
        for case in cases:
            if not (folder / case.key).exists():
                write_bag(record_of(case.test, profile), folder / case.key, views=False)
        print(f"{folder}: {len(cases)} records of {ACCEPTED.units} units, "
              f"{profile.duration:.3g} s each")


def commission(options: Namespace) -> None:
    """Make the kit of each machine; what is refused is said and kept."""
    ledger = Ledger(options.work / "commission.jsonl")
    for machine in _machines(options):
        bags = sorted(p for p in _acceptance(options, machine).iterdir() if p.is_dir())
        kit = _kit(options, machine)
        found = commission_kit(machine, bags, kit, quick=options.quick, jobs=options.jobs)
        if found["seconds"] is not None:
            key = f"{machine.name}/{int(options.quick)}/{file_key(kit / CASCADE)}"
            found = ledger.run(key, partial(dict, found))
            print(f"{machine.name}: {found['seconds']:.0f} s: {found['refused'] or kit}",
                  flush=True)


def judged(options: Namespace, machine: BenchMachine) -> list[dict[str, Any]] | None:
    """Return the verdicts on a machine's tests, None where it has no kit."""
    kit = _kit(options, machine)
    if not (kit / CASCADE).is_file():
        return None
    with using_kit(kit):
        profile = load_profile(TEST_NAME)
        sizes = sizes_of(machine.actuator, kit, options.times)
        cases = draw_cases(
            _built(options, machine), machine.spread, _part(TESTED, options.part), sizes,
            seed=options.seed, fleet=TEST, duration=profile.duration, own=True)
        return judge_cases(
            cases, profile, Judge(), Ledger(Path(options.work) / machine.name / "judged.jsonl"),
            decided_by(machine.spread, options.seed, options.part, sizes, options.exact,
                       options.commutation_latency),
            say(machine.name), features=True)


def judge(options: Namespace) -> None:
    """Judge the tests of each machine with its kit."""
    for machine in _machines(options):
        rows = judged(options, machine)
        print(f"{machine.name}:\n{'no kit' if rows is None else outcomes(rows)}\n", flush=True)


def table(options: Namespace) -> None:
    """Print the rates of all machines, beside a plain perceptron on the same features."""
    from benchmarks.any_actuator.peer import perceptron_rows

    ours: dict[str, list[dict[str, Any]]] = {}
    peers: dict[str, list[dict[str, Any]]] = {}
    missing = []
    for machine in _machines(options):
        rows = judged(options, machine)
        if rows is None:
            missing.append(machine.name)
            continue
        ours[machine.name] = rows
        if options.peer:
            peers[machine.name] = perceptron_rows(
                _kit(options, machine), rows, units=options.peer_units, jobs=options.jobs,
                folder=Path(options.work) / "peer")
    if missing:
        print(f"no kit: {', '.join(missing)}\n")
    if ours:
        print(markdown(ours))
        print("\nwhy healthy records are not judged:")
        for name, rows in ours.items():
            print(f"{name}: {why_unknown(rows, 5) or '-'}")
    if peers:
        print("\nplain perceptron on the same features (no guard, no interval):\n")
        print(markdown(peers))
