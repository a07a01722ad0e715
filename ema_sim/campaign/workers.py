"""Tasks done by worker processes on this machine, or by those of a dask scheduler."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from ema_record.errors import UsageError
from ema_record.kit import with_present_kit

Task = TypeVar("Task")
Done = TypeVar("Done")
MAX_JOBS = 1024
ANSWER_TIME = 15.0
"""Longest wait for a scheduler and its workers (s)."""


def check_jobs(jobs: int | None) -> None:
    """Raise UsageError unless that many workers can be had; None: one a core."""
    if jobs is not None and not 1 <= jobs <= MAX_JOBS:
        raise UsageError(f"jobs {jobs}: give 1 to {MAX_JOBS} worker processes")


def done_by_workers(
    function: Callable[[Task], Done], tasks: Sequence[Task], *, jobs: int | None = None,
    dask: str | None = None,
) -> Iterator[Done]:
    """Yield what `function` makes of each task with this process's kit, in any order.

    Parameters
    ----------
    function : that workers can import.
    tasks : that can be sent to them.
    jobs : worker processes on this machine, default one a core; 1 works in this process.
    dask : address of a dask scheduler, for example ``tcp://host:8786``, instead of `jobs`.
        Whoever answers there runs code in this process: only an address that you trust.

    Raises
    ------
    UsageError
        Too many jobs, no dask, or no scheduler with workers at that address.
    """
    check_jobs(jobs)
    jobs = min(jobs or os.cpu_count() or 1, len(tasks))
    if not tasks:
        return
    if dask is not None:
        yield from _on_cluster(function, tasks, dask)
    elif jobs == 1:
        for task in tasks:
            yield function(task)
    else:
        yield from _parallel(function, tasks, n_jobs=jobs, backend="loky")


def _parallel(
    function: Callable[[Task], Done], tasks: Iterable[Task], **options: object
) -> Iterator[Done]:
    """Yield what workers make; joblib ends them at once where this is interrupted or left."""
    from joblib import Parallel, delayed

    parallel = Parallel(return_as="generator_unordered", batch_size=1, **options)
    with _ignored_interrupts():
        done = delayed(with_present_kit(function))
        found: Iterator[Done] = parallel(done(task) for task in tasks)
    return found


@contextmanager
def _ignored_interrupts() -> Iterator[None]:
    """Let the workers that start here ignore Ctrl-C: this process hears it and ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _on_cluster(
    function: Callable[[Task], Done], tasks: Sequence[Task], address: str
) -> Iterator[Done]:
    try:
        from distributed import Client
        from joblib import parallel_config
    except ModuleNotFoundError:
        raise UsageError(
            "dask is not installed: pip install 'ema_phm[dask]', or leave --dask out"
        ) from None
    try:
        client = Client(address, timeout=ANSWER_TIME, set_as_default=True)
    except (OSError, ValueError, TypeError) as error:
        text = " ".join(str(error).split())[:120]
        raise UsageError(
            f"dask {address}: no scheduler answers ({text}): start one with 'dask scheduler'"
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=ANSWER_TIME)
        except TimeoutError:
            raise UsageError(
                f"dask {address}: the scheduler has no worker: start one with "
                f"'dask worker {address}'"
            ) from None
        with parallel_config(backend="dask"):
            yield from _parallel(function, tasks)
