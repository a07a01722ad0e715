import numpy as np
import pytest

from ema_record.errors import UsageError
from ema_sim.campaign import runs as campaign_runs
from ema_sim.campaign.plan import load_plan, plan_from
from ema_sim.campaign.run import run_campaign
from ema_sim.campaign.runs import prepare
from ema_sim.effects import EFFECTS
from support.simulations import record_of

STEP = {"profile": "step", "runs": 100}


def campaign(parameters=None, **changes):
    return prepare(plan_from({**STEP, "parameters": parameters or {}, **changes}, "test"))


def drawn(runs, name):
    return np.array([run.drawn[name] for run in runs])


def all_runs(found):
    return [found.run(i) for i in range(found.runs)]


def test_runs_depend_on_plan_and_number_only():
    one = campaign({"noise": {"uniform": [0.5, 2.0]}})
    more = campaign(
        {"turn_short.phase": {"choice": ["a", "b"]}, "noise": {"uniform": [0.5, 2.0]}}, runs=5000
    )
    other = campaign({"noise": {"uniform": [0.5, 2.0]}}, seed=1)
    for index in (0, 7, 99):
        assert one.run(index).noise == more.run(index).noise
        assert one.run(index).seed == more.run(index).seed
        assert one.run(index).noise != other.run(index).noise
    assert len({one.run(i).seed for i in range(100)}) == 100


def test_distributions_have_their_moments():
    found = campaign(
        {
            "noise": {"uniform": [1.0, 3.0]},
            "turn_short.fraction": {"log_uniform": [0.001, 0.1]},
            "actuator.motor.phase_resistance": {"normal": [1.0, 0.03], "relative": True},
            "actuator.surface.dynamic_friction": {"normal": [60.0, 3.0]},
            "turn_short.phase": {"choice": ["a", "b", "c"]},
        },
        runs=1000,
    )
    found = all_runs(found)
    four_sigma = 4.0 / np.sqrt(1000)
    assert drawn(found, "noise").mean() == pytest.approx(2.0, abs=four_sigma * 2 / np.sqrt(12))
    logs = np.log10(drawn(found, "turn_short.fraction"))
    assert logs.mean() == pytest.approx(-2.0, abs=four_sigma * 2 / np.sqrt(12))
    resistance = drawn(found, "actuator.motor.phase_resistance") / 1.065
    assert resistance.mean() == pytest.approx(1.0, abs=four_sigma * 0.03)
    assert resistance.std() == pytest.approx(0.03, rel=four_sigma)
    assert drawn(found, "actuator.surface.dynamic_friction").std() == pytest.approx(3.0, rel=0.1)
    _, counts = np.unique(drawn(found, "turn_short.phase"), return_counts=True)
    assert counts == pytest.approx(1000 / 3, abs=4 * np.sqrt(1000 * 2 / 9))


def test_what_is_drawn_reaches_the_run():
    run = campaign(
        {
            "actuator.motor.inertia": {"uniform": [0.5, 0.9], "relative": True},
            "actuator.converters.speed_bits": {"choice": [10, 12]},
            "turn_short.fraction": 0.125,
            "turn_short.phase": "b",
            "start_angle": 1.5,
        }
    ).run(3)
    assert run.actuator.motor.inertia == run.drawn["actuator.motor.inertia"]
    assert 0.5 * 1.5e-5 <= run.actuator.motor.inertia <= 0.9 * 1.5e-5
    assert type(run.actuator.converters.speed_bits) is int
    assert run.effects.turn_short.fraction == 0.125
    assert EFFECTS["turn_short"].fields[1].kind.options[run.effects.turn_short.phase] == "b"
    assert run.start_angle == 1.5


@pytest.mark.slow
def test_the_edges_of_a_carrier_are_simulated_where_the_plan_says_so(monkeypatch):
    seen = []
    monkeypatch.setattr(campaign_runs, "simulate", lambda *_, switching, **__: (
        seen.append(switching) or record_of("step", seed=3)))
    for switching in (False, True):
        run = campaign({"noise": 1.0}, switching=switching).run(0)
        assert run.switching is switching
        run.simulate()
    assert seen == [False, True]


def test_grids_give_all_combinations_once():
    found = prepare(plan_from(
        {"profile": ["step", "extended"], "parameters": {
            "turn_short.fraction": {"grid": [0.0, 0.1, 0.2]},
            "turn_short.phase": {"grid": ["a", "b", "c"]},
        }}, "test",
    ))
    runs = all_runs(found)
    points = {(r.profile.name, r.effects.turn_short) for r in runs}
    assert found.runs == len(points) == 18


def test_normal_stays_within_the_bounds_of_its_parameter():
    found = campaign({"turn_short.fraction": {"normal": [0.0, 0.1]}})
    values = drawn(all_runs(found), "turn_short.fraction")
    assert values.min() >= 0.0 and values.std() > 0.02


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"turn_short.fraction": {"uniform": [0.0, 2.0]}}, "out of bounds"),
        ({"turn_shot.fraction": 0.1}, "did you mean 'turn_short.fraction'"),
        ({"turn_short.fractoin": 0.1}, "did you mean 'fraction'"),
        ({"turn_short.phase": "d"}, "choose one of a, b, c"),
        ({"turn_short.phase": {"uniform": [0, 1]}}, "give a choice or a grid"),
        ({"turn_short.fraction": {"uniform": [0.0, 0.1], "relative": True}}, "relative"),
        ({"turn_short.fraction": {"uniform": [0.2, 0.1]}},
         "parameters.turn_short.fraction: the lower end comes first"),
        ({"turn_short.fraction": {"uniform": [0.0, 0.1], "grid": [1]}}, "exactly one of"),
        ({"turn_short.fraction": {"log_uniform": [0.0, 0.1]}}, "more than 0"),
        ({"turn_short.fraction": {"unifrom": [0.0, 0.1]}}, "turn_short.fraction"),
        ({"turn_short.fraction": float("nan")}, "not a number"),
        ({"actuator.motor.mass": 1.0}, "unknown parameter of actuator.motor"),
        ({"actuator.moter.inertia": 1.0}, "did you mean 'motor'"),
        ({"actuator.acquisition.commutation_latency": {"uniform": [0.9, 1.1], "relative": True}},
         "0 by itself"),
        ({"actuator.acquisition.sampling": {"choice": [1.0], "relative": True}},
         "relative serves only numbers"),
        ({"actuator.motor.inertia": {"uniform": [1.0, 2e9], "relative": True}}, "out of bounds"),
        ({"actuator.converters.speed_bits": {"choice": [10.5]}}, "whole number"),
        ({"noise": {"uniform": [-1, 1]}}, "out of bounds"),
        ({"__class__": 1.0}, "no dotted name"),
    ],
)
def test_wrong_parameters_are_refused_in_one_line(parameters, said):
    with pytest.raises(UsageError) as error:
        campaign(parameters)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"runs": 0}, "runs"), ({"runs": 10**9}, "runs"), ({"seed": -1}, "seed"),
        ({"profile": "stepp"}, "did you mean 'step'"), ({"extra": 1}, "extra"),
        ({"runs": None}, "how many is not said"), ({"rate": 1.0}, "rate"),
    ],
)
def test_wrong_plans_are_refused_in_one_line(changes, said):
    with pytest.raises(UsageError) as error:
        campaign(**changes)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_plan_file(tmp_path):
    path = tmp_path / "plan.yaml"
    path.write_text("profile: step\nruns: 3\nparameters:\n  noise: {uniform: [0, 1]}\n")
    assert prepare(load_plan(path)).runs == 3
    path.write_text("- step\n")
    with pytest.raises(UsageError, match="expected 'profile:'"):
        load_plan(path)


@pytest.mark.parametrize(
    "name", ["os:getcwd", "ema_record.files:new_file", "summary2", "subprocess:run", "", "bags"],
)
def test_a_file_names_no_code(name):
    with pytest.raises(UsageError, match="keep"):
        run_campaign(plan_from({**STEP, "keep": name}, "test"))
