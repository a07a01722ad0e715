"""`judged_fleet`: every bag judged once, by all cores or a cluster; the rest is remembered."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from ema_prognostics.fleet.verdict_store import VerdictStore
from ema_prognostics.verdict.contract import hash_of, kit_sha256, trace_of, verdict_object
from ema_prognostics.verdict.judge import Judge
from ema_prognostics.words import ENGLISH, FOLDER
from ema_record.array_cache import key_of
from ema_record.bag.content_hash import file_sha256, files_state
from ema_record.errors import UsageError
from ema_sim.campaign.workers import done_by_workers

MODULE = "ema_prognostics.fleet.judging"
"""This module: its sources and those of all that it imports decide a verdict."""
LEAST_CHUNK, CHUNK = 4, 16
"""Bags a task: a second of work, against some milliseconds to send it; few where few wait."""
Objects = list[dict[str, Any]]


class JudgeSettings(NamedTuple):
    """What a worker needs to judge as this process does."""

    model: str | None = None
    profile: str | None = None

    @classmethod
    def of(cls, model: str | Path | None, profile: str | Path | None) -> JudgeSettings:
        """Return the settings of the present kit, with paths that hold in another process."""
        def place(given: str | Path | None) -> str | None:
            if given is None:
                return None
            return str(Path(given).resolve() if Path(given).is_file() else given)

        return cls(place(model), place(profile))

    def key(self) -> str:
        """Return the hash of all that a verdict depends on beside the bag.

        Kit, networks, commanded test, words, sources and numerical packages.
        """
        parts = [kit_sha256(), file_sha256(FOLDER / f"{ENGLISH}.yaml")]
        for given in (self.model, self.profile):
            path = Path(given or "")
            parts.append(file_sha256(path) if given and path.is_file() else given or "")
        return key_of(*parts, module=MODULE)


class BagsTask(NamedTuple):
    """Some bags, and how to judge them; goes to a worker."""

    settings: JudgeSettings
    software: str
    """Key of the sources, which a worker's must equal."""
    bags: tuple[str, ...]


class BagsDone(NamedTuple):
    """What comes back: the contents of the bags, and the object of each."""

    software: str
    objects: Objects


@lru_cache(maxsize=2)
def _judge(settings: JudgeSettings, _software: str) -> Judge:
    return Judge(settings.model, profile=settings.profile)


def judge_bags(task: BagsTask) -> BagsDone:
    """Judge the bags of a task (in a worker)."""
    judge = _judge(task.settings, task.software)
    trace = trace_of(judge.model_sha256)
    return BagsDone(task.settings.key(), [_object(judge, trace, bag) for bag in task.bags])


def _object(judge: Judge, trace: dict[str, Any], bag: str) -> dict[str, Any]:
    before = _state(bag)
    judged, content = judge.of_bag(bag), hash_of(bag)
    if _state(bag) != before:  # written meanwhile: not what was judged
        content = None
    return verdict_object(judged, trace, record_sha256=content or "") | {
        "start_time": judged.start_time}


def _state(bag: str) -> str:
    """Return `files_state` of a bag, empty where it cannot be looked at."""
    try:
        return files_state(bag)[0]
    except OSError:
        return ""


def judged_fleet(
    bags: Sequence[Path], settings: JudgeSettings, *, jobs: int | None, dask: str | None,
    folder: Path | None, progress: Callable[[int], object],
) -> Objects:
    """Return the object of every bag, in their order; see `contract.verdict_object`.

    Parameters
    ----------
    bags : any; what cannot be read is incomplete or invalid.
    settings : how to judge.
    jobs, dask : see `workers.done_by_workers`.
    folder : of the verdicts that are known, default the user's cache.
    progress : called with the number of bags that are done.

    Raises
    ------
    UsageError
        A worker has other sources.
    """
    software = settings.key()
    with VerdictStore(software, folder) as store:
        contents = [store.sha256(bag) for bag in bags]
        first: dict[str, Path] = {}  # copies are judged once
        for bag, content in zip(bags, contents, strict=True):
            if content is None or store.get(content) is None:
                first.setdefault(content or f"path {bag}", bag)
        waiting = [str(path) for path in first.values()]
        judged: dict[str, dict[str, Any]] = {}
        done = len(bags) - len(waiting)
        progress(done)
        share = -(-len(waiting) // (2 * (jobs or os.cpu_count() or 1)))
        size = min(max(LEAST_CHUNK, share), CHUNK)
        tasks = [BagsTask(settings, software, tuple(waiting[k:k + size]))
                 for k in range(0, len(waiting), size)]
        for result in done_by_workers(judge_bags, tasks, jobs=jobs, dask=dask):
            if result.software != software:
                raise UsageError(
                    f"a worker{f' of dask {dask}' if dask else ''} has other sources of this "
                    "software, or another kit: install the same everywhere"
                )
            store.put((found["record_sha256"], found) for found in result.objects
                      if found["record_sha256"] is not None)
            judged |= {found["bag"]: found for found in result.objects}
            done += len(result.objects)
            progress(done)
        return [_of_path(judged.get(str(bag)) or store.get(content), bag)
                for bag, content in zip(bags, contents, strict=True)]


def _of_path(found: dict[str, Any] | None, bag: Path) -> dict[str, Any]:
    """Return an object under the path that its bag has here."""
    if found is None:
        raise UsageError(f"{bag}: was written while it was judged: repeat the command when it is "
                         "complete")
    before, path = found["bag"], str(bag)
    if before == path:
        return found
    return found | {"bag": path, "reasons": [
        path + r.removeprefix(before) if r.startswith(f"{before}: ") else r
        for r in found["reasons"]]}
