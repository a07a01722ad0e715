"""The report: whole or absent, self-contained, safe, the same bytes, and says what it must."""

import base64
import html
import json
import re
import shlex
from dataclasses import replace

import numpy as np
import pytest
import typer
import yaml

from ema_cli.main import build_app
from ema_identification.report import plots
from ema_identification.report import write as writing
from ema_identification.report.page import MODEL_FILE, NEXT_TEST_FILE, advice, next_commands
from ema_identification.report.plots import gap_stages
from ema_identification.report.write import write_answer, write_page
from ema_identification.result import Curve, Formula, Panel
from ema_record.errors import OutputError
from ema_record.kit import using_kit
from ema_record.profile import load_profile
from ema_sim.model_file import load_model_file
from support.simulations import make_kit

INPUTS = {"measured": ["unit_extended"], "validate": ["unit_step"], "model": ["nominal"]}


def text_of(page):
    """Return the page as a person reads it."""
    body = re.sub(r"<style>.*?</style>", "", page.read_text("utf-8"), flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", body)).split())


def write_report(identification, out, title):
    """Write an answer and its page; return the path of the page."""
    write_answer(identification, out)
    return write_page(identification, out, title=title, inputs=INPUTS).path


@pytest.fixture(scope="module")
def page(explained, tmp_path_factory):
    """Return the path of a page."""
    out = tmp_path_factory.mktemp("report") / "unit"
    return write_report(explained, out, title="UNIT-0042 <b>")


def test_all_files_are_there(page, explained):
    folder = page.parent
    names = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    assert names == {
        "report.html", "identification.json", MODEL_FILE, NEXT_TEST_FILE, "plots/gap_by_stage.png",
        "plots/current_over_angle.png", "plots/lines.png",
    }
    assert [p.name for p in folder.parent.iterdir()] == [folder.name]


def test_json_is_the_contract_object(page, explained):
    found = json.loads((page.parent / "identification.json").read_text("utf-8"))
    assert found == replace(explained, model=page.parent / MODEL_FILE).to_dict()
    assert found["model"].endswith(MODEL_FILE)


def test_model_and_next_test_are_files_that_the_commands_read(page):
    effects = load_model_file(page.parent / MODEL_FILE).effects
    assert effects.cogging_torque.amplitude == pytest.approx(0.0301)
    assert load_profile(page.parent / NEXT_TEST_FILE).points[-1][1] == pytest.approx(-0.2)


def test_page_loads_nothing_from_elsewhere(page):
    source = page.read_text("utf-8")
    assert "<script" not in source
    assert not re.search(r"(src|href)=\"(?!data:image/png;base64,)", source)
    assert "@import" not in source
    assert "url(" not in source
    pictures = re.findall(r"data:image/png;base64,([^\"]+)", source)
    files = {p.read_bytes() for p in (page.parent / "plots").iterdir()}
    assert {base64.b64decode(picture) for picture in pictures} == files


@pytest.mark.parametrize("said", [
    "The model lacked cogging torque or gear mesh ripple",
    "gap before", "gap after", "noise floor", "gap closed",
    "0.0301 N m", "0.0294 to 0.0308 N m", "< 0.001",
    "Cannot be told apart with these data: gear mesh ripple",
    "The test that would separate them: a ramp at 0.1 rad/s",
    "motor torque against rotor angle: 12 a turn",
    "motor.phase_resistance", "1.09 to 1.13 Ω", "gives 6 and 12 a turn",
    "62,600 samples", "ema simulate --model", "unit_extended", "UNIT-0042 <b>",
])
def test_page_says(page, said):
    assert said in text_of(page)


def test_a_contradicted_answer_is_not_to_be_used(explained, tmp_path):
    """Mixed records of two units: the gap grew from 6.1 to 15.2 and the page called it closed."""
    against = replace(explained, verdict="contradicted", gap_before=6.12, gap_after=15.2,
                      noise_floor=3.95, model_text="", next_profile=None)
    said = text_of(write_report(against, tmp_path / "out", title="UNIT"))
    assert "grew from 6.12 to 15.2" in said
    assert "Do not use what was found" in said
    for wrong in ("Use the updated model", "gap closed", "falls from", "The model lacked",
                  "ema simulate"):
        assert wrong not in said
    assert against.exit_status == 3
    assert json.loads((tmp_path / "out" / "identification.json").read_text())["verdict"] == (
        "contradicted")


def test_who_is_contradicted_is_not_sent_to_the_fitted_record(explained, tmp_path):
    """The gap before lay in the noise: "Judge by the fitted record" stood beside "Do not use"."""
    against = replace(explained, verdict="contradicted", gap_before=1.1, gap_after=15.2,
                      noise_floor=1.0, model_text="", next_profile=None)
    said = text_of(write_report(against, tmp_path / "out", title="UNIT"))
    assert "Judge by the fitted record" not in said


def test_without_held_out_data_none_are_claimed(explained, tmp_path):
    alone = replace(explained, held_out=False, gap_unit="rms (fitted record)")
    said = text_of(write_report(alone, tmp_path / "out", title="UNIT"))
    assert "held-out data" not in said
    assert "gap on the fitted data" in said
    assert "--validate" in said


def test_a_name_that_is_not_utf_8_is_no_reason_to_lose_the_answer(explained, tmp_path):
    assert "\\udcff" in text_of(write_report(explained, tmp_path / "out", title="\udcff"))


def test_phase_and_formula_stand_on_the_page_and_in_the_json(explained, tmp_path):
    finding = replace(explained.findings[0], choices={"turn_short.phase": "b"},
                      formula=Formula("A wave.", "u = A cos(n θ - φ)", "somebody"))
    made = replace(explained, findings=(finding,))
    said = text_of(write_report(made, tmp_path / "out", title="UNIT"))
    assert "turn_short.phase b" in said
    assert "u = A cos(n θ - φ)" in said
    assert "sin(n θ" not in said  # the formula of the actuator's entry of that name
    (found,) = json.loads((tmp_path / "out" / "identification.json").read_text())["findings"]
    assert found["choices"] == {"turn_short.phase": "b"}
    assert found["equation"] == "u = A cos(n θ - φ)"


def test_each_addition_has_a_bar_of_its_own(explained):
    first = replace(explained.findings[0], gap_before=42.0, gap_after=7.0)
    second = replace(first, effect="turn_short", gap_before=7.0, gap_after=3.0)
    made = replace(explained, findings=(first, second), gap_before=42.0, gap_after=3.0)
    assert [value for _, value in gap_stages(made)] == [42.0, 7.0, 3.0]


def test_a_picture_that_fails_loses_neither_answer_nor_page(explained, tmp_path):
    uneven = Panel(name="uneven", title="x", x_label="x", y_label="y", step="show", curves=(
        Curve(label="", x=np.arange(5.0), y=np.arange(4.0)),))
    out = tmp_path / "out"
    write_answer(replace(explained, panels=(uneven, *explained.panels)), out)
    assert {p.name for p in out.iterdir()} == {"identification.json", MODEL_FILE, NEXT_TEST_FILE}
    page = write_page(replace(explained, panels=(uneven, *explained.panels)), out, title="x",
                      inputs=INPUTS)
    assert list(page.not_drawn) == ["uneven"]
    assert "The picture uneven could not be drawn" in text_of(page.path)
    assert (out / "plots" / "lines.png").exists()
    assert not (out / "plots" / "uneven.png").exists()


def test_a_curve_without_points_is_drawn(explained):
    empty = Curve(label="nothing", x=np.empty(0), y=np.empty(0), role="after")
    panel = replace(explained.panels[0], curves=(*explained.panels[0].curves, empty))
    assert plots.draw_panel(panel).startswith(b"\x89PNG")


@pytest.mark.parametrize("machine", ["actuator", "rig"])
def test_what_to_run_next_is_understood_by_the_commands(explained, machine, tmp_path):
    found = replace(explained, machine=machine,
                    next_profile=explained.next_profile if machine == "actuator" else None)
    inputs = {"measured": ["a b", "c"], "validate": ["d"], "without": ["backlash"],
              "baseline": ["e"], "model": ["nominal"]}
    with using_kit(make_kit(tmp_path / "a kit", {}, cascade=False)):
        lines = next_commands(found, tmp_path / "re port", inputs)
    assert all("/a kit'" in line and "--kit" in line for line in lines)
    assert any("--baseline e" in line for line in lines)
    assert len(lines) == (4 if machine == "actuator" else 1)
    for line in lines:
        program, name, *arguments = shlex.split(line)
        assert program == "ema"
        assert name != "simulate" or machine == "actuator"  # the emulated actuator, no rig
        command = typer.main.get_command(build_app(name))
        command.make_context(name, arguments)
    assert any("'a b' c" in line and "--without backlash" in line for line in lines)


def test_a_second_record_is_held_to_the_same_model_by_the_test_it_holds(explained, tmp_path):
    model = tmp_path / "mine.yaml"
    model.write_text("")
    inputs = {"measured": ["a"], "model": [str(model)], "profile": ["p.yaml"]}
    again, both = next_commands(explained, tmp_path / "out", inputs)[1::2]
    assert "--profile p.yaml --model" in again and "mine.yaml" not in again
    assert f"--model {model}" in both and "--profile" not in both


def test_text_is_escaped(page):
    assert "UNIT-0042 <b>" not in page.read_text("utf-8")


def test_unknown_effect_shows_its_shape(unknown, tmp_path):
    found = write_report(unknown, tmp_path / "out", title="UNIT-0043")
    assert "12 a turn, 0.030 N m" in text_of(found)
    assert "that the catalogue does not hold" in text_of(found)
    assert (found.parent / "plots" / "shape.png").exists()
    assert not (found.parent / MODEL_FILE).exists()
    assert json.loads((found.parent / "identification.json").read_text())["model"] is None


@pytest.mark.parametrize("port", ["controller, sensor", "winding"])
def test_only_another_controller_is_to_be_compared(unknown, port):
    found = replace(unknown, unknown=replace(unknown.unknown, port=port))
    assert any("controller" in line for line in advice(found)) == port.startswith("controller")


def test_curves_of_one_colour_have_different_markers_and_the_legend_hides_none(monkeypatch):
    x = np.arange(5.0)
    panel = Panel(name="many", title="Many.", x_label="x", y_label="y", step="where", curves=tuple(
        Curve(label=f"curve {k}", x=x, y=x + k, style="points") for k in range(11)))
    figures = []
    monkeypatch.setattr(plots, "to_png", lambda figure: figures.append(figure) or b"")
    plots.draw_panel(panel)
    (figure,) = figures
    figure.draw_without_rendering()
    lines = figure.axes[0].lines
    assert len({(line.get_color(), line.get_marker()) for line in lines}) == 11
    assert figure.legends[0].get_window_extent().y1 < figure.axes[0].get_window_extent().y0


@pytest.mark.parametrize("ends", [(0.2, 8.0), (0.03, 40.0), (1e-3, 1e3)])
def test_a_logarithmic_axis_has_plain_numbers(monkeypatch, ends):
    figures = []
    monkeypatch.setattr(plots, "to_png", lambda figure: figures.append(figure) or b"")
    curve = Curve(label="", x=np.array([0.0, 1.0]), y=np.array(ends), style="points")
    plots.draw_panel(Panel(name="axis", title="Axis.", x_label="x", y_label="y", step="show",
                           curves=(curve,), log_y=True))
    (figure,) = figures
    figure.draw_without_rendering()
    labels = [t.get_text().replace("\N{MINUS SIGN}", "-") for minor in (False, True)
              for t in figure.axes[0].yaxis.get_ticklabels(minor=minor) if t.get_text()]
    assert len(labels) >= 3
    assert all(f"{float(label):g}" == label for label in labels)


def test_no_disagreement(explained, tmp_path):
    nothing = replace(
        explained, verdict="no disagreement", gap_before=explained.noise_floor, findings=(),
        rivals=(), gap_after=explained.noise_floor, next_test=None, next_profile=None,
        model_text="", panels=(),
    )
    said = text_of(write_report(nothing, tmp_path / "out", title="UNIT"))
    assert "Model and measurement agree" in said
    assert "Keep the model" in said
    assert "What the model lacked" not in said


def test_same_identification_same_bytes(page, explained, tmp_path, monkeypatch):
    """All but the model's place, which is in the commands and in the JSON file."""
    other = write_report(explained, tmp_path / "unit", title="UNIT-0042 <b>")
    for path in sorted(page.parent.rglob("*")):
        if path.is_file():
            ours = path.read_bytes().replace(str(page.parent).encode(), b"OUT")
            theirs = (other.parent / path.relative_to(page.parent)).read_bytes()
            assert ours == theirs.replace(str(other.parent).encode(), b"OUT"), path.name


def test_an_existing_folder_is_left_alone(explained, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "kept").write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError, match="never overwritten"):
        write_report(explained, tmp_path / "out", title="x")
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["kept"]


def test_a_report_that_fails_leaves_nothing(explained, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writing, "_write_files", full)
    with pytest.raises(OutputError, match="No space left on device"):
        write_report(explained, tmp_path / "out", title="x")
    assert list(tmp_path.iterdir()) == []


def test_next_test_is_plain_yaml(page):
    data = yaml.safe_load((page.parent / NEXT_TEST_FILE).read_text("utf-8"))
    assert data["points"][0] == [0.0, -0.4]


def test_what_has_changed_since_the_baseline_is_said(explained, tmp_path):
    since = replace(explained, verdict="partly explained", reasons=("grown since May",))
    nothing = replace(explained, verdict="no disagreement", findings=(), since=since)
    said = text_of(write_report(nothing, tmp_path / "unit", title="U"))
    assert "What has changed since the baseline" in said
    assert "cogging_torque.amplitude" in said and "grown since May" in said
    same = replace(nothing, since=replace(nothing, since=None, reasons=()))
    said = text_of(write_report(same, tmp_path / "same", title="U"))
    assert "Nothing has changed since the baseline" in said


def test_where_is_said_once(explained, tmp_path):
    place = "motor torque against rotor angle"
    (finding,) = explained.findings
    where = replace(finding.where, text=f"{place}, whole test: 3.1 standard deviations")
    twice = replace(explained, findings=(replace(finding, where=where),))
    for name, one in (("short", explained), ("long", twice)):
        said = text_of(write_report(one, tmp_path / name, title="U"))
        assert said.count(f"Where: {place}") == 1 and f"{place}: {place}" not in said
