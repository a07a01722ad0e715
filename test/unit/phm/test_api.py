"""`import ema_phm as ema`: names and paths accepted, errors that name the choices."""

import inspect
import re
import sys

import numpy as np
import pytest

import ema_phm as ema
from ema_record.record import Provenance


@pytest.fixture(scope="module")
def bag(repository):
    return repository / "bags" / "sim_0001_step"


@pytest.fixture(scope="module")
def record(bag):
    return ema.read(bag)


def test_every_name_is_there():
    assert set(ema.__all__) == set(ema._PLACES) == set(dir(ema))
    assert all(getattr(ema, name) is not None for name in ema.__all__)
    with pytest.raises(AttributeError, match="it has read"):
        _ = ema.reed


def documented(page):
    """Return the calls of the table of functions with their parameters and defaults."""
    rows = re.findall(r"^\| (`.+?`) \|", page.partition("## Functions")[2].partition("\n## ")[0],
                      re.MULTILINE)
    return dict(re.fullmatch(r"(\w+)\((.*)\)", call).groups()
                for row in rows for call in re.findall("`(.+?)`", row))


def called(function):
    """Return the parameters of a function as the table has them."""
    return ", ".join(
        p.name if p.default is p.empty else f"{p.name}={p.default!r}".replace("'", '"')
        for p in inspect.signature(function).parameters.values())


def test_the_reference_has_every_name_as_it_is(repository):
    page = (repository / "docs" / "api.md").read_text(encoding="utf-8")
    functions = {n for n in ema.__all__ if inspect.isfunction(getattr(ema, n))}
    table = documented(page)
    assert set(table) == functions
    assert table == {name: called(getattr(ema, name)) for name in functions}
    for name in set(ema.__all__) - functions - {"__version__"}:
        assert re.search(rf"`(ema\.)?{name}`", page), name


def test_the_reference_has_every_method_and_no_other(repository):
    page = (repository / "docs" / "api.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([A-Z]\w+)` \| (.+) \|$", page, re.MULTILINE)
    assert {name for name, _ in rows} == {
        n for n in ema.__all__ if n[0].isupper() and not n.endswith("Error")}
    for name, words in rows:
        kind = getattr(ema, name)
        there = {*dir(kind), *getattr(kind, "__dataclass_fields__", ())}
        said = set(re.findall(r"`(\w+)", words))
        assert said <= there, (name, said - there)
        tables = {n for n in there if n.startswith("to_")}
        assert tables <= said, (name, tables - said)


def test_a_rig_of_arrays():
    time = np.arange(200) / 100.0
    values = {"speed": np.sin(time), "input_current": np.cos(time), "time": time}
    record = ema.rig(values, name="bench")
    assert [c.name for c in record.channels] == ["time", "input_current", "speed"]
    assert (record.channel("speed") == np.sin(time)).all()
    assert ema.rig({**values, "input_current": list(values["input_current"])}).rate == record.rate
    for changed, problem in (
        ({"input_force": time}, "2 inputs"), ({"sped": time}, "did you mean 'speed'"),
        ({"speed": time[1:]}, "one value a sample"), ({"time": time[::-1]}, "does not increase"),
        ({"speed": time * np.nan}, "finite"),
    ):
        with pytest.raises(ema.EmaError, match=problem) as error:
            ema.rig({**values, **changed})
        assert "\n" not in str(error.value)
    with pytest.raises(ema.EmaError, match="0 inputs"):
        ema.rig({"time": time, "speed": time})
    with pytest.raises(ema.EmaError, match="motion"):
        ema.rig(values, motion="sideways")


def test_read_write_and_diagnose(bag, record, tmp_path):
    assert repr(record) == "<Record SIM-0001, step: 9000 samples in 0.45 s, complete>"
    again = ema.read(ema.write(record, tmp_path / "bag"))
    assert (again.samples == record.samples).all()
    verdict = ema.diagnose(record)
    assert verdict == ema.diagnose(str(bag))
    assert repr(verdict) == "<Verdict FAULT: turn short, phase b 9.68 % (8.8 to 10.6)>"
    of_bag, of_record = ema.to_json(bag), ema.to_json(record)
    assert of_bag["faults"] == of_record["faults"] == verdict.to_dict()["faults"]
    assert len(of_bag["record_sha256"]) == 64 and of_record["record_sha256"] is None
    assert ema.diagnose("nowhere").outcome == "invalid"


def test_a_record_of_ones_own(record, tmp_path):
    """As the page says: arrays in, a bag that reads and is judged alike."""
    bus, temperature = np.array([[0.1, 270.0, 1.2]]), np.array([[0.1, 24.0]])
    own = ema.Record(
        samples=np.array(record.samples), profile=record.profile,
        provenance=Provenance(serial_number="SN-0042", software_version="rig 1.2"),
        dc_bus=bus, winding_temperature=temperature)
    again = ema.read(ema.write(own, tmp_path / "own"))
    assert again.samples == pytest.approx(own.samples, abs=1e-5, nan_ok=True)
    assert again.dc_bus == pytest.approx(bus, rel=1e-6)
    assert again.winding_temperature == pytest.approx(temperature, rel=1e-6)
    assert again.provenance.serial_number == "SN-0042"
    assert ema.diagnose(again).outcome == ema.diagnose(own).outcome != "invalid"


def test_tables(record, monkeypatch):
    frame = record.to_pandas()
    assert frame.index.name == "time[s]"
    assert (frame["motor_speed[rad/s]"].to_numpy() == record.channel("motor_speed")).all()
    assert frame.attrs["serial_number"] == "SIM-0001"
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ema.UsageError, match="xarray, which is not installed: pip install") as no:
        record.to_xarray()
    assert "\n" not in str(no.value)


def test_trend_and_plots(bag, record):
    trend = ema.trend([bag, bag.with_name("sim_0001_extended")])
    assert repr(trend) == "<UnitTrend SIM-0001: 2 flights, turn short, phase b present>"
    assert trend.to_pandas().outcome.tolist() == ["fault", "fault"]
    for figure in (ema.plot(trend), ema.plot(record, "spectrum"), ema.plot(bag)):
        assert type(figure).__name__ == "Figure"
        assert figure.axes


@pytest.mark.parametrize("shown", ["record", "verdict", "trend"])
def test_html_is_escaped(shown, record):
    from dataclasses import replace

    bad = replace(record.provenance, serial_number="<b>", source="<i>")
    one = replace(record, provenance=bad)
    made = {"record": lambda: one, "verdict": lambda: ema.diagnose(one),
            "trend": lambda: ema.trend([one])}[shown]()
    assert len(repr(made)) < 200
    assert "\n" not in repr(made)
    assert made._repr_html_().startswith("<table>")
    assert "<b>" not in made._repr_html_()
    assert "<i>" not in made._repr_html_()


@pytest.mark.parametrize(("slip", "names"), [
    (lambda r: r.channel("speed"), "did you mean 'motor_speed'"),
    (lambda _: ema.simulate("extendd"), "did you mean 'extended'"),
    (lambda _: ema.simulate("step", effects={"turn_shrt.fraction": 0.1}), "turn_short"),
    (lambda _: ema.simulate("step", effects=["turn_short.fraction"]), "NAME.PARAMETER=VALUE"),
    (lambda r: ema.plot(r, "sped"), "did you mean 'speed'"),
    (lambda r: ema.diagnose(r, mode="robst"), "did you mean 'robust'"),
    (lambda _: ema.diagnose(5), "expected a path"),
    (lambda r: ema.trend([r], rule="4/3"), "K/N"),
    (lambda _: ema.trend([]), "0 flights"),
    (lambda r: ema.write(r.samples, "x"), "expected a record"),
    (lambda r: ema.diagnose(r, baseline=r), "not healthy itself"),
])
def test_slips_name_the_choices(slip, names, record):
    with pytest.raises(ema.EmaError, match=names) as error:
        slip(record)
    assert "\n" not in str(error.value)


def test_simulate_by_name_is_that_of_the_command():
    once = ema.simulate("step", effects={"backlash.increase": 1e-3}, seed=4)
    again = ema.simulate(effects="backlash.increase=1e-3", profile="step", seed=4)
    assert once.samples.tobytes() == again.samples.tobytes()
    assert set(ema.profiles()) >= {"step", "extended"}
    assert "turn_short" in ema.effects()
