"""What `ema check` finds by one `step`, the test that begins as any last move has left it.

Units, conditions and starts are drawn as those of the training, with seeds of their own; each has
one test with the effect and one without, which is the baseline. Prints, for each effect, how many
are named (with or without another class), called something else, healthy or unknown, and how many
baselines are refused, with the shipped networks of both views.

    python -m benchmarks.detection.step --units 300
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np
from joblib import Parallel, delayed

from ema_prognostics.training.conditions import (
    actuator_of,
    draw_conditions,
    draw_unit,
    effects_of,
    start_left_by,
)
from ema_prognostics.training.faults import HEALTHY
from ema_prognostics.verdict.judge import Judge
from ema_prognostics.verdict.verdict import Verdict
from ema_record.errors import UsageError
from ema_record.profile import load_profile
from ema_record.record import Record
from ema_record.spread import load_spread
from ema_sim.effects import parse_effects
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate

SEED = 17
HIDDEN = {
    "": "", "motor_friction.increase=0.3": "friction", "motor_friction.increase=0.5": "friction",
    "surface_friction.increase=1": "friction", "backlash.increase=0.0005": "backlash",
    "backlash.increase=0.001": "backlash"}
"""What is hidden, and its class."""
ANSWERS = ("named", "other fault", "healthy", "unknown", "refused")


def answer(verdict: Verdict, name: str) -> str:
    """Return one of `ANSWERS`; `name`: the class of what is hidden, empty: nothing."""
    if verdict.outcome != "fault":
        return "healthy" if verdict.outcome == "healthy" else "unknown"
    return "named" if name in {f.fault_class for f in verdict.faults} else "other fault"


def judged(number: int, effect: str) -> tuple[str, str]:
    """Return the answers for a unit without and with a baseline."""
    rng = np.random.default_rng([SEED, number])
    spread, model, profile = load_spread(), load_model_file(), load_profile("step")
    unit = draw_unit(rng, spread.tolerances)
    tests = [draw_conditions(rng, spread.conditions) for _ in range(2)]

    def test_of(k: int, settings: list[str]) -> Record:
        day = tests[k]
        actuator = actuator_of(model.actuator, unit, day)
        effects = parse_effects(
            settings, effects_of(model.actuator, unit, day, HEALTHY, model.effects))
        return simulate(profile, actuator=actuator, seed=day.seed, effects=effects,
                        start=start_left_by(actuator, effects, profile, day.start))

    record, before = test_of(0, [effect] if effect else []), test_of(1, [])
    alone = answer(Judge().of_record(record, "step").verdict, HIDDEN[effect])
    try:
        judge = Judge(baseline=before)
    except UsageError:
        return alone, "refused"
    return alone, answer(judge.of_record(record, "step").verdict, HIDDEN[effect])


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--units", type=int, default=300, help="of each effect")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    print(f"| hidden | baseline | {' | '.join(ANSWERS)} |\n|---|---|{'---|' * len(ANSWERS)}")
    for effect in HIDDEN:
        found = Parallel(n_jobs=options.jobs)(
            delayed(judged)(k, effect) for k in range(options.units))
        for view, answers in zip(("without", "with"), zip(*found)):
            count = Counter(answers)
            print(f"| {effect or 'nothing'} | {view} | "
                  f"{' | '.join(str(count[a]) for a in ANSWERS)} |", flush=True)


if __name__ == "__main__":
    main()
