"""`ema replay`: bags back onto the topics, in their own time."""

from __future__ import annotations

from typing import Annotated

import typer

from ema_cli.console import error_line, given_bags, print_json, progress, say
from ema_cli.options import Bags, Domain, ObjectABag
from ema_record.errors import RecordError, UsageError, bounded, counted

RATES = (0.01, 100.0)


def replay(
    bags: Bags,
    rate: Annotated[float, typer.Option(
        "--rate", "-r", help="Speed, 1 for the original timing.")] = 1.0,
    wait: Annotated[float, typer.Option(
        "--wait", help="Longest wait for a subscriber to the samples (s).")] = 10.0,
    domain: Domain = None,
    as_json: ObjectABag = False,
) -> int:
    """Put bags back onto the topics, one after the other.

    Everything that was recorded is published as it was, byte by byte, once a subscriber
    listens to /ema/samples; it ends when all of it is acknowledged. Exit status: 0 all were
    published, 2 or 3 a bag cannot be read; of several bags the worst, 2 before 3.

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
            messages = load_messages(bag)
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
