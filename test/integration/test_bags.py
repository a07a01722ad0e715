"""The example bags: small, conforming, silent about what they hide, and diagnosed."""

import importlib.util
import json
import re
import shlex

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from ema_cli.main import run
from ema_identification.identify import identify
from ema_record.bag.read import read_bag
from ema_record.checks.live import Level, check_record
from ema_record.kit import share_path
from ema_record.profile import load_profile
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate

BAGS = share_path("bags")
MAX_BYTES = 11_000_000
EXPECTED = {
    "SIM-0000": "healthy", "SIM-0001": "turn_short", "SIM-0002": "rotor_eccentricity",
    "SIM-0003": "friction", "SIM-0004": "backlash",
}
PROFILES = ("step", "extended")
DIAGNOSED = [f"sim_{n:04d}_{profile}" for n in range(5) for profile in PROFILES]
NAMES = DIAGNOSED + [f"sim_0005_{profile}" for profile in PROFILES]  # for `ema identify`


@pytest.fixture(scope="module")
def make():
    """Return the script that makes the bags, as a module."""
    spec = importlib.util.spec_from_file_location("make_bags", BAGS / "make.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def verdicts():
    """Return the verdict of `ema check --json` on each bag, by its name."""
    import contextlib
    import io

    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        run(["check", "--json", *(str(BAGS / name) for name in DIAGNOSED)])
    objects = [json.loads(line) for line in printed.getvalue().splitlines()]
    assert [found["bag"] for found in objects] == [str(BAGS / name) for name in DIAGNOSED]
    return dict(zip(DIAGNOSED, objects))


def test_all_are_there_and_small(make):
    folders = sorted(path.name for path in BAGS.iterdir() if (path / "metadata.yaml").is_file())
    assert folders == sorted(NAMES) == sorted(make.commands())
    total = sum(file.stat().st_size for file in BAGS.rglob("*") if file.is_file())
    assert total < MAX_BYTES


def test_readme_says_how_each_was_made(make):
    told = dict(re.findall(r"^\| `(\w+)` \|.*\| `(ema .*)` \|$",
                           (BAGS / "README.md").read_text(encoding="utf-8"), re.MULTILINE))
    assert told == {name: shlex.join(["ema", *args]) for name, args in make.commands().items()}


def test_no_bag_tells_what_is_hidden(make):
    effects = {setting.partition(".")[0] for hidden in make.HIDDEN.values() for setting in hidden}
    effects -= {"winding_temperature"}  # a topic, too
    words = [word.encode() for word in effects | set(make.HIDDEN)] + [b"eccentric", b"turn_"]
    for name in NAMES:
        with AnyReader([BAGS / name]) as reader:
            texts = [raw for _, _, raw in reader.messages()]
        texts += [file.read_bytes() for file in (BAGS / name).iterdir()]
        assert not [word for word in words if any(word in text for text in texts)], name


@pytest.mark.parametrize("name", NAMES)
def test_each_is_a_good_record(name):
    record = read_bag(BAGS / name)
    assert record.provenance.status == "complete"
    assert record.provenance.serial_number == name[:8].upper().replace("_", "-")
    profile = load_profile(record.profile.name)
    assert record.profile.points == profile.points
    assert len(record) == round(profile.duration * 20_000.0)
    worst = max(check_record(record), key=lambda check: check.level)
    if EXPECTED.get(record.provenance.serial_number) == "healthy":
        assert worst.level == Level.OK, worst
    else:
        assert worst.level <= Level.WARN, worst


def test_the_commands_still_make_them(make):
    """The relay is chaotic: the same means, not the same waveforms after any change of it."""
    for seed, effects in enumerate(make.HIDDEN.values()):
        stored = read_bag(BAGS / make.bag_name(seed, "step"))
        anew = simulate(load_profile("step"), effects=parse_effects(effects), seed=seed)
        slew = (stored.time > 0.1) & (stored.time < 0.38)
        for channel, tolerance in (("motor_speed", 0.002), ("surface_position", 0.002)):
            assert stored.channel(channel)[slew].mean() == pytest.approx(
                anew.channel(channel)[slew].mean(), rel=tolerance, abs=2e-4
            )
        power = [np.sum(r.samples[slew, 2:5] ** 2, axis=1).mean() for r in (stored, anew)]
        assert power[0] == pytest.approx(power[1], rel=0.01)


@pytest.mark.parametrize("name", DIAGNOSED)
def test_each_is_diagnosed(name, verdicts):
    """A fault is never called healthy, and no other fault; the electrical ones are named."""
    found = verdicts[name]
    expected = EXPECTED[read_bag(BAGS / name).provenance.serial_number]
    if expected == "healthy":
        assert found["verdict"] == "healthy"
    elif expected in ("turn_short", "rotor_eccentricity"):
        assert (found["verdict"], found["fault_class"]) == ("fault", expected)
    else:
        assert found["verdict"] in ("fault", "unknown")
        if found["verdict"] == "fault":
            assert found["fault_class"] == expected
    if expected == "turn_short":
        assert found["phase"] == "b"
        lower, upper = found["severity_interval"]
        assert lower <= 0.1 <= upper
        assert found["severity"] == pytest.approx(0.1, abs=0.01)


def test_statuses_of_single_bags(verdicts, capsys):
    for name in ("sim_0000_step", "sim_0001_step"):
        expected = {"healthy": 0, "fault": 1, "unknown": 3}[verdicts[name]["verdict"]]
        assert run(["check", str(BAGS / name)]) == expected
    capsys.readouterr()


@pytest.mark.slow
def test_the_worked_example_of_identify():
    found = identify([read_bag(BAGS / "sim_0005_extended")])
    assert (found.verdict, found.findings[0].effect) == ("explained", "stribeck_friction")
    assert found.gap_after < 0.5 * found.gap_before
    increase, speed = found.findings[0].parameters
    assert increase.low <= 0.8 <= increase.high and increase.low > 0.0
    assert speed.low <= 12.0 <= speed.high
