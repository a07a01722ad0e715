"""The truth program: balanced, repeatable, sealed, silent."""

import collections
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blind_panel.tasks import Task, read_tasks, share, write_tasks
from benchmarks.blind_panel.truth.bags import REVERSAL, record_of, truth_of
from benchmarks.blind_panel.truth.cases import draw_cases
from benchmarks.blind_panel.truth.foreign import FOREIGN, foreign_actuator, foreign_record
from benchmarks.blind_panel.truth.hidden import HARD_TO_TELL, HIDEABLE
from benchmarks.blind_panel.truth.seal import ANSWERS, seal, unseal
from benchmarks.blind_panel.truth.views import segments, view
from ema_record.actuator import load_actuator
from ema_record.bag.read import write_bag
from ema_record.errors import InvalidRecordError
from ema_record.profile import load_profile
from ema_sim.effects import EFFECTS, parse_effects
from ema_sim.simulate import simulate


@pytest.fixture(scope="module")
def cases():
    return draw_cases(7)


def test_numbers_of_the_issue(cases):
    groups = collections.Counter(case.group for case in cases)
    assert groups["nothing"] == 200
    assert groups["stranger"] == 60
    assert groups["pair"] == 60
    singles = collections.Counter((c.names[0], c.size) for c in cases if c.group == "effect")
    assert len(HIDEABLE) >= 16
    assert set(singles.values()) == {5}
    assert len(singles) == 3 * len(HIDEABLE)
    assert sum(bool(c.foreign) for c in cases) == 20


@pytest.mark.parametrize("of", [4, 20])
def test_every_part_is_balanced(cases, of):
    for number in range(1, of + 1):
        part = share(cases, (number, of))
        groups = collections.Counter(case.group for case in part)
        for group, total in (("effect", 315), ("nothing", 200), ("pair", 60), ("stranger", 60)):
            assert abs(groups[group] - total / of) <= 1
        names = collections.Counter(c.names[0] for c in part if c.group == "effect")
        if of == 4:
            assert min(names[name] for name in HIDEABLE) >= 3


def test_same_seed_same_cases(cases):
    assert draw_cases(7) == cases
    assert [c.settings for c in draw_cases(8)] != [c.settings for c in cases]


def test_names_of_units_tell_nothing(cases):
    assert len({c.id for c in cases}) == len(cases)
    place = np.array([int(c.id[1:]) for c in cases], dtype=float)
    group = np.array([c.group == "nothing" for c in cases], dtype=float)
    assert abs(np.corrcoef(place, group)[0, 1]) < 0.12


def test_all_settings_are_within_the_catalogue(cases):
    for case in cases:
        actuator, effects = truth_of(case)
        for name in case.names:
            assert not EFFECTS[name].is_neutral(getattr(effects, name)), case
        assert 0.9 <= actuator.motor.inertia / 1.5e-5 <= 1.1


def test_pairs_are_not_of_one_family_and_strangers_hide_themselves(cases):
    for case in cases:
        if case.group == "pair":
            assert not any(set(case.names) <= family for family in HARD_TO_TELL)
        if case.group == "stranger":
            assert bool(case.foreign) != bool(case.names)
            assert set(case.names) <= set(case.without)


def test_foreign_changes_change_the_actuator_or_the_record():
    nominal = load_actuator()
    record = simulate(load_profile("step"), seed=3)
    for kind in FOREIGN:
        moved = foreign_actuator(kind, nominal) != nominal
        spoilt = not np.array_equal(foreign_record(kind, record).samples, record.samples)
        assert moved != spoilt, kind


def test_seal_opens_to_the_same_cases_and_hides_them(cases, tmp_path):
    commitment = seal(cases[:40], tmp_path / "sealed")
    assert len(commitment) == 64
    assert unseal(tmp_path / "sealed") == cases[:40]
    stored = (tmp_path / "sealed" / ANSWERS).read_bytes()
    assert not [name for name in EFFECTS if name.encode() in stored]
    damaged = bytearray(stored)
    damaged[1000] ^= 1
    (tmp_path / "sealed" / ANSWERS).chmod(0o600)
    (tmp_path / "sealed" / ANSWERS).write_bytes(damaged)
    with pytest.raises(InvalidRecordError, match="not what was committed to"):
        unseal(tmp_path / "sealed")


def test_tasks_keep_the_parts_and_lose_the_order(tmp_path):
    tasks = [Task(id=f"r{(37 * n) % 100:04d}", without=("backlash",) if n == 3 else ())
             for n in range(100)]
    write_tasks(tasks, tmp_path)
    found = read_tasks(tmp_path)
    for part in ((1, 4), (3, 5), (20, 20)):
        assert set(share(found, part)) == set(share(tasks, part))
    assert [t.id for t in found[:5]] == sorted(t.id for t in tasks[:5])


GUARD = """
import json, os, sys
import numpy as np
from pathlib import Path
from benchmarks.blind_panel.guard import lock
sealed, free = Path(sys.argv[1]), Path(sys.argv[2])
lock(sealed)
def refused(action):
    try:
        action()
    except (PermissionError, ImportError) as error:
        return "sealed" in str(error) or "closed" in str(error)
    return False
def bring():
    import benchmarks.blind_panel.truth.cases
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


def test_the_identifying_process_cannot_read_the_answers(cases, tmp_path, repository):
    sealed, free = tmp_path / "sealed", tmp_path / "free"
    seal(cases[:3], sealed)
    free.mkdir()
    (free / "note").write_text("mine", encoding="utf-8")
    (free / "link").symlink_to(sealed / ANSWERS)
    done = subprocess.run([sys.executable, "-c", GUARD, str(sealed), str(free)], cwd=repository,
                          capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == dict.fromkeys(
        ["open", "relative", "link", "numpy", "list", "import", "others stay open"], True)


@pytest.mark.slow
def test_a_bag_tells_nothing(cases, tmp_path):
    case = next(c for c in cases if c.group == "effect")
    record = record_of(case, load_profile("step"), "validate")
    assert record.provenance.serial_number == f"UNIT-{case.id[1:]}"
    assert np.array_equal(record.samples,
                          record_of(case, load_profile("step"), "validate").samples)
    bag = write_bag(record, tmp_path / "bag", views=False)
    content = b"".join(path.read_bytes() for path in bag.iterdir())
    names = set(EFFECTS) - {"winding_temperature"}  # which is a topic, too
    assert not [name for name in names if name.encode() in content]


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
    assert segments(load_profile("step")) == [(0.02, 0.45)]
    assert [round(end, 2) for _, end in segments(REVERSAL)] == [0.36, 0.86, 1.01, 1.41]


def test_settings_of_conditions_add_to_what_is_hidden(cases):
    case = next(c for c in cases if "surface_load.constant" in c.settings)
    _, effects = truth_of(case)
    own = case.unit.conditions["surface_load.constant"]
    assert effects.surface_load.constant == own + case.settings["surface_load.constant"]
    _, bare = truth_of(replace(case, settings={}))
    assert bare.surface_load.constant == own
