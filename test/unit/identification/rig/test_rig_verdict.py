"""A verdict on a rig needs what is explained to say so; base parameters are told and written."""

from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from ema_cli.main import run
from ema_identification.rig.fit.model import KnownTerm, RigModel, load_rig_model
from ema_identification.rig.verdict import outcome, unexplained
from ema_identification.rig.workflow import identify_rig
from ema_rig.bag import write_rig_bag


def story(gaps, *, findings=("coulomb_friction",), validated=0, bound=0.0, stuck=False, size=1.0):
    inertia = SimpleNamespace(law=SimpleNamespace(name="inertia"))
    balance = SimpleNamespace(
        terms=(inertia,), replaced=lambda _k: False, span=lambda _k: slice(0, 1),
        bounds=SimpleNamespace(low=np.zeros(1), high=np.full(1, np.inf)),
        fit=SimpleNamespace(active=np.array([stuck])))
    return SimpleNamespace(
        gaps=gaps, findings=findings, validated=validated, noise_bound=bound, size=size,
        found=SimpleNamespace(unknown=None, balance=balance),
        start=SimpleNamespace(terms=(inertia,)),
        trajectory=SimpleNamespace(axis=SimpleNamespace(input="torque")))


@pytest.mark.parametrize(("given", "verdict", "why"), [
    ({"gaps": [0.9, 0.1]}, "explained", None),
    ({"gaps": [0.9, 0.26]}, "partly explained", "26 % of the input torque is not explained"),
    ({"gaps": [0.64], "findings": ()}, "partly explained", "64 % of the input torque"),
    ({"gaps": [0.2], "findings": ()}, "no disagreement", None),
    ({"gaps": [1.8, 0.4], "size": 2.0}, "explained", None),
    ({"gaps": [0.9, 0.1], "stuck": True}, "partly explained", "no axis is without inertia"),
    ({"gaps": [0.041, 0.052], "validated": 1, "bound": 0.06}, "partly explained", "grew from"),
    ({"gaps": [0.041, 0.052], "validated": 1, "bound": 0.045}, "contradicted", "grew from"),
    ({"gaps": [0.9, 0.5], "validated": 1, "bound": 0.1}, "partly explained", "50 %"),
])
def test_explained_only_if_the_shares_say_so(given, verdict, why):
    found, said = outcome(story(**given))
    assert found == verdict
    assert (why is None and said == ()) or any(why in line for line in said)


def test_the_share_is_that_of_the_input_about_its_mean():
    assert unexplained(story([0.9, 0.3], size=1.5)) == pytest.approx(0.2)


@pytest.mark.slow
def test_base_parameters_stand_on_the_terminal_and_in_the_model(bench, tmp_path, capsys):
    write_rig_bag(bench(), tmp_path / "bag")
    assert run(["identify", str(tmp_path / "bag"), "--out", str(tmp_path / "r")]) == 0
    out = capsys.readouterr().out
    assert "% of the input is explained" in out
    line = next(x for x in out.splitlines() if "inertia.value = " in x)
    assert "kg m²  (90 %: " in line
    assert float(line.split("= ")[1].split()[0]) == pytest.approx(0.05, rel=0.01)
    assert "this record can show inertia" in out
    model = load_rig_model(tmp_path / "r" / "model.yaml")
    assert model.terms[0].parameters == {}  # free stays free
    value, low, high = model.terms[0].estimate["value"]
    assert low <= value <= high
    assert value == pytest.approx(0.05, rel=0.01)
    assert model.axis.travel[0] < -1.0 < 1.0 < model.axis.travel[1]
    assert "inertia.value kg m²" in (tmp_path / "r" / "model.yaml").read_text()
    assert yaml.safe_load((tmp_path / "r" / "model.yaml").read_text())["axis"]["input"] == "torque"


def test_the_check_alone_fits_nothing(bench, tmp_path, capsys):
    write_rig_bag(bench(), tmp_path / "bag")
    assert run(["identify", str(tmp_path / "bag"), "--check"]) == 0
    assert capsys.readouterr().out.startswith("this record can show inertia, viscous friction")
    assert run(["identify", str(tmp_path / "bag"), "--check", "--json"]) == 0
    assert '"condition_number": ' in capsys.readouterr().out
    for option in ("--validate", "--baseline", "--without", "--profile", "--out"):
        assert run(["identify", str(tmp_path / "bag"), "--check", option, "no"]) == 2
        assert f"{option} with --check" in capsys.readouterr().err
    assert run(["identify", str(tmp_path / "bag")]) == 2
    assert "no --out: give the directory to make" in capsys.readouterr().err


def test_a_term_of_which_only_the_shape_is_given_stays_free(bench):
    given = RigModel(terms=(
        KnownTerm(effect="inertia"), KnownTerm(effect="viscous_friction"),
        KnownTerm(effect="spring", parameters={"rest": 0.1})))
    record = bench(lambda _t, q, _v, _a: 2.0 * (q - 0.1))
    spring = yaml.safe_load(identify_rig([record], given).model_text)["terms"][2]
    assert spring["parameters"] == {"rest": 0.1}
    assert spring["estimate"]["stiffness"][0] == pytest.approx(2.0, rel=0.05)
