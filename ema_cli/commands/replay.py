"""`ema replay`: bags back onto the topics, in their own time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from ema_cli.console import error_line, given_bags, print_json, progress, say
from ema_cli.options import Bags, Domain, ObjectABag
from ema_record.errors import RecordError, UsageError, bounded, counted
from ema_record.wire.topics import SAMPLES

if TYPE_CHECKING:
    from ema_ros.replay_bag import ReplayMessage

RATES = (0.01, 100.0)


def replay(
    bags: Bags,
    rate: Annotated[float, typer.Option(
        "--rate", "-r", help="Speed, 1 for the original timing.")] = 1.0,
    wait: Annotated[float, typer.Option(
        "--wait", help="Longest wait for a subscriber to the samples (s).")] = 10.0,
    anyway: Annotated[bool, typer.Option(
        "--anyway", help="Also a record that is incomplete or of another actuator, which the "
        "topics do not say.")] = False,
    domain: Domain = None,
    as_json: ObjectABag = False,
) -> int:
    """Put bags back onto the topics, one after the other.

    What was recorded is published as it was, byte by byte, but for weight on wheels and the
    verdict, once a subscriber listens to /ema/samples; it ends when all of it is acknowledged.
    Exit status: 0 all were published, 2 or 3 a bag cannot be read, or is of another actuator or
    incomplete; of several bags the worst, 2 before 3.

    Example: `ema replay bags/sim_0001_extended`
    """
    from ema_prognostics.verdict.verdict import worst_status
    from ema_ros.domain import use_fast_discovery
    from ema_ros.replay_bag import load_messages

    bounded("--rate", rate, *RATES)
    bounded("--wait", wait, 0.0, 3600.0, "s")
    found, statuses = given_bags(bags), []
    for bag in found:
        try:
            messages = load_messages(bag, anyway=anyway)
            _check_rate(messages, rate)
        except (RecordError, UsageError) as error:
            error_line(str(error))
            statuses.append(error.exit_status)
            continue
        use_fast_discovery(domain)
        from ema_ros.replay_node import play

        with progress(f"replaying {bag}", messages[-1].time / rate) as show:
            counts = play(messages, rate=rate, wait=wait, show=show)
        statuses.append(0)
        if as_json:
            print_json({"bag": str(bag), "rate": rate, "messages": counts})
        elif len(found) > 1:
            say(f"{bag}: {counted(sum(counts.values()), 'message')} on "
                f"{counted(len(counts), 'topic')}")
        else:
            for topic, count in counts.items():
                say(f"{topic}: {counted(count, 'message')}")
    return worst_status(statuses)


def _check_rate(messages: Sequence[ReplayMessage], rate: float) -> None:
    """Raise UsageError where the samples come so slowly that who listens takes them as over."""
    from ema_prognostics.node.assembler import SILENCE

    times = [message.time for message in messages if message.topic == SAMPLES]
    pause = max((b - a for a, b in zip(times, times[1:])), default=0.0)
    if pause > rate * SILENCE:
        raise UsageError(
            f"--rate {rate:g}: samples would come {pause / rate:.2g} s apart, of which "
            f"{SILENCE:g} s end a record that is judged as it comes: at least "
            f"{1.01 * pause / SILENCE:.2g}")
