"""The shipped cascade: a record better than its recorder is declared is not suspicious for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ema_prognostics.cascade.model_file import load_model
from ema_prognostics.verdict.diagnose import diagnose
from ema_record.actuator import INSTANT, Actuator, load_actuator
from ema_record.channels import PHASE_CURRENTS, REFERENCE_CURRENTS
from ema_record.profile import Profile, load_profile
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate
from support.simulations import column

NOMINAL = load_actuator()


def recorded(bits: int | None = None, **acquisition: float) -> Actuator:
    converters = NOMINAL.converters
    if bits is not None:
        converters = converters._replace(**{
            n: bits for n in converters._fields if n.endswith("_bits")})
    return NOMINAL._replace(converters=converters,
                            acquisition=NOMINAL.acquisition._replace(**acquisition))


RECORDERS = {
    "as declared": (recorded(), 1.0),
    "a quarter of the noise": (recorded(), 0.25),
    "no noise": (recorded(), 0.0),
    "not rounded": (recorded(converters=0), 1.0),
    "neither noise nor rounding": (recorded(converters=0), 0.0),
    "12 bits": (recorded(bits=12), 1.0),
    "instants": (recorded(sampling=INSTANT), 1.0),
    "late references": (recorded(reference_latency=1.9), 1.0),
    "late commands": (recorded(command_latency=1.9), 1.0),
    "rounded down": (NOMINAL._replace(
        converters=NOMINAL.converters._replace(speed_offset=-0.5)), 1.0),
}


@pytest.mark.parametrize("what", RECORDERS)
def test_healthy_whatever_the_recorder(what: str) -> None:
    actuator, noise = RECORDERS[what]
    record = simulate(load_profile("extended"), actuator=actuator, noise=noise, seed=21)
    verdict = diagnose(record)
    assert verdict.outcome == "healthy", verdict.reasons


def test_a_current_of_the_move_before_tells_nothing_of_the_sensors() -> None:
    """A coil gives its energy back within L I / U, 0.08 ms of 30 A; the record begins there."""
    def begun(x: np.ndarray) -> np.ndarray:
        time = np.arange(len(x)) / NOMINAL.acquisition.rate
        return x + np.exp(-time / 1e-4)[:, None] * np.array([12.0, -5.0, -7.0])

    before = simulate(load_profile("extended"), seed=24)
    record = column(PHASE_CURRENTS, begun)(before)
    verdict = diagnose(record)
    assert verdict.outcome == "healthy", verdict.reasons
    assert record.at_rest.start == round(1e-3 * NOMINAL.acquisition.rate)
    assert diagnose(before).probabilities == pytest.approx(verdict.probabilities, abs=1e-3)


def test_a_control_may_take_a_period_to_compute() -> None:
    record = simulate(load_profile("extended"), seed=26, effects=parse_effects(
        [f"control_delay.delay={NOMINAL.control.period}"]))
    verdict = diagnose(record)
    assert verdict.outcome == "healthy", verdict.reasons


def test_currents_that_sum_to_zero_exactly() -> None:
    record = simulate(load_profile("extended"), seed=22)
    for columns in (PHASE_CURRENTS, REFERENCE_CURRENTS):
        record = column(
            columns, lambda x: np.column_stack([x[:, :2], -x[:, :2].sum(axis=1)]))(record)
    verdict = diagnose(record)
    assert verdict.outcome == "healthy", verdict.reasons


@pytest.mark.parametrize("what", ["not rounded", "a quarter of the noise", "instants"])
def test_faults_are_found_in_better_records_too(what: str) -> None:
    actuator, noise = RECORDERS[what]
    record = simulate(load_profile("extended"), actuator=actuator, noise=noise, seed=23,
                      effects=parse_effects(["turn_short.fraction=0.06", "turn_short.phase=b"]))
    verdict = diagnose(record)
    assert [(f.fault_class, f.phase) for f in verdict.faults] == [("turn_short", "b")]


def test_a_test_that_the_kit_has_no_networks_for_is_unknown() -> None:
    shipped = load_model()
    one = replace(shipped, cascades={
        name: part for name, part in shipped.cascades.items() if name.startswith("extended/")})
    verdict = diagnose(simulate(load_profile("step"), seed=25), one)
    assert (verdict.outcome, verdict.cause) == ("unknown", "unknown_test")
    assert "do not know the test step: run the profile extended" in verdict.reasons[0]
    assert diagnose(simulate(load_profile("extended"), seed=25), one).outcome == "healthy"


def test_a_worse_record_is_unknown_and_says_what_to_do() -> None:
    verdict = diagnose(simulate(load_profile("extended"), noise=8.0, seed=24))
    assert verdict.outcome == "unknown"
    assert any(reason.startswith("next: ") for reason in verdict.reasons)


def test_a_whole_record_of_a_test_that_begins_at_once_is_not_incomplete() -> None:
    odd = Profile(name="odd", points=((0.0, 0.0), (0.2, 0.05), (0.5, 0.05)), inverter_off=0.0)
    verdict = diagnose(simulate(odd, seed=26))
    assert (verdict.outcome, verdict.cause) == ("unknown", "unknown_test")
