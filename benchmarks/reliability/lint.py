"""`ema lint` on good bags and on bags with seeded defects.

Good bags: both profiles, noise 0.5 to 2, every effect and fault of the catalogue at up to a
quarter of its range, conditions (temperature, bus, load), other serial numbers and start times.

Run: python -m benchmarks.reliability.lint [--bags 20] [--good 200] [--seed 6]
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from collections import Counter
from pathlib import Path
from random import Random

from benchmarks.reliability.defects import DEFECTS
from benchmarks.reliability.recording import Recording
from ema_record.bag import write_bag
from ema_record.lint import lint_bag
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_sim.effects import EFFECTS, Effects, parse_effects
from ema_sim.effects.base import Quantity
from ema_sim.simulate import simulate


def random_effects(rng: Random) -> list[str]:
    """Return settings of no, one or two effects of moderate size."""
    settings: list[str] = []
    for name in rng.sample(sorted(EFFECTS), rng.choice([0, 1, 1, 2])):
        for field in EFFECTS[name].fields:
            if isinstance(field.kind, Quantity):
                default = float(field.default)
                edge = field.kind.upper if rng.random() < 0.7 else field.kind.lower
                value = default + rng.uniform(0.0, 0.25) * (edge - default)
                settings.append(f"{name}.{field.name}={value:.6g}")
    return settings


def good_record(rng: Random) -> tuple[Record, list[str]]:
    """Return a record without a defect and the effects in it."""
    settings = random_effects(rng)
    effects: Effects = parse_effects(settings)
    record = simulate(
        load_profile(rng.choice(["step", "extended"])), effects=effects,
        seed=rng.randrange(1 << 30), noise=rng.uniform(0.5, 2.0),
        serial_number=f"EMA-{rng.randrange(999):03}",
        start_time=1_790_000_000 * 10**9 + rng.randrange(10**15),
    )
    return record, settings


def good_bags(count: int, seed: int, folder: Path) -> list[dict[str, object]]:
    """Return what is found in good bags, nothing where all is well."""
    rng = Random(seed)
    wrong: list[dict[str, object]] = []
    for number in range(count):
        record, settings = good_record(rng)
        bag = write_bag(record, folder / "good", views=number % 2 == 0)
        report = lint_bag(bag)
        if report.exit_status:
            wrong.append({
                "number": number, "profile": record.profile.name, "effects": settings,
                "findings": [f"{f.rule}: {f.message}" for f in report.findings],
                "unreadable": report.unreadable,
            })
        shutil.rmtree(bag)
    return wrong


def found_defects(count: int, seed: int, folder: Path) -> tuple[Counter[str], list[str]]:
    """Return how many defects of each kind were found by a rule for it, and the misses."""
    found: Counter[str] = Counter()
    missed: list[str] = []
    for number in range(count):
        rng = Random(seed * 1000 + number)
        record, settings = good_record(rng)
        for name, kind in DEFECTS.items():
            recording = Recording.of(record, folder / "source")
            shutil.rmtree(folder / "source")
            kind.make(recording, rng)
            report = lint_bag(recording.write(folder / "defect"))
            shutil.rmtree(folder / "defect")
            rules = {finding.rule for finding in report.findings}
            found[name] += bool(kind.rules & rules)
            if not kind.rules & rules:
                missed.append(f"{name} in bag {number} ({record.profile.name}, {settings}): "
                              f"{sorted(rules)} {report.unreadable or ''}")
    return found, missed


def main() -> None:
    """Print the table and what went wrong."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--bags", type=int, default=20)
    options.add_argument("--good", type=int, default=200)
    options.add_argument("--seed", type=int, default=6)
    arguments = options.parse_args()
    with tempfile.TemporaryDirectory() as name:
        wrong = good_bags(arguments.good, arguments.seed, Path(name))
        found, missed = found_defects(arguments.bags, arguments.seed, Path(name))
    for line in (*map(json.dumps, wrong), *missed):
        print(line)
    total = arguments.bags * len(DEFECTS)
    print(json.dumps({
        "seed": arguments.seed, "kinds": len(DEFECTS), "defects": total,
        "found": sum(found.values()), "share": sum(found.values()) / max(total, 1),
        "good_bags": arguments.good, "good_bags_with_findings": len(wrong),
    }))


if __name__ == "__main__":
    main()
