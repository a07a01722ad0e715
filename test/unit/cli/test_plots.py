"""What the plots show: closed forms on made-up records, and files that are really drawn."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from ema_cli.main import run
from ema_cli.views import evidence_plot
from ema_cli.views import record_plots as plots
from ema_cli.views.pictures import save_picture
from ema_prognostics.features.turns import paper_window, whole_turns
from ema_prognostics.verdict.examination import examine
from ema_prognostics.verdict.judge import Judge
from ema_record.channels import N_CHANNELS
from ema_record.errors import OutputError
from ema_record.profile import load_profile
from ema_record.record import Record
from support.actuators import changed

OMEGA = 790.6
RATE = 20_000.0


def rotating(lines=(), drift=0.0):
    """Return a record of the step profile, the rotor at constant speed but for `lines`."""
    time = (np.arange(9000) + 0.5) / RATE
    samples = np.zeros((len(time), N_CHANNELS))
    theta = OMEGA * time + 0.3
    samples[:, 0] = time
    samples[:, 1] = OMEGA + drift * time
    for order, amplitude, phase in lines:
        samples[:, 1] += amplitude * np.cos(order * theta + phase)
    for k in range(3):
        angle = np.mod(theta - k * 2.0 * np.pi / 3.0, 2.0 * np.pi)
        on = np.where((angle > np.pi / 6) & (angle < 5 * np.pi / 6), 7.0, 0.0)
        off = np.where((angle > 7 * np.pi / 6) & (angle < 11 * np.pi / 6), -7.0, 0.0)
        samples[:, 2 + k] = on + off
        samples[:, 5 + k] = 1.1 * (on + off)
    samples[:, 8] = np.mod(theta, 2.0 * np.pi)
    samples[:, 9] = -0.4 + OMEGA / 500.0 * time
    return Record(samples=samples, profile=load_profile("step"))


def test_spectrum_finds_lines_at_multiples_of_the_rotor_angle():
    record = rotating([(1, 0.2, 0.4), (2, 0.5, -1.0), (6, 0.05, 2.0)], drift=30.0)
    turns = whole_turns(record, paper_window(record.profile))
    order, amplitude = plots.speed_spectrum(turns)
    assert turns.frequency == pytest.approx(OMEGA / (2.0 * np.pi), rel=1e-4)
    at = {n: amplitude[n * turns.count] for n in range(1, 13)}
    assert order[turns.count] == 1.0
    assert at[1] == pytest.approx(0.2, rel=0.03)
    assert at[2] == pytest.approx(0.5, rel=0.02)
    assert at[6] == pytest.approx(0.05, rel=0.1)
    assert max(at[n] for n in (3, 4, 5, 7, 8, 9, 10, 11, 12)) < 0.01


def test_folded_currents_are_those_of_the_sectors():
    record = rotating()
    figure = plots._currents(record, whole_turns(record, paper_window(record.profile)))
    assert [axes.get_ylabel() for axes in figure.axes] == [f"phase {p} (A)" for p in "abc"]
    samples, current, reference = figure.axes[0].lines
    bins = current.get_xdata()
    inside = (bins > 35.0) & (bins < 145.0)
    outside = (bins > 155.0) & (bins < 205.0)
    assert current.get_ydata()[inside] == pytest.approx(7.0)
    assert reference.get_ydata()[inside] == pytest.approx(7.7)
    assert current.get_ydata()[outside] == pytest.approx(0.0, abs=1e-12)
    assert len(samples.get_xdata()) > 5000


def test_torque_estimate_of_two_phases_on_is_twice_k_times_the_current():
    estimate = plots.torque_estimate(rotating())
    assert np.median(estimate) == pytest.approx(2.0 * 0.0376 * 7.0, rel=1e-6)


def test_plots_are_drawn_legibly_and_never_overwritten(tmp_path):
    record = rotating([(2, 0.5, 0.0)])
    files = plots.plot_record(record, tmp_path / "new" / "plots")
    assert [file.stem for file in files] == list(plots.NAMES)
    for file in files:
        image = imread(file)
        assert image.shape[1] == 1080
        assert image.shape[0] >= 600
        ink = (image[:, :, :3].min(axis=2) < 0.5).mean()
        assert 0.002 < ink < 0.3
    with pytest.raises(OutputError, match="never overwritten"):
        plots.plot_record(record, tmp_path / "new" / "plots")


def test_a_record_without_turns_gives_the_plots_that_it_can(tmp_path):
    record = rotating()
    still = np.array(record.samples)
    still[:, 8] = 1.0
    still[:, 1] = 0.0
    files = plots.plot_record(Record(samples=still, profile=record.profile), tmp_path / "p")
    assert [file.stem for file in files] == ["speed", "surface", "torque"]


def test_the_torque_of_a_bag_is_labelled_as_an_estimate():
    record = rotating()
    (axes,) = plots._torque(record, None).axes
    assert "estimate" in axes.get_ylabel()
    traced = plots._torque(record, np.zeros((len(record), 3))).axes
    assert [("estimate" in a.get_ylabel(), "N m" in a.get_ylabel()) for a in traced] == [
        (False, True), (False, True)
    ]


def test_a_file_in_the_place_of_the_folder_is_refused_before_the_work(tmp_path, capsys):
    blocked = tmp_path / "file"
    blocked.write_text("kept", encoding="utf-8")
    out = tmp_path / "bag"
    assert run(["simulate", "--profile", "step", "--out", str(out), "--plot", str(blocked)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert blocked.read_text(encoding="utf-8") == "kept"
    assert not out.exists()


@pytest.mark.slow
def test_channels_that_were_not_recorded_are_rebuilt_and_that_is_said(tmp_path):
    record = rotating()
    record.samples[record.time < record.profile.inverter_off, 2:5] = 0.0
    samples = np.array(record.samples)
    samples[:, [4, 9]] = np.nan
    part = Record(samples=samples, profile=record.profile)
    whole, text = plots.completed_record(part)
    assert text == "not recorded, rebuilt from the others: phase_current_c, surface_position"
    np.testing.assert_allclose(whole.samples[:, 4], record.samples[:, 4], atol=1e-9)
    np.testing.assert_allclose(whole.samples[:, 9], record.samples[:, 9], atol=1e-3)
    assert plots.completed_record(record) == (record, "")
    assert len(plots.plot_record(part, tmp_path / "p")) == len(plots.NAMES)
    samples[:, [5, 6, 7, 8]] = np.nan
    samples[:, 2:4] = 0.0  # no current from which the angle could be told
    files = plots.plot_record(Record(samples=samples, profile=record.profile), tmp_path / "q")
    assert [file.stem for file in files] == ["speed", "surface", "torque"]


@pytest.mark.parametrize(("stop", "linear"), [(0.6, 1.0), (0.06, 0.1), (3.0, 10.0)])
def test_the_scale_of_the_surface_is_that_of_its_travel(stop, linear):
    axes = plots._surface(rotating(), changed(surface={"end_stop": stop})).axes[1]
    assert axes.yaxis.get_transform().linthresh == pytest.approx(linear)
    assert f"linear to ±{linear:g}" in axes.get_ylabel()
    assert [t.get_text() for t in axes.get_yticklabels()].count("") == 4


@pytest.fixture(scope="module")
def examined(repository):
    judge = Judge()
    return examine(judge, repository / "bags" / "sim_0001_extended"), judge


def test_evidence_shows_each_reason_outside_of_healthy_units(examined, monkeypatch):
    found, judge = examined
    monkeypatch.setattr(evidence_plot, "UNITS", 2)
    figure = evidence_plot.evidence_figure(found, judge.fleet_cascade("extended"))
    reasons, others = figure.axes[:3], figure.axes[3:]
    for axes, evidence in zip(reasons, found.verdict.evidence):
        (band, *_), low, high = axes.patches, *evidence.healthy
        assert (band.get_x(), band.get_x() + band.get_width()) == pytest.approx(
            (low, high), rel=1e-3)
        (value,) = [line.get_xdata()[0] for line in axes.lines if line.get_marker() == "D"
                    and len(line.get_xdata())][:1]
        assert value == pytest.approx(evidence.value, rel=1e-3)
        assert not low <= value <= high
        first, last = axes.get_xlim()
        assert first < min(low, value) and max(high, value) < last
    slow, full, *currents, course, _ = others
    titles = [axes.get_title(loc="right") for axes in (slow, full)]
    assert titles == ["quarter speed", "full speed"]
    sizes = slow.lines[-1].get_ydata()
    usual = [bar.get_height() for bar in slow.patches]
    beyond = [h + 1 for h in range(6) if sizes[h] > usual[h]]
    assert beyond == [2, 4]  # a turn short: these lines and no other
    assert sizes[1] == pytest.approx(100 * 0.278 * 0.098, rel=0.1)
    assert [axes.get_ylabel() for axes in currents] == ["a (A)", "b (A)", "c (A)"]
    assert len(course.patches) == 6 and {t.get_text() for t in course.texts} == {
        "full speed", "quarter speed", "slow ramp"}


@pytest.mark.parametrize(("name", "begins"), [
    ("a.png", b"\x89PNG"), ("a.svg", b"<?xml"), ("a.PDF", b"%PDF"),
])
def test_pictures_in_three_formats(tmp_path, name, begins):
    path = save_picture(Figure(), tmp_path / name)
    assert path.read_bytes().startswith(begins)
    with pytest.raises(OutputError, match="never overwritten"):
        save_picture(Figure(), path)
