"""The kit's actuator by hash: what names it, and what is said of a record of another one."""

import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from ema_cli.views.verdict import next_commands
from ema_prognostics.verdict.judge import Judge
from ema_record.actuator import actuator_from, load_actuator
from ema_record.actuator_type import actuator_hash, actuator_hashes, is_of_another_actuator
from ema_record.bag.read import write_bag
from ema_record.channels import CHANNEL_NAMES
from ema_record.checks.run import lint_bag
from ema_record.errors import ModelError, UsageError
from ema_record.kit import ACTUATOR, is_default_kit, kit_folder, shipped_kit, using_kit
from ema_record.spread import load_spread
from support.simulations import make_kit, record_of, second_kit


def named(record, name):
    return replace(record, provenance=replace(record.provenance, actuator=name))


@pytest.fixture(scope="module")
def second(tmp_path_factory):
    return second_kit(tmp_path_factory.mktemp("kit") / "second", cascade=False)


def test_the_hash_is_that_of_the_parameters_alone(tmp_path, second):
    default = actuator_hash()
    assert len(default) == 16 and int(default, 16) >= 0
    with using_kit(make_kit(tmp_path / "other spread", {"tolerances": {"inertia": 0.2}})):
        assert actuator_hash() == default and not is_default_kit()
    with using_kit(make_kit(tmp_path / "other gear", {"gear": {"ratio": 501.0}})):
        assert actuator_hash() != default
    with using_kit(second):
        assert actuator_hash() != default
    assert actuator_hash() == default and is_default_kit()
    with using_kit(shipped_kit()):
        assert is_default_kit()


def test_former_descriptions_count_too(second):
    """A description that is corrected after records were taken with it."""
    default, file = actuator_hash(), second / ACTUATOR
    with using_kit(second):
        assert is_of_another_actuator(default) and not is_of_another_actuator("")
    text = file.read_text(encoding="utf-8")
    try:
        file.write_text(text + f"\nformerly: ['{default}']\n", encoding="utf-8")
        with using_kit(second):
            assert actuator_hashes() == (actuator_hash(), default)
            assert not is_of_another_actuator(default)
            assert is_of_another_actuator("0123456789abcdef")
        file.write_text(text + "\nformerly: 12\n", encoding="utf-8")
        with using_kit(second), pytest.raises(UsageError, match="formerly: expected a list"):
            actuator_hashes()
    finally:
        file.write_text(text, encoding="utf-8")


def test_a_record_of_another_actuator_has_one_reason(tmp_path, second):
    with using_kit(second):
        other = actuator_hash()
    record = named(record_of("step", seed=3), other)
    judged = Judge().of_record(record, "the bag")
    assert judged.verdict.outcome == "invalid"
    (reason,) = judged.verdict.reasons
    assert other in reason and actuator_hash() in reason and "--kit" in reason
    (finding,) = lint_bag(write_bag(record, tmp_path / "bag")).findings
    assert finding.rule == "other_actuator" and "the default kit" in finding.message
    own = Judge().of_record(named(record, actuator_hash()), "the bag").verdict
    unnamed = Judge().of_record(named(record, ""), "the bag").verdict
    assert own == unnamed and own.outcome != "invalid"


def test_a_kit_without_networks_says_so(second):
    with using_kit(second), pytest.raises(ModelError) as caught:
        Judge()
    assert str(second) in str(caught.value) and "ema commission" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_papers_networks_are_the_default_actuators(second):
    with using_kit(second), pytest.raises(UsageError, match="of the default actuator alone"):
        Judge(mode="paper")


def test_every_parameter_stands_in_a_kit(tmp_path):
    kit = make_kit(tmp_path / "kit", {})
    data = yaml.safe_load((kit / ACTUATOR).read_text(encoding="utf-8"))
    del data["gear"]["ratio"]
    (kit / ACTUATOR).write_text(yaml.safe_dump(data), encoding="utf-8")
    with using_kit(kit), pytest.raises(UsageError, match=r"gear\.ratio is missing"):
        actuator_hash()


@pytest.mark.parametrize(("change", "problem"), [
    (lambda data: data | {"tolerence": data.pop("tolerances")}, "did you mean 'tolerances'"),
    (lambda data: data | {"gear": 300}, "gear: expected parameters and values"),
    (lambda data: data | {"gear": {**data["gear"], "ratio": True}}, "ratio: .* valid number"),
    (lambda data: data | {"gear": {**data["gear"], "ratio": "300"}}, "ratio: .* valid number"),
    (lambda data: data | {"motor": {**data["motor"], "pole_pairs": True}}, "valid integer"),
])
def test_a_section_of_a_kit_that_nothing_reads_or_no_number_is_refused(tmp_path, change, problem):
    """Else the bands that it was meant to give would be those of the software."""
    kit = make_kit(tmp_path / "kit", {})
    data = change(yaml.safe_load((kit / ACTUATOR).read_text(encoding="utf-8")))
    (kit / ACTUATOR).write_text(yaml.safe_dump(data), encoding="utf-8")
    with using_kit(kit), pytest.raises(UsageError, match=problem) as caught:
        load_actuator()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("section", "name", "value", "problem"), [
    ("motor", "pole_pairs", 0, "must be greater than or equal to 1"),
    ("gear", "efficiency", 1.01, "must be less than or equal to 1"),
    ("gear", "rattio", 300.0, "did you mean 'ratio'"),
    ("gear", "ratio", float("nan"), "ratio: "), ("gear", "ratio", float("inf"), "ratio: "),
    ("drive", "kind", 4, "must be less than 4"), ("drive", "kind", -1, "must be greater"),
    ("drive", "kind", "rely", "'rely' is none of relay"),
    ("drive", "kind", True, "'True' is none of relay"),
    ("acquisition", "converters", 2, "converters: "),
    ("acquisition", "converters", -1, "converters: "),
])
def test_a_value_that_no_actuator_has_is_refused(section, name, value, problem):
    with pytest.raises(UsageError, match=problem):
        actuator_from({section: {name: value}}, "here")


@pytest.fixture
def spread_of(tmp_path):
    """Return the spread of a kit that is described alone, with one section changed."""
    def load(name, change):
        data = yaml.safe_load((shipped_kit() / ACTUATOR).read_text(encoding="utf-8"))
        data[name] = {**data[name], **change}
        (tmp_path / ACTUATOR).write_text(yaml.safe_dump(data), encoding="utf-8")
        with using_kit(tmp_path):
            return load_spread()
    return load


@pytest.mark.parametrize(("name", "change", "problem"), [
    ("conditions", {"temperature_least": 30.0, "temperature_most": 20.0}, "temperature_least 30"),
    ("conditions", {"noise_least": 2.0, "noise_most": 1.0}, "noise_least 2 is above noise_most 1"),
    ("conditions", {"buss": 0.1}, "did you mean 'bus'"),
    ("tolerances", {"viscous_factor": 0.9}, "viscous_factor: must be greater"),
    ("tolerances", {"inertia": 0.51}, "inertia: must be less"),
])
def test_a_spread_that_no_type_has_is_refused(spread_of, name, change, problem):
    with pytest.raises(UsageError, match=problem):
        spread_of(name, change)


def test_a_condition_may_be_one_value(spread_of):
    found = spread_of("conditions", {"temperature_least": 20.0, "temperature_most": 20.0})
    assert found.conditions.temperature_least == found.conditions.temperature_most == 20.0


@pytest.mark.parametrize(("change", "lacks"), [
    ({"phase_current_c": False}, "phase_current_c"), ({"rotor_angle": False}, "rotor_angle"),
    ({"surface_position": False}, "surface_position")])
def test_what_a_kit_does_not_record_is_that_channel(change, lacks):
    columns = actuator_from({"acquisition": change}, "here").acquisition.columns
    assert [n for k, n in enumerate(CHANNEL_NAMES) if k not in columns] == [lacks]


def test_the_noise_of_a_sample_is_less_on_a_longer_mean_and_whole_in_an_instant():
    """A control that reads at 10 kHz gives its noise to a record at any rate above."""
    noise = {"speed": 2.0, "current": 0.1, "position": 3e-5}
    known = {"control": {"period": 1e-4}, "noise": noise}
    for sampling, rate, inside, current in (
            ("mean", 5_000.0, 0.5, 0.05), ("mean", 80_000.0, 0.5**0.5, 0.2),
            ("instant", 5_000.0, 0.5**0.5, 0.1), ("instant", 80_000.0, 0.5**0.5, 0.1)):
        found = actuator_from({**known, "acquisition": {"sampling": sampling}}, "here")
        assert found.sample_noise(rate) == pytest.approx((2.0 * inside, current, 3e-5 * inside))


def test_torque_and_travel_of_the_motor_before_the_surface_moves():
    found = actuator_from({
        "motor": {"dynamic_friction": 0.02}, "gear": {"ratio": 200.0},
        "surface": {"dynamic_friction": 4.0, "static_friction": 6.0},
        "shaft": {"stiffness": 1e4, "backlash": 4e-4}}, "here")
    assert found.friction_torque == pytest.approx(0.04)
    assert found.wind_up == pytest.approx(200.0 * (6e-4 + 4e-4))


def test_the_next_command_uses_the_kit_and_the_baseline(second, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    verdict = {"bag": "a bag", "verdict": "healthy"}
    assert next_commands(verdict, {}) == ["ema report 'a bag' --out a_bag.html"]
    with using_kit(second):
        (line,) = next_commands(verdict, {"given": " --baseline b"})
    assert line.startswith("ema report 'a bag' --kit ") and "--baseline b --out" in line


def test_any_reader_of_yaml_takes_the_shipped_numbers_for_numbers():
    """By version 1.1 of YAML, which most read, 1e5 is a text: its exponent needs a sign."""
    def texts(value):
        if isinstance(value, dict):
            return [t for v in value.values() for t in texts(v)]
        return [value] if isinstance(value, str) else []

    data = yaml.safe_load((shipped_kit() / ACTUATOR).read_text(encoding="utf-8"))
    assert [t for t in texts(data) if any(c.isdigit() for c in t)] == []
    assert data["shaft"]["stiffness"] == load_actuator().shaft.stiffness


def test_kits_of_two_threads_do_not_mix(second, monkeypatch):
    """A process has one kit at a time; none stays when all blocks have ended, in any order."""
    monkeypatch.delenv("EMA_KIT", raising=False)
    entered, leave, found = threading.Event(), threading.Event(), []

    def other():
        with using_kit(second):
            entered.set()
            leave.wait(10.0)
            found.append(kit_folder())

    thread = threading.Thread(target=other)
    thread.start()
    assert entered.wait(10.0)
    with pytest.raises(UsageError, match="another thread works with another kit"), using_kit(None):
        pass
    with using_kit(second):
        leave.set()
        thread.join()
        assert kit_folder() == found[0] == second.resolve()
    assert "EMA_KIT" not in os.environ
    with using_kit(second), using_kit(None):
        assert kit_folder() == shipped_kit()
    assert "EMA_KIT" not in os.environ


WORKERS = """
import os, time
from joblib import Parallel, delayed
from ema_record.kit import with_present_kit

def work(seconds):
    print(os.getpid(), flush=True)
    time.sleep(seconds)

Parallel(n_jobs=2)(delayed(with_present_kit(work))(300) for _ in range(2))
"""


@pytest.mark.slow
def test_workers_end_with_a_parent_that_was_killed():
    with subprocess.Popen([sys.executable, "-c", WORKERS], stdout=subprocess.PIPE) as parent:
        workers = [int(parent.stdout.readline()) for _ in range(2)]
        parent.kill()
    end = time.monotonic() + 20.0
    while alive := [pid for pid in workers if Path(f"/proc/{pid}").exists()]:
        assert time.monotonic() < end, f"{alive} still run"
        time.sleep(0.2)
