"""A rig of our own: what is hidden comes back by name, and nothing where nothing is hidden."""

import re
import shlex

import numpy as np
import pytest

from ema_cli.main import run
from ema_identification.identify import identify
from ema_identification.rig.laws import LAWS
from ema_identification.rig.workflow import identify_rig
from ema_record.channels import Channel
from ema_rig.bag import read_rig_bag, write_rig_bag
from ema_rig.import_file import import_file
from ema_rig.map import load_map
from ema_rig.record import Axis, RigRecord
from support.rigs import EFFECTS, RIGS, STRANGERS, judged, make

QUICK = ("joint", "valve")

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("rig", "effect"), [
    ("joint", "coulomb_friction"), ("valve", "quadratic_drag"), ("joint", "cogging_torque"),
    ("valve", "spring"), ("joint", "stribeck_friction"), ("valve", "control_delay"),
    ("joint", "drive_lag"), ("joint", "periodic_disturbance"), ("valve", "detent"),
    ("joint", "friction_ripple"),
])
def test_what_is_hidden_is_named_and_strangers_are_unknown(rig, effect):
    found = identify_rig([make(RIGS[rig], 31, {effect: 0.3})])
    assert judged(effect, found) == "right", found
    if effect in STRANGERS:
        assert found.verdict == "unknown effect"
        assert found.exit_status == 3
        assert found.unknown.port == f"input {RIGS[rig].input}"
        assert found.next_test
    else:
        assert found.verdict == "explained"
        assert found.gap_after < 0.5 * found.gap_before


@pytest.mark.parametrize("seed", range(4))
def test_nothing_hidden_is_nothing_named(seed):
    found = identify_rig([make(RIGS[QUICK[seed % 2]], 400 + seed, coloured=seed > 1)])
    assert found.verdict == "no disagreement"
    assert found.findings == ()
    assert found.gap_after == found.gap_before


def test_the_updated_model_explains_what_was_found(tmp_path):
    rig = RIGS["joint"]
    effects = {"coulomb_friction": 0.3, "cogging_torque": 0.15}
    first = identify_rig([make(rig, 51, effects)], validate=[make(rig, 52, effects)])
    assert [f.effect for f in first.findings] == ["coulomb_friction", "cogging_torque"]
    assert first.gap_after < 0.2 * first.gap_before
    path = tmp_path / "model.yaml"
    path.write_text(first.model_text, encoding="utf-8")
    second = identify([make(rig, 53, effects)], path)
    assert second.verdict == "no disagreement"
    assert second.gap_before < 1.2 * first.gap_after


def test_parameters_lie_in_their_intervals_and_keep_their_unit():
    rig, inside, total = RIGS["valve"], 0, 0
    for seed in range(4):
        record = make(rig, 70 + seed, {"coulomb_friction": 0.3})
        size = _size(rig, 70 + seed)
        found = identify_rig([record])
        level = found.findings[0].parameters[0]
        assert (level.name, level.unit) == ("coulomb_friction.level", "V")
        assert level.value == pytest.approx(0.3 * size, rel=0.02)
        inside += level.low <= 0.3 * size <= level.high
        total += 1
    assert inside >= total - 1


def _size(rig, seed):
    record = make(rig, seed)
    return float(np.sqrt(np.mean(record.input**2))) / np.sqrt(1 + rig.input_noise**2)


def test_a_known_parameter_out_of_its_tolerance_is_named(tmp_path):
    rig = RIGS["valve"]
    path = tmp_path / "model.yaml"
    path.write_text(
        "rig: valve\nterms:\n- effect: inertia\n  parameters: {value: 0.014}\n  tolerance: 0.1\n"
        "- effect: viscous_friction\n", encoding="utf-8")
    found = identify_rig([make(rig, 60)], path)
    assert [f.effect for f in found.findings] == ["inertia_change"]


def test_the_formula_is_that_of_the_law_that_was_fitted():
    found = identify_rig([make(RIGS["joint"], 31, {"cogging_torque": 0.3})])
    (finding,) = found.findings
    assert finding.formula.equation == LAWS["cogging_torque"].equation
    assert "A cos(n θ - φ)" in finding.to_dict()["equation"]


@pytest.mark.parametrize("validated", [False, True])
def test_the_noise_floor_is_an_estimate_of_its_own(validated):
    """It was the gap after, whatever that was: 100 % were closed by construction."""
    rig, effects = RIGS["joint"], {"coulomb_friction": 0.3}
    held = [make(rig, 52, effects)] if validated else []
    found = identify_rig([make(rig, 51, effects)], validate=held)
    assert found.noise_floor != found.gap_after
    if validated:  # of a unit with another friction: more than noise is left
        assert found.noise_floor < 0.7 * found.gap_after
    else:
        assert found.noise_floor == pytest.approx(found.gap_after, rel=0.15)
    left_out = identify_rig([make(rig, 51, effects)], validate=held,
                            without=("coulomb_friction", "stribeck_friction",
                                     "asymmetric_friction", "presliding_hysteresis"))
    assert left_out.noise_floor < 0.7 * left_out.gap_after


def test_a_held_out_record_that_speaks_against_the_laws_contradicts_them():
    rig = RIGS["joint"]
    found = identify_rig([make(rig, 51, {"coulomb_friction": 0.3})], validate=[make(rig, 52)])
    assert found.verdict == "contradicted"
    assert found.exit_status == 3
    assert found.gap_after > found.gap_before
    assert found.model_text == ""


def test_what_the_report_says_to_run_next_runs(tmp_path):
    for seed, name in ((51, "first"), (52, "second")):
        write_rig_bag(make(RIGS["valve"], seed, {"coulomb_friction": 0.3}), tmp_path / name)
    out = tmp_path / "report"
    assert run(["identify", str(tmp_path / "first"), "--validate", str(tmp_path / "second"),
                "--out", str(out)]) == 0
    (line,) = re.findall(r"ema (identify .*)", (out / "report.html").read_text("utf-8"))
    assert "ema simulate" not in (out / "report.html").read_text("utf-8")
    assert run(shlex.split(line)) == 0


def test_hidden_names_are_not_used():
    found = identify_rig([make(RIGS["joint"], 80, {"coulomb_friction": 0.3})],
                         without=("coulomb_friction",))
    assert found.verdict == "unknown effect"
    assert "friction against speed" in found.unknown.text


def test_a_free_run_with_sticking_names_coulomb_friction():
    """The equation of motion integrated: the axis sticks at every reversal."""
    rate, steps, inertia, level = 500.0, 20, 0.02, 0.3
    time = np.arange(int(20 * rate)) / rate
    drive = 0.9 * np.sin(2 * np.pi * 0.5 * time) + 0.5 * np.sin(2 * np.pi * 1.3 * time + 1)
    position = np.zeros_like(time)
    q = v = 0.0
    for k, force in enumerate(drive.tolist()):
        position[k] = q
        for _ in range(steps):
            push = force - 0.1 * v
            if abs(v) < 1e-9 and abs(push) <= level:
                v = 0.0
                continue
            way = np.sign(v) if abs(v) > 1e-9 else np.sign(push)
            new = v + (push - way * level) / (inertia * rate * steps)
            v = 0.0 if new * way < 0 else new
            q += v / (rate * steps)
    rng = np.random.default_rng(4)
    axis = Axis(name="free", motion="rotary", input="torque")
    record = RigRecord(
        samples=np.column_stack([time, drive + 0.01 * rng.standard_normal(len(time)),
                                 position + 1e-5 * rng.standard_normal(len(time))]),
        channels=(Channel("time", "s"), Channel("input_torque", "N m"),
                  Channel("position", "rad")), axis=axis, source="free")
    found = identify_rig([record])
    assert found.findings[0].effect == "coulomb_friction"
    assert found.findings[0].parameters[0].value == pytest.approx(level, rel=0.03)


def test_result_is_complete_and_repeatable():
    record = make(RIGS["valve"], 90, {"coulomb_friction": 0.3})
    lines = []
    first = identify_rig([record], progress=lambda what, share: lines.append((what, share)))
    second = identify_rig([record])
    assert first.to_dict() == second.to_dict()
    assert first.model_text == second.model_text
    shares = [share for _, share in lines]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert [step.name for step in first.steps] == [
        "align", "recalibrate", "where", "name", "add", "show", "prune"]
    names = {panel.name for panel in first.panels}
    assert {"input_over_time", "residual_speed", "residual_position", "spectrum_position",
            "residual_whiteness"} <= names
    for panel in first.panels:
        assert panel.step in {step.name for step in first.steps}
        for curve in panel.curves:
            assert len(curve.x) == len(curve.y) > 0
            assert np.isfinite(curve.y).all()
    assert set(EFFECTS) - set(STRANGERS) <= set(LAWS)


def emps(repository, shared_data, name):
    record = import_file(shared_data / "emps" / name,
                         load_map(repository / "benchmarks" / "rigs" / "emps.yaml"))
    assert isinstance(record, RigRecord)
    return record


def test_the_measured_drive_names_coulomb_friction_and_offset(repository, shared_data, tmp_path):
    measured = emps(repository, shared_data, "DATA_EMPS.mat")
    found = identify([measured], validate=[emps(repository, shared_data, "DATA_EMPS_PULSES.mat")])
    names = [{f.effect, *f.equivalent} for f in found.findings]
    assert "coulomb_friction" in names[0]
    assert {"offset", "asymmetric_friction"} <= names[1]
    values = {p.name: p.value for f in found.findings for p in f.parameters}
    assert values["coulomb_friction.level"] == pytest.approx(20.3935, rel=0.03)
    assert values["offset.value"] == pytest.approx(-3.1648, rel=0.10)
    assert found.gap_after < 0.25 * found.gap_before


def test_a_bag_of_the_measured_motor_goes_through_import(repository, shared_data, tmp_path):
    assert run([
        "import", str(shared_data / "laas_anticogging" / "stopped_data.txt.gz"), "--map",
        str(repository / "benchmarks" / "rigs" / "laas.yaml"), "--out",
        str(tmp_path / "bag")]) == 0
    record = read_rig_bag(tmp_path / "bag")
    assert len(record) == 31666
    assert " gap" in record.axis.notes[0]
