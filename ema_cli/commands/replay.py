"""`ema replay`: a bag back onto the topics, in its own time."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ema_cli.console import print_json, progress, say
from ema_record.errors import bounded

RATES = (0.01, 100.0)


def replay(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="Directory or .mcap file.")],
    rate: Annotated[float, typer.Option(
        "--rate", "-r", help="Speed, 1 for the original timing.")] = 1.0,
    wait: Annotated[float, typer.Option(
        "--wait", help="Longest wait for a subscriber to the samples (s).")] = 10.0,
    domain: Annotated[int | None, typer.Option(
        "--domain", min=0, max=232, help="ROS domain, default ROS_DOMAIN_ID.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the counts as JSON.")] = False,
) -> int:
    """Put a bag back onto the topics.

    Everything that was recorded is published as it was, byte by byte, once a subscriber
    listens to /ema/samples; it ends when all of it is acknowledged.

    Example: `ema replay bags/sim_0001_extended`
    """
    from ema_ros.domain import use_fast_discovery
    from ema_ros.replay_bag import load_messages

    bounded("--rate", rate, *RATES)
    bounded("--wait", wait, 0.0, 3600.0, "s")
    messages = load_messages(bag)
    use_fast_discovery(domain)
    from ema_ros.replay_node import play

    with progress(f"replaying {bag}", messages[-1].time / rate) as show:
        counts = play(messages, rate=rate, wait=wait, show=show)
    if as_json:
        print_json({"bag": str(bag), "rate": rate, "messages": counts})
    else:
        for topic, count in counts.items():
            say(f"{topic}: {count} messages")
    return 0
