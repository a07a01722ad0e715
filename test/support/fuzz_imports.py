"""Fuzzed files of foreign rigs and their maps, as `ema import` reads them, and bags of rigs."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import scipy.io
import yaml
from hypothesis import strategies as st

from ema_rig.bag import read_rig_bag, write_rig_bag
from ema_rig.import_file import import_file
from ema_rig.map import load_map, map_from
from support.fuzz_targets import EDITS, VALUES, Target, change

MAP: dict[str, Any] = {
    "name": "rig", "axis": "linear", "time": {"column": "t", "unit": "s"},
    "input": {"column": "u", "unit": "V", "acts_as": "force", "gain": 35.15},
    "position": {"column": "x", "unit": "m"},
}
ROWS = 40


def _columns() -> dict[str, np.ndarray]:
    time = np.arange(ROWS) / 1000.0
    return {"t": time, "u": np.sin(time), "x": np.cos(time)}


def _text() -> bytes:
    columns = _columns()
    rows = [",".join(columns), *(
        ",".join(f"{value:.6g}" for value in row) for row in zip(*columns.values())
    )]
    return "\n".join(rows).encode()


def _npz() -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **_columns())
    return stream.getvalue()


def _mat() -> bytes:
    stream = io.BytesIO()
    scipy.io.savemat(stream, _columns())
    return b"MATLAB 5.0 MAT-file".ljust(116) + stream.getvalue()[116:]  # it has the date in it


def _hdf5() -> bytes:
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        for name, values in _columns().items():
            file[name] = values
    return stream.getvalue()


def _xlsx() -> bytes:
    stream = io.BytesIO()
    pd.DataFrame(_columns()).to_excel(stream, index=False)
    return stream.getvalue()


def import_targets(folder: Path) -> list[Target]:
    """Return the targets; `folder` is theirs."""
    rig_map = map_from(MAP, "map")

    def in_file(name: str, use: Callable[[Path], object]) -> Callable[[bytes], object]:
        path = folder / name

        def read(data: bytes) -> object:
            path.write_bytes(data)
            return use(path)

        return read

    def imported(path: Path) -> object:
        return import_file(path, rig_map)

    files = [
        Target(f"import {name}", EDITS.map(lambda edits, d=data: change(d, edits)),
               in_file(f"rig.{name}", imported), 0.04)
        for name, data in (("csv", _text()), ("npz", _npz()), ("mat", _mat()), ("h5", _hdf5()),
                           ("xlsx", _xlsx()))
    ]

    def put(key: str, inner: str, value: object) -> bytes:
        copy = json.loads(json.dumps(MAP))
        if isinstance(copy.get(key), dict) and inner:
            copy[key][inner] = value
        else:
            copy[key] = value
        return str(yaml.safe_dump(copy)).encode("utf-8", errors="replace")

    keys = st.sampled_from([*MAP, "format", "channels", "start", "end", "profile", "speed"])
    inner = st.sampled_from(["", "column", "unit", "scale", "zero", "gain", "acts_as", "rate"])
    shipped = str(yaml.safe_dump(MAP)).encode()
    maps = st.one_of(st.builds(put, keys, inner, VALUES),
                     EDITS.map(lambda edits: change(shipped, edits)))

    def mapped(path: Path) -> object:
        (folder / "rig.csv").write_bytes(_text())
        return import_file(folder / "rig.csv", load_map(path))

    source = folder / "whole.csv"
    source.write_bytes(_text())
    record = import_file(source, rig_map)
    bag = write_rig_bag(record, folder / "rig_bag")  # type: ignore[arg-type]
    (file,) = bag.glob("*.mcap")
    whole = file.read_bytes()

    def rig_bag(data: bytes) -> object:
        file.write_bytes(data)
        return read_rig_bag(bag)

    return [*files, Target("map", maps, in_file("map.yaml", mapped), 0.05),
            Target("bag of a rig", EDITS.map(lambda e: change(whole, e)), rig_bag, 0.05)]
