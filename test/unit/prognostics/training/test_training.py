"""From a small campaign to a model file and a verdict: the whole chain, same seed same file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ema_prognostics.cascade.classes import OUTPUTS
from ema_prognostics.cascade.find import Cascade
from ema_prognostics.cascade.model_body import View
from ema_prognostics.cascade.model_file import (
    Body,
    TrainedModel,
    load_model,
    model_of,
    model_text,
    save_model,
)
from ema_prognostics.training import train_model
from ema_prognostics.training.evaluation import evaluated
from ema_prognostics.training.fleet import FleetFeatures, simulate_fleets
from ema_prognostics.training.report import validation_report
from ema_prognostics.training.train_model import VIEWS, Trained, TrainingSettings
from ema_prognostics.training.view_training import sound_rows, stricter, train_view
from ema_prognostics.verdict.diagnose import diagnose
from ema_record.actuator_type import actuator_hash
from ema_record.errors import UsageError
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate

Campaigns = tuple[FleetFeatures, FleetFeatures]


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory: pytest.TempPathFactory) -> Campaigns:
    folder = tmp_path_factory.mktemp("campaign")
    made = (simulate_fleets(("step",), 16, 31, folder=folder)["step"],
            simulate_fleets(("step",), 8, 32, healthy=True, folder=folder)["step"])
    again = simulate_fleets(("step",), 16, 31, folder=folder)["step"]
    assert np.array_equal(made[0].record, again.record)  # from the kept parts
    assert np.array_equal(made[0].friction, again.friction)
    return made


def train(campaigns: Campaigns) -> TrainedModel:
    faults, healthy = campaigns
    # Every severity must be there in units that train and in units that calibrate.
    rng = np.random.default_rng(0)
    severity = np.zeros((len(faults), len(OUTPUTS)))
    rows = np.arange(len(faults))
    severity[rows, rows % len(OUTPUTS)] = rng.uniform(0.01, 0.1, len(rows))
    severity[::9] = 0.0
    labelled = replace(faults, severity=severity, unit=rows)
    parts = {v: train_view(labelled, healthy, "step", v, seed=1, hidden=4, iterations=3)
             for v in VIEWS}
    views = {f"step/{v}": part for v, part in parts.items()}
    held_out = {"step": evaluated(parts, (labelled, healthy))}
    settings = TrainingSettings(units=16, healthy=8)
    return model_of(Body(views=views, paper=None, training={
        "seed": 31, "held_out": held_out,
        "settings": {n: getattr(settings, n) for n in settings.__slots__},
    }))


@pytest.fixture(scope="module")
def model(campaigns: Campaigns) -> TrainedModel:
    return train(campaigns)


def test_campaign_follows_from_the_seed(campaigns: Campaigns) -> None:
    again = simulate_fleets(("step",), 2, 31)["step"]
    assert np.array_equal(again.record, campaigns[0].record[: len(again)])
    assert (campaigns[1].severity == 0.0).all()


def test_a_campaign_about_another_actuator(campaigns: Campaigns, tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text("effects:\n  cogging_torque: {amplitude: 0.05, periods: 18}\n")
    other = simulate_fleets(("step",), 2, 31, model=load_model_file(file))["step"]
    assert np.array_equal(other.severity, campaigns[0].severity[: len(other)])
    assert not np.allclose(other.record, campaigns[0].record[: len(other)])
    same = simulate_fleets(("step",), 2, 31, model=load_model_file())["step"]
    assert np.array_equal(same.record, campaigns[0].record[: len(same)])


@pytest.mark.slow
def test_same_seed_same_bytes(campaigns: Campaigns, model: TrainedModel) -> None:
    assert model_text(train(campaigns)) == model_text(model)


@pytest.mark.slow
def test_a_training_says_for_which_actuator_it_was(
    model: TrainedModel, campaigns: Campaigns, monkeypatch: pytest.MonkeyPatch
) -> None:
    faults, sound = campaigns
    views = {"step": {v: model.body.views[f"step/{v}"] for v in ("fleet", "baseline")}}
    monkeypatch.setattr(train_model, "simulate_fleets", lambda *_, healthy=False, **__: {
        "step": sound if healthy else faults})
    monkeypatch.setattr(train_model, "train_views", lambda *_, **__: Trained(views, None))
    monkeypatch.setattr(train_model, "evaluated", lambda *_: {})
    trained = train_model.train_model(31, kinds=("step",))
    assert trained.body.actuator == actuator_hash()
    assert trained.cascades["step/fleet"].view == model.cascades["step/fleet"].view


def test_file_judges_as_what_was_trained(model: TrainedModel, tmp_path: Path) -> None:
    loaded = load_model(save_model(model, tmp_path / "model.json"))
    record = simulate(load_profile("step"), seed=5)
    own = simulate(load_profile("step"), seed=6)
    assert diagnose(record, loaded) == diagnose(record, model)
    assert diagnose(record, loaded, baseline=own) == diagnose(record, model, baseline=own)


def test_report_of_the_validation_has_every_fault(model: TrainedModel) -> None:
    text = validation_report(model)
    for word in ("turn_short", "rotor_eccentricity", "friction", "backlash", "false alarms"):
        assert word in text


def test_baseline_that_cannot_serve(model: TrainedModel) -> None:
    record = simulate(load_profile("step"), seed=5)
    extended = simulate(load_profile("extended"), seed=6)
    with pytest.raises(UsageError, match="of another"):
        diagnose(record, model, baseline=extended)
    cut = replace(record, samples=record.samples[:2000])
    with pytest.raises(UsageError, match="cannot serve"):
        diagnose(record, model, baseline=cut)
    with pytest.raises(UsageError, match="paper"):
        diagnose(record, model, mode="paper", baseline=record)


def test_stranger_to_a_model_of_another_test(model: TrainedModel) -> None:
    odd = simulate(load_profile("step"), effects=parse_effects(["cogging_torque.amplitude=0.3"]))
    assert diagnose(odd, model).outcome in ("unknown", "fault")


@pytest.mark.parametrize("view", ["fleet", "baseline"])
def test_thresholds_rise_with_what_healthy_tests_reach(
    campaigns: Campaigns, model: TrainedModel, view: View,
) -> None:
    part, rows = model.body.views[f"step/{view}"], sound_rows(campaigns[1], view)
    assert len(rows) == 2 * len(campaigns[1])
    low = part.model_copy(update={"families": {
        name: f.model_copy(update={"threshold": f.threshold - 20.0})
        for name, f in part.families.items()}})
    margin = np.array([found.margin for found in Cascade(low).find(rows)])
    assert (margin > 0.0).any()
    mended = stricter(low, "step", view, rows)
    assert (np.array([f.margin for f in Cascade(mended).find(rows)]) <= 1e-2).all()  # six digits
    high = {n: f.threshold + 20.0 for n, f in part.families.items()}
    raised = part.model_copy(update={"families": {
        n: f.model_copy(update={"threshold": high[n]}) for n, f in part.families.items()}})
    kept = stricter(raised, "step", view, rows)
    assert {n: f.threshold for n, f in kept.families.items()} == pytest.approx(high, rel=1e-4)
