"""The folder of a campaign: manifest, chunks of results that appear whole, final table."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ema_record.array_cache import DAMAGED, read_arrays, write_arrays
from ema_record.errors import OutputError, UsageError
from ema_record.files import cannot_write, exists, locked, new_file, read_bounded
from ema_record.version import VERSION

MANIFEST = "campaign.json"
TABLE = "table.csv"
CHUNKS = "chunks"
BAGS = "bags"
FORMAT = 1
MAX_MANIFEST = 1 << 20
PARAMETERS, RESULTS = "parameters.", "results."
"""Prefixes of the columns that were drawn and that were found."""
ALWAYS = {"run", "seed", "failed", "profile"}
"""Columns of every chunk."""

Columns = dict[str, np.ndarray]


def manifest_of(digest: str, plan: object, keep: str, sources: str, runs: int, chunk: int) -> dict:
    """Return what identifies the results of a campaign; equal manifests, equal bytes."""
    return {
        "format": FORMAT, "digest": digest, "keep": keep, "runs": runs, "runs_a_chunk": chunk,
        "software": VERSION, "sources": sources, "numpy": np.__version__, "plan": plan,
    }


class CampaignFolder:
    """Results of one campaign on disk.

    Parameters
    ----------
    path : folder of a campaign.
    manifest : what is to be run into it, see `manifest_of`; the folder is then made if it is not
        there, and must be of the same campaign if it is. None: it is only read.

    Raises
    ------
    OutputError
        The folder holds something else, or is of another plan or software.
    UsageError
        There is no campaign to read.
    """

    def __init__(self, path: str | Path, manifest: Mapping[str, object] | None = None) -> None:
        """Make the folder, or take up the one that is there."""
        self.path = Path(path)
        if manifest is None:
            read_manifest(self.path)
        else:
            self._take_up(manifest)

    def _take_up(self, manifest: Mapping[str, object]) -> None:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            names = {p.name for p in self.path.iterdir()} - {".lock"}
            names -= {n for n in names if n.startswith(f".{MANIFEST}.")}
        except FileExistsError:
            raise exists(self.path) from None
        except OSError as error:
            raise cannot_write(self.path, error) from None
        if MANIFEST in names:
            self._compare(manifest)
        elif names:
            raise OutputError(
                f"{self.path}: holds files of something else ({min(names)}): choose a new folder"
            )
        else:
            text = json.dumps(manifest, indent=1, ensure_ascii=False) + "\n"
            with new_file(self.path / MANIFEST) as temporary:
                temporary.write_text(text, encoding="utf-8")
        (self.path / CHUNKS).mkdir(exist_ok=True)

    def locked(self) -> AbstractContextManager[None]:
        """Keep other processes from running the same campaign into this folder."""
        return locked(self.path / ".lock",
                      f"{self.path}: another process is running this campaign: wait for it")

    def done(self) -> set[int]:
        """Return the numbers of the chunks that are there."""
        return {int(p.stem) for p in (self.path / CHUNKS).glob("*.npz") if p.stem.isdecimal()}

    def save(self, chunk: int, columns: Columns) -> None:
        """Write one chunk: whole or not at all."""
        write_arrays(self._chunk(chunk), columns)

    def load(self, chunk: int) -> Columns:
        """Return the columns of one chunk, which holds all runs of its number."""
        path = self._chunk(chunk)
        try:
            found, manifest = read_arrays(path), read_manifest(self.path)
            first = chunk * manifest["runs_a_chunk"]
            runs = np.arange(first, min(first + manifest["runs_a_chunk"], manifest["runs"]))
            if not (np.array_equal(found["run"], runs) and len(runs) and found.keys() >= ALWAYS
                    and all(c.ndim and len(c) == len(runs) for c in found.values())
                    and found["failed"].dtype == bool):
                raise ValueError("other runs")
            return found
        except (*DAMAGED, TypeError):
            raise UsageError(
                f"{path}: is damaged: delete it and repeat the command, which makes it anew"
            ) from None

    def finish(self, columns: Columns) -> None:
        """Write the table of all columns that hold one value a run; an equal one may be there."""
        table = self.path / TABLE
        if table.exists() and not table.is_file():  # a pipe would be waited for
            raise exists(table)
        if not table.exists():
            with new_file(table) as temporary:
                write_table(temporary, columns)
            return
        with TemporaryDirectory() as place:
            write_table(Path(place, TABLE), columns)
            if Path(place, TABLE).read_bytes() != table.read_bytes():
                raise OutputError(f"{table}: not the table of these runs: move it away and repeat "
                                  "the command, which makes it anew")

    def _chunk(self, chunk: int) -> Path:
        return self.path / CHUNKS / f"{chunk:06d}.npz"

    def _compare(self, manifest: Mapping[str, object]) -> None:
        there = read_manifest(self.path)
        for name, what in (
            ("digest", "another plan"), ("keep", "another reduction"),
            ("runs_a_chunk", "another plan"), ("software", "another version of the software"),
            ("sources", "other sources of the software"), ("numpy", "another version of numpy"),
            ("format", "another version of the software"),
        ):
            if there.get(name) != manifest[name]:
                raise OutputError(
                    f"{self.path}: holds the results of {what} and is never overwritten: "
                    "choose another folder"
                )


def read_manifest(path: Path) -> dict:
    """Return the manifest of a campaign's folder."""
    file = path / MANIFEST
    try:
        found = json.loads(read_bounded(file, MAX_MANIFEST))
    except OSError as error:
        raise UsageError(
            f"{file}: {error.strerror or error}: give the folder of a campaign"
        ) from None
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise UsageError(f"{file}: is damaged: choose another folder")
    return found


def merge(chunks: Sequence[Columns]) -> Columns:
    """Return chunks end to end; a column that is missing where all runs failed becomes NaN."""
    names = list(dict.fromkeys(name for chunk in chunks for name in chunk))
    shapes = {name: next(c[name] for c in chunks if name in c) for name in names}
    merged = {}
    for name in names:
        pieces = []
        for chunk in chunks:
            if name in chunk:
                pieces.append(chunk[name])
            elif not chunk["failed"].all():
                raise UsageError(f"{name}: missing of runs from number {chunk['run'][0]} on, "
                                 "which did not fail: let the reduction give the same names for "
                                 f"every run, or, of a folder that was edited, delete {CHUNKS}/")
            else:
                pieces.append(np.full((len(chunk["run"]), *shapes[name].shape[1:]), np.nan))
        if any(p.shape[1:] != pieces[0].shape[1:] for p in pieces):
            raise UsageError(f"{name}: its shape differs between runs: let the reduction pad it")
        merged[name] = np.concatenate(pieces)
    return merged


def write_table(path: Path, columns: Columns) -> None:
    """Write columns of one value a run as CSV; floats with all their digits."""
    scalar = {name: c for name, c in columns.items() if c.ndim == 1}
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([n.removeprefix(PARAMETERS).removeprefix(RESULTS) for n in scalar])
        writer.writerows(zip(*(c.tolist() for c in scalar.values()), strict=True))


def load_campaign(path: str | Path) -> Columns:
    """Return the columns of a campaign that was run into a folder, run by run.

    Those are ``run``, ``seed``, ``failed``, ``profile``, ``parameters.<name>`` and
    ``results.<name>``, shape (runs, ...).

    Parameters
    ----------
    path : the folder; a campaign that was interrupted gives what is done.
    """
    folder = CampaignFolder(path)
    done = sorted(folder.done())
    if not done:
        raise UsageError(f"{path}: no run is finished yet: run the campaign")
    return merge([folder.load(chunk) for chunk in done])
