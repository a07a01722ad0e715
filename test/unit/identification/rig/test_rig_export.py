"""The identified axis for simulators: closed forms, other people's readers, what is left out."""

import importlib.util
import math
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from ema_cli.main import run
from ema_identification.rig.export import export_model
from ema_record.errors import UsageError

J, B, F, K, REST, C = 0.05, 0.2, 0.4, 1.5, 0.1, 0.05
MODEL = f"""
rig: elbow
terms:
- effect: inertia
  estimate: {{value: [{J}, 0.049, 0.051]}}
- effect: viscous_friction
  estimate: {{value: [{B}, 0.19, 0.21]}}
- {{effect: coulomb_friction, parameters: {{level: {F}}}}}
- {{effect: offset, parameters: {{value: {C}}}}}
- {{effect: spring, parameters: {{stiffness: {K}, rest: {REST}}}}}
MOREaxis: {{motion: rotary, input: INPUT, travel: [-1.5, 2.0], largest_speed: 4.0,
        largest_input: 3.0}}
"""
COGGING = "- {effect: cogging_torque, parameters: {order: 24.0, amplitude: 0.3, phase: 0.7}}\n"
DELAY = "- {effect: control_delay, parameters: {delay: 0.004}}\n"


def text_of(more="", quantity="torque"):
    return MODEL.replace("MORE", more).replace("INPUT", quantity)


def model(path, more="", quantity="torque"):
    path.write_text(text_of(more, quantity))
    return path


def module(path, text):
    path.write_text(text)
    spec = importlib.util.spec_from_file_location("exported", path)
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def test_mjcf_holds_the_joint(tmp_path):
    found = export_model(model(tmp_path / "m.yaml"), "mjcf", body_inertia=0.01)
    assert found.left_out == ()
    root = ET.fromstring(found.text)
    joint = root.find("worldbody/body/joint").attrib
    assert joint["type"] == "hinge"
    values = {k: float(joint[k]) for k in ("armature", "damping", "frictionloss", "stiffness",
                                           "springref")}
    assert values == pytest.approx({"armature": J - 0.01, "damping": B, "frictionloss": F,
                                    "stiffness": K, "springref": REST})
    assert [float(x) for x in joint["range"].split()] == [-1.5, 2.0]
    actuator = root.find("actuator/general").attrib
    assert float(actuator["gainprm"]) == 1.0
    assert float(actuator["biasprm"].split()[0]) == -C
    assert root.find("worldbody/body/inertial").attrib["diaginertia"].split() == ["0.01"] * 3


def test_a_current_needs_its_gain_and_all_is_in_torque_then(tmp_path):
    path = model(tmp_path / "m.yaml", quantity="current")
    with pytest.raises(UsageError, match="input is a current, mjcf needs a torque: give --gain"):
        export_model(path, "mjcf")
    joint = ET.fromstring(export_model(path, "mjcf", gain=0.5).text).find(".//joint").attrib
    assert float(joint["armature"]) == pytest.approx(0.5 * J)
    assert float(joint["frictionloss"]) == pytest.approx(0.5 * F)


def test_urdf_holds_damping_and_friction_and_says_the_rest(tmp_path):
    found = export_model(model(tmp_path / "m.yaml", COGGING), "urdf")
    joint = ET.fromstring(found.text).find("joint")
    assert joint.find("dynamics").attrib == {"damping": "0.2", "friction": "0.4"}
    assert joint.find("limit").attrib == {
        "lower": "-1.5", "upper": "2", "velocity": "4", "effort": "3"}
    assert [line.split(" ")[0] for line in found.left_out] == [
        "offset", "spring", "cogging_torque"]


def test_the_python_module_is_the_balance(tmp_path):
    found = export_model(model(tmp_path / "m.yaml", COGGING + DELAY), "python")
    assert found.left_out == ("control_delay (delay 0.004)",)
    own = module(tmp_path / "m.py", found.text)
    x, v, a = 0.3, -2.0, 7.0
    expected = (J * a + B * v - F + C + K * (x - REST) + 0.3 * math.cos(24 * x - 0.7))
    assert own.needed_input(x, v, a) == pytest.approx(expected, rel=1e-12)
    of_arrays = np.array([x, v, a])
    assert own.needed_input(*of_arrays) == own.needed_input(x, v, a)
    assert own.step(*of_arrays, 1e-3) == own.step(x, v, a, 1e-3)


def test_a_free_run_stops_when_friction_says(tmp_path):
    """J dv/dt = -B v - F from v_0: it stops at t = J/B ln(1 + B v_0 / F) and stays."""
    text = text_of().replace(f"value: {C}", "value: 0.0").replace(
        f"stiffness: {K}", "stiffness: 0.0")
    (tmp_path / "m.yaml").write_text(text)
    own = module(tmp_path / "m.py", export_model(tmp_path / "m.yaml", "python").text)
    start, dt = 3.0, 1e-5
    stop = J / B * math.log(1.0 + B * start / F)
    x, v, t = 0.0, start, 0.0
    while v > 0.0:
        x, v = own.step(x, v, 0.0, dt)
        t += dt
    assert t == pytest.approx(stop, abs=5e-4 * stop)
    assert x == pytest.approx((J * start - F * stop) / B, rel=1e-3)
    assert own.step(x, v, 0.9 * F, dt) == (x, 0.0)


def test_mujoco_moves_as_we_predict(tmp_path):
    mujoco = pytest.importorskip(
        "mujoco", reason="no MuJoCo (Python 3.11 or later): MJCF is NOT run by it")
    path = model(tmp_path / "m.yaml")
    plant = mujoco.MjModel.from_xml_string(export_model(path, "mjcf").text)
    state = mujoco.MjData(plant)
    own = module(tmp_path / "m.py", export_model(path, "python").text)
    dt, x, v = plant.opt.timestep, 0.0, 0.0
    ours, theirs = [], []
    for k in range(8000):
        u = 1.2 * math.sin(2 * math.pi * 0.5 * k * dt) + 0.4 * math.sin(2 * math.pi * 1.3 * k * dt)
        state.ctrl[0] = u
        mujoco.mj_step(plant, state)
        x, v = own.step(x, v, u, dt)
        ours.append(x)
        theirs.append(float(state.qpos[0]))
    assert np.max(np.abs(np.array(ours) - theirs)) < 0.03 * np.ptp(ours)


@pytest.mark.parametrize(("text", "form", "options", "match"), [
    ("rig: a\nterms:\n- {effect: inertia, parameters: {value: 1.0}}\n", "mjcf", {},
     "does not say its axis"),
    (text_of().replace(str([J, 0.049, 0.051]), "[0.0, 0.0, 0.0]"),
     "python", {}, "inertia 0, expected more than 0"),
    (text_of().replace(f"stiffness: {K}, ", ""), "python", {},
     "spring has no stiffness: identify a record"),
    (text_of(), "fmu", {}, "unknown format of a model"),
    (text_of("- {effect: control_delay, estimate: {'x\\n': [1, 1, 1]}}\n").replace(
        "'x\\n'", '"\\"\\"\\"\\nimport os"'), "python", {}, "is no name of a parameter"),
    (text_of("- {effect: spring, parameters: {stiffness: 1e300}}\n"), "python", {},
     r"stiffness 1e\+300: at most 1e\+12"),
    (text_of(), "mjcf", {"gain": -1.0}, "--gain -1"),
    (text_of(), "mjcf", {"body_inertia": 1.0},
     "expected 0 to less than the whole"),
])
def test_what_cannot_be_exported_says_why(tmp_path, text, form, options, match):
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(UsageError, match=match) as caught:
        export_model(tmp_path / "m.yaml", form, **options)
    assert "\n" not in str(caught.value)


def test_the_command_writes_a_new_file_and_says_what_is_left_out(tmp_path, capsys):
    path = model(tmp_path / "model.yaml", COGGING)
    assert run(["export", str(path), "--format", "mjcf"]) == 0
    captured = capsys.readouterr()
    assert "no place for it: cogging_torque (order 24, amplitude 0.3" in captured.err
    assert ET.parse(tmp_path / "model.xml").getroot().tag == "mujoco"
    assert run(["export", str(path)]) == 2
    assert "never overwritten" in capsys.readouterr().err
    assert run(["export", str(path), "--format", "csv"]) == 2
    assert "the formats are mjcf, urdf, python" in capsys.readouterr().err
    assert run(["export", str(path), "--plot", str(tmp_path / "p")]) == 2
    assert "exported alone" in capsys.readouterr().err
