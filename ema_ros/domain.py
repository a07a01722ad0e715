"""A ROS domain of one's own, and the environment of processes in it."""

from __future__ import annotations

import os
import random
import socket
from collections.abc import Iterator
from contextlib import contextmanager

from ema_record.errors import UsageError
from ema_record.kit import share_path

DOMAINS = range(1, 102)
"""Domains whose ports are below those that the kernel hands out."""
_PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_PORT_BASE, _PORT_GAIN, _UNICAST = 7400, 250, 10


@contextmanager
def private_domain(wanted: int | None) -> Iterator[int]:
    """Yield a domain number that no other test on this machine uses.

    Parameters
    ----------
    wanted : the user's choice, taken as it is; None: a free one, held by the name of an abstract
        socket. Like the ports of the domain it counts in this network namespace for all users,
        and nothing is left of it when the process ends, however that happens (Linux).
    """
    if wanted is not None:
        yield wanted
        return
    for domain in random.sample(DOMAINS, len(DOMAINS)):
        if not _ports_free(domain):
            continue
        with socket.socket(socket.AF_UNIX) as held:
            try:
                held.bind(f"\0ema_phm_domain_{domain}")
            except OSError:
                continue
            yield domain
            return
    raise UsageError(
        f"no free ROS domain in {DOMAINS[0]} to {DOMAINS[-1]}: end other tests or give --domain"
    )


def _ports_free(domain: int) -> bool:
    """Whether nobody listens where the first participant of the domain would."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", _PORT_BASE + _PORT_GAIN * domain + _UNICAST))
        except OSError:
            return False
    return True


def enter_domain(domain: int) -> None:
    """Set the environment of this process, and of those it starts, for a local test.

    Over the loopback interface alone: a node that is killed then leaves nothing behind. A user's
    own choice of profiles or of the range of discovery stands.
    """
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    if _PROFILES in os.environ or _RANGE in os.environ:
        use_fast_discovery(None)
        os.environ.setdefault(_RANGE, "LOCALHOST")
        return
    os.environ |= local_environment()


def local_environment() -> dict[str, str]:
    """Return the variables that keep the middleware on this host, without shared memory."""
    return {_PROFILES: str(share_path("config/fastdds_local.xml")), _RANGE: "SYSTEM_DEFAULT"}


def use_fast_discovery(domain: int | None) -> None:
    """Let this process find others in 0.2 s; enter `domain` unless it is None."""
    if domain is not None:
        os.environ["ROS_DOMAIN_ID"] = str(domain)
    os.environ.setdefault(_PROFILES, str(share_path("config/fastdds.xml")))
