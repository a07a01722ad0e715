"""What is hidden: repeatable, in every round alike, sealed, silent."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blind_panel.tasks import MEASURED, Task, read_tasks, write_tasks
from benchmarks.blind_panel.truth.answers import Panel, drawn
from benchmarks.blind_panel.truth.bags import make_bags
from benchmarks.blind_panel.truth.hidden import HARD_TO_TELL
from benchmarks.blind_panel.truth.prepare import opened
from benchmarks.blind_panel.truth.seal import ANSWERS, KEY, parts, seal, unseal
from benchmarks.blind_panel.truth.units import STRATA
from benchmarks.blind_panel.truth.views import segments, view
from ema_record.bag.read import read_bag
from ema_record.errors import InvalidRecordError
from ema_record.profile import Profile, load_profile
from ema_sim.effects import EFFECTS, parse_effects
from ema_sim.simulate import simulate

PANEL = Panel(7, ("step",), {stratum: 3 * stratum.endswith("nothing") + 3 for stratum in STRATA})


def answers_of(panel):
    return [drawn(panel, *unit) for units in panel.rounds() for unit in units]


@pytest.fixture(scope="module")
def answers():
    return answers_of(PANEL)


def test_every_round_has_all_strata_in_their_shares():
    rounds = PANEL.rounds()
    assert len(rounds) == 3
    for number, units in enumerate(rounds):
        for stratum in STRATA:
            first, count = ((2 * number, 2) if stratum.endswith("nothing") else (number, 1))
            assert [k for of, k in units if of == stratum] == [*range(first, first + count)]
    assert sum(map(len, Panel(1, (), {"a": 30, "b": 8}).rounds()), 0) == 38


def test_same_seed_same_answers_under_other_names(answers):
    again = answers_of(PANEL)
    assert [replace(a, id="") for a in again] == [replace(a, id="") for a in answers]
    assert len({a.id for a in (*answers, *again)}) == 2 * len(answers)
    other = answers_of(PANEL._replace(seed=8))
    assert [a.truth for a in other] != [a.truth for a in answers]


@pytest.mark.slow
@pytest.mark.parametrize("stratum", ["own, accepted, then one effect", "second, two effects",
                                     "own, outside the catalogue", "foc, second, one effect"])
def test_what_is_drawn_is_what_the_unit_with_its_records_has(answers, stratum):
    answer = next(a for a in answers if a.stratum == stratum)
    unit = answer.unit()
    assert (unit.names, unit.without, unit.truth) == (answer.names, answer.without, answer.truth)
    assert len(unit.records) == 1 and len(unit.accepted) == answer.accepted
    with pytest.raises(InvalidRecordError, match="otherwise than when it was sealed"):
        replace(answer, names=("turn_short",), truth={}).unit()


def test_all_that_is_hidden_is_of_the_catalogue(answers):
    for answer in answers:
        effects = parse_effects([f"{name}={value}" for name, value in answer.truth.items()])
        for name in answer.names:
            assert not EFFECTS[name].is_neutral(getattr(effects, name)), answer
        count = 0 if answer.stratum.endswith("nothing") else 1 + ("two effects" in answer.stratum)
        assert len(answer.names) == count


def test_pairs_are_not_of_one_family_and_strangers_hide_themselves(answers):
    for answer in answers:
        assert not any(len(set(answer.names) & family) > 1 for family in HARD_TO_TELL)
        assert bool(answer.without) == answer.stratum.endswith("outside the catalogue")
        assert not answer.without or set(answer.names) <= set(answer.without)


def test_seal_opens_to_the_same_answers_and_hides_them(answers, tmp_path):
    part = seal(answers[:40], tmp_path)
    assert len((part / "commitment.txt").read_text(encoding="utf-8").strip()) == 64
    assert unseal(part) == answers[:40]
    stored = (part / ANSWERS).read_bytes()
    assert not [name for name in (*EFFECTS, *STRATA) if name.encode() in stored]
    damaged = bytearray(stored)
    damaged[1000] ^= 1
    (part / ANSWERS).write_bytes(damaged)
    with pytest.raises(InvalidRecordError, match="not what was committed to"):
        unseal(part)


def test_answers_or_a_key_that_are_gone_are_told(answers, tmp_path):
    for name in (ANSWERS, KEY):
        part = seal(answers[:2], tmp_path / name)
        (part / name).unlink()
        with pytest.raises(InvalidRecordError, match=f"{name}: No such file"):
            unseal(part)


def test_more_units_are_a_further_part_and_each_is_found_in_its_round(tmp_path):
    few = PANEL._replace(counts={"own, one effect": 1})
    more = few._replace(counts={"own, one effect": 2, "own, nothing": 2})
    first = answers_of(few)
    seal(first, tmp_path / "sealed")
    second = [a for a in answers_of(more) if (a.stratum, a.k) != ("own, one effect", 0)]
    seal(second, tmp_path / "sealed")
    assert [part.name for part in parts(tmp_path / "sealed")] == ["1", "2"]
    assert opened(tmp_path, few) == [first]
    assert [[(a.stratum, a.k) for a in found] for found in opened(tmp_path, more)] == more.rounds()
    assert opened(tmp_path, more._replace(seed=8)) == [[], []]


def test_tasks_are_read_as_they_were_written_last(tmp_path):
    tasks = [Task(id="b", tests=("step",), without=("backlash",)), Task(id="a", tests=("step",))]
    for listed in (tasks[:1], tasks):
        write_tasks(listed, tmp_path)
        assert read_tasks(tmp_path) == listed


GUARD = """
import json, os, sys
import numpy as np
from pathlib import Path
from benchmarks.blind_panel.guard import lock
import benchmarks.blind_panel.run
sealed, free = Path(sys.argv[1]), Path(sys.argv[2])
lock(sealed)
def refused(action):
    try:
        action()
    except (PermissionError, ImportError) as error:
        return "sealed" in str(error) or "closed" in str(error)
    return False
def bring():
    import benchmarks.blind_panel.truth.answers
print(json.dumps({
    "open": refused(lambda: open(sealed / "answers.sealed", "rb")),
    "relative": refused(lambda: open(os.path.relpath(sealed / "answers.sealed"), "rb")),
    "link": refused(lambda: open(free / "link", "rb")),
    "numpy": refused(lambda: np.fromfile(sealed / "answers.sealed")),
    "list": refused(lambda: os.listdir(sealed)),
    "import": refused(bring),
    "others stay open": (free / "note").read_text() == "mine",
}))
"""


@pytest.mark.slow
def test_the_identifying_process_cannot_read_the_answers(answers, tmp_path, repository):
    sealed, free = tmp_path / "sealed", tmp_path / "free"
    part = seal(answers[:3], sealed)
    free.mkdir()
    (free / "note").write_text("mine", encoding="utf-8")
    (free / "link").symlink_to(part / ANSWERS)
    for place in (part, sealed):
        done = subprocess.run(
            [sys.executable, "-c", GUARD, str(place), str(free)], cwd=repository,
            capture_output=True, text=True, check=True)
        assert json.loads(done.stdout) == dict.fromkeys(
            ["open", "relative", "link", "numpy", "list", "import", "others stay open"], True)


def test_a_process_that_knows_the_truth_is_not_to_identify(tmp_path, repository):
    program = ("import benchmarks.blind_panel.truth.answers\n"
               "from pathlib import Path\n"
               "from benchmarks.blind_panel.guard import lock\n"
               f"lock(Path({str(tmp_path)!r}))")
    done = subprocess.run([sys.executable, "-c", program], cwd=repository, capture_output=True,
                          text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("ImportError: this process has imported the")


@pytest.mark.slow
@pytest.mark.parametrize("stratum", ["own, accepted, then one effect", "second, one effect",
                                     "pwm, second, one effect"])
def test_a_bag_tells_nothing(answers, tmp_path, stratum):
    answer = next(a for a in answers if a.stratum == stratum)
    make_bags(answer, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [answer.id]
    unit = answer.unit()
    bags = sorted((tmp_path / answer.id).iterdir())
    assert [bag.name for bag in bags] == ["accepted_1"] * answer.accepted + [MEASURED]
    record = read_bag(bags[-1])
    assert np.array_equal(record.samples, unit.records[0].samples, equal_nan=True)
    assert record.profile == unit.records[0].profile
    assert record.provenance.serial_number == f"UNIT-{answer.id}"
    content = b"".join(path.read_bytes() for bag in bags for path in bag.iterdir())
    secrets = {*EFFECTS, "simulator", unit.records[0].provenance.serial_number}
    secrets -= {"winding_temperature"}  # which is a topic, too
    assert not [name for name in secrets if name.encode() in content]


def test_a_line_and_a_course_show_where_an_effect_is():
    hidden = parse_effects(["cogging_torque.amplitude=0.05", "cogging_torque.periods=9"])
    profile = load_profile("step")
    bare, with_it = (view(simulate(profile, effects=e, seed=11)) for e in (None, hidden))
    change = {order: np.hypot(*(with_it[f"segment 0: torque current, line {order}"]
                                - bare[f"segment 0: torque current, line {order}"]))
              for order in range(1, 31)}
    assert max(change, key=change.get) == 9
    # At the full slew speed the torque control is too slow to cancel it: some of it stays.
    assert 0.02 < change[9] < 2.0 * 0.05 / (2 * 0.0376)


def test_segments_follow_the_command():
    reversal = Profile(name="reversal", points=(
        (0.0, 0.3), (0.022, 0.3), (0.022, -0.1), (0.36, -0.1), (0.36, 0.0), (0.86, 0.1),
        (1.01, 0.1), (1.41, 0.02)))
    assert segments(load_profile("step")) == [(0.02, 0.45)]
    assert [round(end, 2) for _, end in segments(reversal)] == [0.36, 0.86, 1.01, 1.41]
