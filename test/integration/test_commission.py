"""A kit from a description and eight records, as `ema commission --quick` makes it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ema_prognostics.cascade.model_file import load_model
from ema_prognostics.commission.commission import commission
from ema_prognostics.training.conditions import actuator_of, draw_conditions, draw_unit, effects_of
from ema_prognostics.training.faults import HEALTHY, InjectedFault
from ema_prognostics.verdict.diagnose import diagnose
from ema_record.actuator import load_actuator
from ema_record.bag.read import write_bag
from ema_record.kit import VALIDATION, using_kit
from ema_record.profile import load_profile
from ema_record.profiles.text import write_profiles
from ema_record.record import Provenance
from ema_record.spread import load_spread
from ema_sim.effects import Effects
from ema_sim.simulate import simulate

MACHINE = (Path(__file__).parents[2] / "benchmarks" / "any_actuator" / "machines" / "trim_28v"
           / "actuator.yaml")
UNITS, RECORDS = 4, 2


class StoppedError(Exception):
    """As if the user had stopped it."""


def record_of(kit, unit, seed, *settings):
    """Return a record of one of the described units."""
    with using_kit(kit):
        spread, fault = load_spread(), HEALTHY
        own = draw_unit(np.random.default_rng([7, unit]), spread.tolerances)
        conditions = draw_conditions(np.random.default_rng([8, seed]), spread.conditions)
        if settings:
            fault = InjectedFault(severity={}, settings=settings)
        nominal = load_actuator()
        record = simulate(
            load_profile("extended"), actuator=actuator_of(nominal, own, conditions),
            effects=effects_of(nominal, own, conditions, fault, Effects()), seed=conditions.seed)
    return replace(record, provenance=Provenance(serial_number=f"T-{unit}"))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_kit_is_made_and_a_stopped_run_is_taken_up(tmp_path):
    described = tmp_path / "described"
    described.mkdir()
    (described / "actuator.yaml").write_bytes(MACHINE.read_bytes())
    with using_kit(described):
        write_profiles(load_actuator(), described / "profiles")
    bags = []
    for k in range(UNITS * RECORDS):
        bags.append(tmp_path / f"record-{k}")
        write_bag(record_of(described, k % UNITS, k), bags[-1], views=False)
    out, work = tmp_path / "kit", tmp_path / "kit.unfinished" / "work"
    parts, kept = [], []

    def fleets():
        return {path.name: path.stat().st_mtime_ns for path in work.iterdir()}

    def stopping(what, part):
        parts.append(part)
        if what == "training":
            raise StoppedError

    def going_on(what, _part):
        if what == "training":
            kept.append(fleets())

    with pytest.raises(StoppedError):
        commission(bags, MACHINE, out, quick=True, jobs=2, progress=stopping)
    assert not out.exists()
    assert parts == sorted(parts)
    before = fleets()
    found = commission(bags, MACHINE, out, quick=True, jobs=2, progress=going_on)
    assert before and kept == [before]  # what was simulated is not simulated again
    assert not (out / "work").exists() and not work.parent.exists()
    text = json.loads((out / VALIDATION).read_text(encoding="utf-8"))
    assert text == json.loads(json.dumps(found))
    assert {r["left_out"] for r in text["records"]} == {"healthy"}
    with using_kit(out):
        model = load_model()
        assert model.sha256 == text["cascade_sha256"]
        outcomes = [diagnose(record_of(out, k, 90 + k), model).outcome for k in range(11, 19)]
        assert outcomes.count("healthy") >= 7 and "fault" not in outcomes  # a quick training
        faulty = diagnose(record_of(
            out, 12, 102, "turn_short.fraction=0.15", "turn_short.phase=b"), model)
        assert (faulty.outcome, faulty.to_dict()["phase"]) == ("fault", "b")
