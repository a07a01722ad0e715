"""What is replayed of a bag, in which order and when."""

import json
from dataclasses import replace

import numpy as np
import pytest

from ema_cli.main import run
from ema_record.bag.read import write_bag
from ema_record.errors import IncompleteRecordError, InvalidRecordError
from ema_record.profile import load_profile
from ema_record.wire.samples import decode_block
from ema_record.wire.topics import COMMAND, SAMPLES, WEIGHT_ON_WHEELS
from ema_record.wire.trajectory import decode_command
from ema_ros.replay_bag import load_messages
from ema_sim.simulate import simulate


def test_all_samples_in_order_after_the_command_and_no_wheels(tmp_path):
    record = simulate(load_profile("step"), seed=2, start_time=10**18)
    messages = load_messages(write_bag(record, tmp_path / "bag"))
    topics = [message.topic for message in messages]
    assert WEIGHT_ON_WHEELS not in topics
    assert topics.count(COMMAND) == 1
    assert topics.index(COMMAND) < topics.index(SAMPLES)
    times = [message.time for message in messages]
    assert times == sorted(times)
    assert times[0] == 0.0
    assert times[-1] == pytest.approx(0.45, abs=1e-3)
    blocks = [decode_block(m.data) for m in messages if m.topic == SAMPLES]
    assert np.array_equal(np.concatenate(blocks), record.samples)
    command = next(m.data for m in messages if m.topic == COMMAND)
    assert decode_command(command).points == record.profile.points


def test_several_bags_are_a_line_each_and_the_worst_status(tmp_path, monkeypatch, capsys):
    played = []
    monkeypatch.setattr("ema_ros.domain.use_fast_discovery", lambda domain: None)
    monkeypatch.setattr("ema_ros.replay_node.play", lambda messages, **_: (
        played.append(len(messages)) or {SAMPLES: len(messages) - 1, COMMAND: 1}))
    record = simulate(load_profile("step"), seed=2)
    bags = [write_bag(record, tmp_path / name) for name in "abc"]
    (bags[1] / "metadata.yaml").unlink()
    assert run(["replay", *map(str, bags)]) == 3
    printed = capsys.readouterr()
    assert printed.out.splitlines() == [
        f"{bag}: {played[0]} messages on 2 topics" for bag in (bags[0], bags[2])]
    assert printed.err.count("\n") == 1 and str(bags[1]) in printed.err
    assert run(["replay", str(bags[0]), str(tmp_path / "no"), "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["messages"][COMMAND] == 1


def test_a_cut_bag_is_refused(tmp_path):
    bag = write_bag(simulate(load_profile("step")), tmp_path / "bag")
    (bag / "metadata.yaml").unlink()
    with pytest.raises(IncompleteRecordError):
        load_messages(bag)
    with pytest.raises(InvalidRecordError):
        load_messages(tmp_path / "nothing")


@pytest.mark.parametrize(("said", "status", "words"), [
    ({"status": "interrupted"}, 3, "interrupted, not complete"),
    ({"actuator": "another"}, 2, "of the actuator 'another'"),
])
def test_what_forbids_a_verdict_and_the_topics_do_not_say_is_refused(
    tmp_path, monkeypatch, capsys, said, status, words,
):
    played = []
    monkeypatch.setattr("ema_ros.domain.use_fast_discovery", lambda domain: None)
    monkeypatch.setattr("ema_ros.replay_node.play", lambda messages, **_: (
        played.append(len(messages)) or {SAMPLES: 1}))
    record = simulate(load_profile("step"), seed=2)
    bag = str(write_bag(replace(record, provenance=replace(record.provenance, **said)),
                        tmp_path / "bag"))
    assert run(["replay", bag]) == status
    printed = capsys.readouterr()
    assert words in printed.err and "--anyway" in printed.err and printed.err.count("\n") == 1
    assert played == []
    assert run(["replay", bag, "--anyway"]) == 0
    assert len(played) == 1


def test_a_rate_at_which_the_samples_would_count_as_over_is_refused(tmp_path, capsys):
    bag = write_bag(simulate(load_profile("step"), seed=2), tmp_path / "bag")
    assert run(["replay", str(bag), "--rate", "0.01"]) == 2
    said = capsys.readouterr().err
    assert "s apart" in said and "at least 0.0" in said and said.count("\n") == 1
