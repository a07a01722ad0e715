"""The sequence of the built-in test, against a simulated actuator that obeys or does not."""

from dataclasses import replace

import pytest

from ema_monitor.observation import ACTUATOR_TIMEOUT, ActuatorStatus, Observation
from ema_monitor.sequence import (
    CloseRecord,
    Finish,
    OpenRecord,
    SendCommand,
    Stage,
    TestSequence,
)
from ema_record.actuator import load_actuator
from ema_record.errors import UsageError
from ema_record.profile import load_profile, load_profile_dict, step_profile
from support.actuators import changed

STEP = load_profile("step")
ACTUATOR = load_actuator()
END_STOP = ACTUATOR.surface.end_stop
REST = ActuatorStatus(
    active=False, surface_position=0.1, command_stamp=0, start_time=0, samples_published=0
)
START = Observation(now=100.0, stamp=5_000, actuator=REST)


def kinds(actions):
    return [type(action) for action in actions]


class Bench:
    """An actuator that executes each command when told to."""

    def __init__(self, seen=START, actuator=ACTUATOR):
        self.sequence = TestSequence(STEP, actuator)
        self.seen = seen

    def start(self):
        return self.sequence.start(self.seen)

    def after(self, seconds, **changes):
        self.seen = replace(
            self.seen, now=self.seen.now + seconds, stamp=self.seen.stamp + round(seconds * 1e9),
            last_block=self.seen.now + seconds, **changes,
        )
        return self.sequence.step(self.seen)

    def executed(self, command, position, samples):
        """The actuator reports the end of a command, all of its samples have arrived."""
        return self.after(
            0.4, samples_received=samples, last_sample=samples / 20_000.0,
            actuator=ActuatorStatus(
                active=False, surface_position=position, command_stamp=command.stamp,
                start_time=command.stamp + 7, samples_published=samples,
            ),
        )

    def to_testing(self):
        (move,) = self.start()
        opened, test = self.executed(move, STEP.start, 3000)
        assert isinstance(opened, OpenRecord)
        self.seen = replace(self.seen, samples_received=0, last_sample=-1.0)
        return test


def test_moves_records_counts_and_finishes():
    bench = Bench()
    (move,) = bench.start()
    assert isinstance(move, SendCommand)
    assert move.profile.points[-1][1] == STEP.start
    assert bench.sequence.stage is Stage.POSITIONING
    assert bench.after(0.02) == []
    opened, test = bench.executed(move, STEP.start, 3000)
    assert (opened.profile, test.profile) == (STEP, STEP)
    assert opened.stamp == test.stamp > move.stamp
    bench.seen = replace(bench.seen, samples_received=0, last_sample=-1.0)
    assert bench.after(0.2, samples_received=4000, last_sample=0.2) == []
    closed, finished = bench.executed(test, 0.27, 9000)
    assert closed == CloseRecord("complete", test.stamp + 7, 9000)
    assert finished == Finish("")
    assert bench.sequence.stage is Stage.IDLE


def test_no_move_where_the_surface_is_at_the_start():
    bench = Bench(replace(START, actuator=replace(REST, surface_position=STEP.start)))
    assert kinds(bench.start()) == [OpenRecord, SendCommand]


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_surface_beside_the_start_is_moved_there_from_either_side(side):
    at = STEP.start + side * 0.1
    bench = Bench(replace(START, actuator=replace(REST, surface_position=at)))
    (move,) = bench.start()
    assert (move.profile.points[0][1], move.profile.points[-1][1]) == (at, STEP.start)


def test_waits_for_samples_that_are_under_way():
    bench = Bench()
    test = bench.to_testing()
    end = ActuatorStatus(active=False, surface_position=0.2, command_stamp=test.stamp,
                         start_time=1, samples_published=9000)
    assert bench.after(0.4, samples_received=8600, last_sample=0.43, actuator=end) == []
    assert bench.sequence.stage is Stage.COUNTING
    assert kinds(bench.after(0.1, samples_received=9000, last_sample=0.45)) == [
        CloseRecord, Finish]


def test_an_actuator_that_ends_early_aborts_the_test():
    bench = Bench()
    test = bench.to_testing()
    end = ActuatorStatus(active=False, surface_position=0.2, command_stamp=test.stamp,
                         start_time=1, samples_published=6000)
    closed, back = bench.after(0.3, samples_received=6000, last_sample=0.3, actuator=end)
    assert closed.status == "aborted"
    assert isinstance(back, SendCommand)
    (finish,) = bench.executed(back, REST.surface_position, 100)
    assert finish.reason == "aborted: the actuator ended the test at 0.300 s of 0.450 s"


@pytest.mark.parametrize(("rate", "early", "status"), [
    (20_000.0, 1.9e-3, "complete"), (20_000.0, 2.2e-3, "aborted"),
    (100.0, 0.019, "complete"), (100.0, 0.022, "aborted"),
])
def test_the_last_sample_may_come_two_ms_or_two_samples_before_the_end(rate, early, status):
    bench = Bench(actuator=changed(acquisition={"rate": rate}))
    test = bench.to_testing()
    end = ActuatorStatus(active=False, surface_position=0.2, command_stamp=test.stamp,
                         start_time=7, samples_published=40)
    closed, _ = bench.after(0.4, samples_received=40, actuator=end,
                            last_sample=STEP.duration - early)
    assert (closed.status, closed.start_time) == (status, 7), "time 0 is told of either"


def test_a_status_that_never_comes_ends_the_test_and_an_older_one_tells_nothing_of_it():
    """All samples are there; the actuator last spoke of the move before."""
    bench = Bench()
    bench.to_testing()
    assert bench.after(0.4, samples_received=9000, last_sample=STEP.duration) == []
    assert bench.after(4.9) == []
    assert bench.after(0.2) == [CloseRecord("complete", None, None), Finish("")]


def test_samples_that_never_arrive_are_reported_not_waited_for():
    bench = Bench()
    test = bench.to_testing()
    end = ActuatorStatus(active=False, surface_position=0.2, command_stamp=test.stamp,
                         start_time=1, samples_published=9000)
    bench.after(0.4, samples_received=8600, last_sample=0.43, actuator=end)
    closed, _ = bench.after(5.1)
    assert closed == CloseRecord("complete", 1, 9000)


def test_refused_without_interlock_or_while_running():
    bench = Bench(replace(START, interlock="no weight on wheels"))
    assert bench.start() == [Finish("refused: no weight on wheels")]
    bench = Bench()
    bench.start()
    assert bench.start() == [Finish("a test is running already: wait for its end")]


@pytest.mark.parametrize("change", [
    {"actuator": None}, {"missing": "0 nodes publish"},
    {"actuator": replace(REST, active=True)},
])
def test_refused_when_no_idle_actuator_appears(change):
    bench = Bench(replace(START, **change))
    assert bench.start() == []
    assert bench.after(9.9) == []
    (finish,) = bench.after(0.2)
    assert finish.reason.startswith("refused: ")
    assert bench.sequence.stage is Stage.IDLE


def test_an_actuator_that_is_busy_is_waited_for_without_samples():
    bench = Bench(replace(START, actuator=replace(REST, active=True)))
    assert bench.start() == []
    bench.seen = replace(bench.seen, now=bench.seen.now + 9.9)
    assert bench.sequence.step(bench.seen) == []
    bench.seen = replace(bench.seen, actuator=REST)
    assert kinds(bench.sequence.step(bench.seen)) == [SendCommand]


def silenced(bench):
    """Let the samples stop; return the actions."""
    bench.seen = replace(bench.seen, now=bench.seen.now + 5.1, samples_received=100)
    return bench.sequence.step(bench.seen)


def at_rest(bench, position):
    """The actuator reports that it has stopped by itself."""
    return bench.after(
        0.1, actuator=replace(REST, surface_position=position),
        actuator_heard=bench.seen.now + 0.1,
    )


@pytest.mark.parametrize(("cause", "reason"), [
    ({"interlock": "took off"}, "took off"), ({"abort": True}, "the test was asked to end"),
])
def test_an_open_interlock_and_an_abort_stop_the_surface_where_it_is(cause, reason):
    bench = Bench()
    bench.to_testing()
    closed, stop = bench.after(0.2, samples_received=100, last_position=-0.13, **cause)
    assert closed.status == "aborted"
    assert stop.profile.points == ((1e-3, -0.13),)
    assert bench.sequence.stage is Stage.STOPPING
    assert bench.after(0.1) == [], "it must wait until the surface is at rest"
    assert at_rest(bench, -0.13) == [Finish(f"aborted: {reason}")]


def test_the_next_test_after_a_stop_begins_with_a_ramp_from_there():
    bench = Bench()
    bench.to_testing()
    bench.after(0.2, interlock="took off", last_position=-0.13)
    at_rest(bench, -0.13)
    bench.seen = replace(bench.seen, interlock="")
    (move,) = bench.start()
    assert [p for _, p in move.profile.points] == [-0.13, -0.13, STEP.start, STEP.start]


@pytest.mark.parametrize("scale", [1.0, 1e-4])
def test_every_move_is_a_ramp_at_half_the_slew_speed_at_most_a_minute_long(scale):
    actuator = changed(control={"speed_limit": scale * ACTUATOR.control.speed_limit})
    (move,) = Bench(actuator=actuator).start()
    (_, a), (t0, b), (t1, c), (end, d) = move.profile.points
    assert (a, b, c, d) == (0.1, 0.1, STEP.start, STEP.start)
    speed = abs(c - b) / (t1 - t0)
    if scale == 1.0:
        assert speed == pytest.approx(0.5 * actuator.slew_speed)
    assert end <= 60.0


def test_a_stop_is_waited_for_two_seconds():
    bench = Bench()
    bench.to_testing()
    bench.after(0.2, interlock="took off")
    (finish,) = bench.after(2.1)
    assert finish.reason == "aborted: took off; the surface is not confirmed to be at rest"


def test_an_abort_with_the_interlock_closed_brings_the_surface_back():
    bench = Bench()
    bench.to_testing()
    closed, back = silenced(bench)
    assert closed.status == "aborted"
    assert back.profile.points[-1][1] == REST.surface_position
    assert bench.after(0.1) == [], "it must wait for the surface"
    status = replace(REST, command_stamp=back.stamp, samples_published=9000)
    (finish,) = bench.after(0.1, actuator=status)  # its samples stay out, as they did before
    assert finish.reason.startswith("aborted: no samples")
    assert "not confirmed" not in finish.reason


def test_what_the_actuator_complains_of_is_told_where_no_samples_come():
    bench = Bench()
    bench.to_testing()
    bench.seen = replace(bench.seen, actuator=replace(
        bench.seen.actuator, complaint="command refused: no weight on wheels"))
    _, back = silenced(bench)
    (finish,) = bench.executed(back, REST.surface_position, 9000)
    assert finish.reason == ("aborted: no samples for 5.1 s: the actuator reports "
                             "'command refused: no weight on wheels'")


LATER = replace(START, actuator=replace(REST, surface_position=STEP.start, captures=True))


def moving(bench, command, **changes):
    """Let the actuator report that it executes a command, and that no sample has come."""
    status = replace(bench.seen.actuator, active=True, command_stamp=command.stamp)
    return {"actuator": replace(status, **changes), "actuator_heard": bench.seen.now}


def long_test():
    """Return a bench whose actuator captures a test of 20 s, begun."""
    bench = Bench(LATER)
    bench.sequence = TestSequence(
        load_profile_dict({"name": "long", "points": [[0, -0.4], [20, 0.4]]}, "long"), ACTUATOR)
    _, command = bench.start()
    return bench, command


def later(bench, command, until, step=1.0):
    """Go on in time while the status comes and no sample does; return what is done then."""
    block, actions = bench.seen.last_block, []
    while not actions and bench.seen.now < START.now + until:
        bench.after(0.0, **moving(bench, command))
        bench.seen = replace(bench.seen, now=bench.seen.now + step, last_block=block)
        bench.seen = replace(bench.seen, actuator_heard=bench.seen.now)
        actions = bench.sequence.step(bench.seen)
    return actions


@pytest.mark.parametrize("seconds", [0.1, 25.0])
def test_samples_that_come_after_the_move_are_waited_for_and_counted(seconds):
    """Uploaded within 0.1 s, and slower than they were taken, with pauses."""
    bench, command = long_test()
    assert later(bench, command, 22.0) == []
    for part in range(1, 11):
        count = 40_000 * part
        assert bench.after(seconds / 10.0, samples_received=count, last_sample=count / 20_000.0,
                           **moving(bench, command, samples_published=count)) == []
    end = replace(bench.seen.actuator, active=False, start_time=9, samples_published=400_000)
    assert bench.after(0.1, actuator=end) == [CloseRecord("complete", 9, 400_000), Finish("")]


def test_an_upload_that_does_not_come_aborts():
    bench, command = long_test()
    closed, _ = later(bench, command, 60.0)
    assert closed.status == "aborted"
    assert bench.seen.now - START.now == pytest.approx(20.0 + 5.0, abs=1.1)


def test_a_status_counts_as_late_from_the_begin_of_a_test_on():
    """The last one before came nearly three seconds ago."""
    bench = Bench(replace(LATER, actuator_heard=LATER.now - ACTUATOR_TIMEOUT + 0.1))
    bench.start()
    assert bench.after(1.0) == []


def test_a_driver_that_captures_and_falls_silent_aborts():
    bench, command = long_test()
    assert bench.after(0.0, **moving(bench, command)) == []
    assert bench.after(ACTUATOR_TIMEOUT - 0.1) == []
    closed, back = bench.after(0.2)
    assert closed.status == "aborted"
    (finish,) = bench.executed(back, STEP.start, 0)
    assert finish.reason == "aborted: no status for 3.1 s: the driver has stopped"


@pytest.mark.parametrize("cause", [{"interlock": "took off"}, {"abort": True}])
def test_the_way_back_ends_where_the_interlock_opens_or_an_abort_is_asked_for(cause):
    bench = Bench()
    bench.to_testing()
    silenced(bench)
    (stop,) = bench.after(0.1, last_position=0.05, **cause)
    assert stop.profile.points == ((1e-3, 0.05),)
    (finish,) = at_rest(bench, 0.05)
    assert finish.reason.startswith("aborted: no samples")


def test_interlock_lost_while_moving_has_no_record_to_close():
    bench = Bench()
    bench.start()
    assert kinds(bench.after(0.1, interlock="took off")) == [SendCommand]


def test_a_surface_that_does_not_come_back_is_said():
    bench = Bench()
    bench.to_testing()
    silenced(bench)
    (finish,) = bench.after(6.6)
    assert "not confirmed to be back" in finish.reason


def test_a_foreign_command_before_the_begin_is_refused_before_anything_moves():
    bench = Bench(replace(START, actuator=replace(REST, active=True)))
    assert bench.start() == []
    (refused,) = bench.after(1.0, actuator=REST, foreign_command=True)
    assert refused == Finish("refused: another node commands the actuator")


def test_a_foreign_command_ends_the_test_without_a_fight():
    bench = Bench()
    bench.to_testing()
    assert kinds(bench.after(0.1, foreign_command=True)) == [CloseRecord, Finish]


def test_silence_aborts():
    bench = Bench()
    bench.to_testing()
    bench.seen = replace(bench.seen, now=bench.seen.now + 5.1)
    actions = bench.sequence.step(bench.seen)
    assert kinds(actions) == [CloseRecord, SendCommand]
    assert actions[0].status == "aborted"


def test_stop_marks_the_record_interrupted_and_ends_at_once():
    bench = Bench()
    bench.to_testing()
    closed, back = bench.after(0.1, stop=True)
    assert closed.status == "interrupted"
    assert isinstance(back, SendCommand)
    assert kinds(bench.after(0.0)) == [Finish]


@pytest.mark.parametrize("away", [-0.1, 0.4])
def test_a_surface_that_does_not_reach_the_start_aborts(away):
    bench = Bench()
    (move,) = bench.start()
    (back,) = bench.executed(move, STEP.start + away, 3000)
    assert isinstance(back, SendCommand)
    assert bench.sequence.stage is Stage.RETURNING


def test_an_endless_test_is_ended():
    bench = Bench()
    bench.to_testing()
    for _ in range(130):
        actions = bench.after(1.0, last_sample=0.1)
        if actions:
            break
    assert actions[0].status == "aborted"


def test_the_way_to_the_start_counts_in_the_time_of_a_test():
    bench = Bench()
    (move,) = bench.start()
    assert bench.after(100.0) == []
    bench.executed(move, STEP.start, 3000)
    bench.seen = replace(bench.seen, samples_received=0, last_sample=-1.0)
    closed, _ = bench.after(20.0, last_sample=0.1)
    assert closed.status == "aborted"


def test_commands_have_growing_stamps_where_the_clock_is_set_back():
    bench = Bench()
    (move,) = bench.start()
    bench.seen = replace(bench.seen, stamp=bench.seen.stamp - 3_600 * 10**9)
    opened, test = bench.executed(move, STEP.start, 3000)
    assert opened.stamp == test.stamp > move.stamp


def test_a_failed_action_aborts():
    bench = Bench()
    bench.to_testing()
    actions = bench.sequence.fail("disk full", bench.seen)
    assert kinds(actions) == [CloseRecord, SendCommand]
    (finish,) = bench.executed(actions[1], 0.1, 1)
    assert finish.reason == "aborted: disk full"


def test_a_test_that_ends_already_is_not_aborted_again():
    """Or a driver whose samples are damaged is commanded anew with each of them, for ever."""
    bench = Bench()
    bench.to_testing()
    _, back = bench.sequence.fail("damaged", bench.seen)
    for _ in range(3):
        assert bench.sequence.fail("disk full", bench.seen) == []
        assert bench.after(0.1) == []
    (finish,) = bench.executed(back, 0.1, 1)
    assert finish.reason.startswith("aborted: damaged; disk full")


def test_who_asked_is_answered_where_the_record_cannot_be_closed_at_the_end():
    bench = Bench()
    (move,) = bench.start()
    _, test = bench.executed(move, STEP.start, 3000)
    assert kinds(bench.executed(test, 0.27, 9000)) == [CloseRecord, Finish]
    assert bench.sequence.stage is Stage.IDLE
    assert bench.sequence.fail("disk full", bench.seen) == [Finish("aborted: disk full")]


@pytest.mark.parametrize(("end_stop", "accepted"), [(0.8, True), (0.6, False)])
def test_the_end_stops_of_the_actuator_bound_the_test(end_stop, accepted):
    profile = step_profile(1.4, start=-0.7)
    actuator = changed(surface={"end_stop": end_stop})
    if accepted:
        assert TestSequence(profile, actuator).profile == profile
    else:
        with pytest.raises(UsageError, match=r"outside the end stops of this actuator, \+-0.6"):
            TestSequence(profile, actuator)


@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_near_the_start_is_a_share_of_the_travel(scale):
    """Three mrad from it the default actuator is there, one of a tenth of its travel is not."""
    actuator = changed(surface={"end_stop": scale * END_STOP})
    profile = step_profile(scale * 0.8, start=-scale * 0.4)
    at = replace(REST, surface_position=profile.start + 2.9e-3)
    actions = TestSequence(profile, actuator).start(replace(START, actuator=at))
    assert kinds(actions) == ([OpenRecord, SendCommand] if scale == 1.0 else [SendCommand])


def test_a_slow_actuator_has_time_to_come_back():
    """At a hundredth of the slew speed the way from stop to stop takes 152 s."""
    slow = changed(control={"speed_limit": 0.01 * ACTUATOR.control.speed_limit})
    for actuator, seconds, patient in (
            (ACTUATOR, 10.0, False), (slow, 152.0, True), (slow, 160.0, False)):
        bench = Bench(actuator=actuator)
        bench.to_testing()
        silenced(bench)
        actions = bench.after(seconds)
        assert (actions == []) == patient


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_surface_that_reads_beyond_its_end_stop_is_sent_back_to_the_stop(side):
    """Its transducer is off by a little: a command beyond the stop would be refused."""
    at = side * (END_STOP + 1e-3)
    bench = Bench(replace(START, actuator=replace(REST, surface_position=at)))
    (move,) = bench.start()
    bench.executed(move, STEP.start, 3000)
    *_, back = silenced(bench)
    assert back.profile.points[-1][1] == side * END_STOP


def test_an_abort_during_an_upload_holds_the_surface_where_it_is_now():
    """What is uploaded then is where it was: half a radian away, at full speed."""
    bench, command = long_test()
    later(bench, command, 21.0)
    bench.after(0.1, samples_received=2800, last_sample=0.14, last_position=-0.25,
                **moving(bench, command, surface_position=0.4))
    _, stop = bench.after(0.01, abort=True)
    assert stop.profile.points == ((1e-3, 0.4),)


def test_the_surface_is_where_the_latest_news_say():
    """A driver that streams and falls silent, but still reports where it is."""
    bench = Bench()
    bench.to_testing()
    bench.after(0.2, samples_received=100, last_position=-0.3)
    block, status = bench.seen.last_block, replace(bench.seen.actuator, surface_position=0.1)
    bench.seen = replace(bench.seen, now=bench.seen.now + 1.0, last_block=block, actuator=status,
                         actuator_heard=bench.seen.now + 1.0, abort=True)
    _, stop = bench.sequence.step(bench.seen)
    assert stop.profile.points == ((1e-3, 0.1),)
