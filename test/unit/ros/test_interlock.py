"""The interlock: present, fresh and true."""

from ema_ros.interlock import Deadman, Interlock


def test_refuses_without_any_message():
    assert "no weight-on-wheels signal" in Interlock().reason(0.0)


def test_a_request_waits_for_the_first_message_as_long_as_one_stays_fresh():
    interlock = Interlock(1.0)
    assert interlock.is_undecided(10.9, asked=10.0)
    assert not interlock.is_undecided(11.1, asked=10.0), "nothing came: it is to be refused"
    interlock.update(False, 10.9)
    assert not interlock.is_undecided(10.9, asked=10.0), "a first message decides, either way"


def test_true_and_fresh_is_allowed_until_it_is_stale():
    interlock = Interlock(1.0)
    interlock.update(True, 10.0)
    assert interlock.reason(10.0) == ""
    assert interlock.reason(11.0) == ""
    assert interlock.reason(11.01) == "weight-on-wheels signal is 1.0 s old, at most 1 s"


def test_false_is_refused_at_once():
    interlock = Interlock(1.0)
    interlock.update(True, 10.0)
    interlock.update(False, 10.1)
    assert "not on the ground" in interlock.reason(10.1)


def test_a_latched_message_counts_from_when_it_was_sent():
    interlock = Interlock(1.0)
    interlock.update(True, 10.0, transit=30.0)
    assert "30.0 s old" in interlock.reason(10.0)


def test_a_source_clock_that_is_ahead_makes_nothing_fresher():
    interlock = Interlock(1.0)
    interlock.update(True, 10.0, transit=-3600.0)
    assert interlock.reason(11.5) != ""


def test_an_interlock_that_opened_for_a_moment_during_the_test_is_told():
    interlock = Interlock(1.0)
    interlock.update(True, 10.0)
    interlock.update(False, 10.50)
    interlock.update(True, 10.51)
    assert "went off for a moment, 0.03 s ago" in interlock.reason(10.53, since=10.1)
    assert interlock.reason(20.0, since=10.6) != "", "stale"
    interlock.update(True, 20.0)
    assert interlock.reason(20.0, since=10.6) == ""


def test_flapping_weight_on_wheels_begins_no_test():
    interlock = Interlock(1.0)
    for k in range(10):
        interlock.update(k % 2 == 1, 10.0 + 0.1 * k)
    assert "back for 0.10 s only, at least 1.25 s" in interlock.reason(10.9)
    interlock.update(True, 12.1)
    assert interlock.reason(12.1) == ""


def test_who_says_no_once_a_second_is_not_overruled():
    """Two publish: one ten times a second that it is on, the aircraft once that it is off."""
    interlock = Interlock(1.0)
    for k in range(100):
        interlock.update(k % 10 != 0, 10.0 + 0.1 * k)
        assert interlock.reason(10.0 + 0.1 * k) != ""


def test_a_source_whose_clock_is_behind_is_refused_with_a_hint():
    interlock = Interlock(1.0)
    interlock.update(True, 10.0, transit=5.0)
    assert "do the clocks agree?" in interlock.reason(10.0)


def test_an_actuator_asks_for_no_time_to_hold_but_ends_for_a_moment():
    interlock = Interlock(1.0, hold=0.0)
    interlock.update(False, 10.0)
    interlock.update(True, 10.01)
    assert interlock.reason(10.02) == ""
    assert "went off for a moment" in interlock.reason(10.02, since=9.0)


def test_silence_of_who_commands_ends_the_command_that_he_watched():
    deadman = Deadman(0.5)
    assert deadman.reason(7, 100.0) == "", "who never gives a sign is not asked for it"
    assert deadman.reason(0, 100.0) == "", "nor where his command has no stamp"
    deadman.update(7, 100.0)
    assert deadman.reason(7, 100.5) == ""
    assert deadman.reason(7, 100.6) == "no sign of life from who commands for 0.60 s"
    assert deadman.reason(8, 100.6) == "", "a sign for one command is none for the next"


def test_a_sign_for_another_command_does_not_take_the_watch_off():
    deadman = Deadman(0.5)
    assert deadman.reason(7, 100.0) == ""
    deadman.update(7, 100.1)
    deadman.update(9, 100.2)
    assert deadman.reason(7, 100.5) == ""
    assert deadman.reason(7, 100.7) == "no sign of life from who commands for 0.60 s"
    deadman.update(9, 100.8)
    assert deadman.reason(7, 100.9), "nor does it keep the one that runs alive"


def test_a_sign_may_come_before_its_command():
    deadman = Deadman(0.5)
    deadman.update(7, 100.0)
    assert deadman.reason(7, 100.1) == ""
    assert deadman.reason(7, 100.6) == "no sign of life from who commands for 0.60 s"
