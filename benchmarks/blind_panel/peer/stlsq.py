"""Run under an interpreter with pysindy: ``python stlsq.py PROBLEMS.npz TASK.json ANSWER.json``.

Needs nothing of ours. TASK is one of

- ``{"thresholds": {port: value}}``: fit with these (in the unit of the response);
- ``{"grid": {port: [value, ...]}}``: count the laws that each of these leaves;
- ``{}``: choose the threshold of each port by block cross-validation, five blocks in time.
"""

import json
import sys
import time
import warnings
from pathlib import Path

import numpy as np
from pysindy import STLSQ

SHARES = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Thresholds that are tried, as shares of the response's rms."""
RIDGE = 1e-4
BLOCKS = 5


def fit(x: np.ndarray, y: np.ndarray, threshold: float) -> np.ndarray:
    """Return the coefficients; `threshold` in the unit of `y` (the columns have rms 1)."""
    model = STLSQ(threshold=threshold, alpha=RIDGE * len(y), max_iter=20)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns when nothing is left
        return np.asarray(model.fit(x, y[:, None]).coef_).ravel()


def by_validation(x: np.ndarray, y: np.ndarray) -> float:
    """Return the threshold by cross-validation."""
    thresholds = np.array(SHARES) * (float(np.sqrt(np.mean(y**2))) or 1.0)
    blocks = np.array_split(np.arange(len(y)), BLOCKS)
    errors = np.zeros(len(thresholds))
    for left in blocks:
        kept = np.ones(len(y), dtype=bool)
        kept[left] = False
        for t, threshold in enumerate(thresholds):
            coefficients = fit(x[kept], y[kept], threshold)
            errors[t] += np.sum((y[left] - x[left] @ coefficients) ** 2)
    return float(thresholds[np.argmin(errors)])


def main() -> None:
    """Solve all ports of one record."""
    start = time.perf_counter()
    task = json.loads(Path(sys.argv[2]).read_text(encoding="utf-8"))
    active, counts = [], {}
    with np.load(sys.argv[1]) as data:
        for port in json.loads(str(data["ports"])):
            x, y = data[f"{port}:x"], data[f"{port}:y"]
            if "grid" in task:
                counts[port] = [int(np.count_nonzero(fit(x, y, t))) for t in task["grid"][port]]
                continue
            given = task.get("thresholds", {}).get(port)
            coefficients = fit(x, y, by_validation(x, y) if given is None else given)
            active += [
                {"port": port, "laws": name, "size": abs(float(c))}
                for name, c in zip(json.loads(str(data[f"{port}:names"])), coefficients)
                if c != 0.0
            ]
    answer = {"active": active, "counts": counts, "seconds": time.perf_counter() - start}
    Path(sys.argv[3]).write_text(json.dumps(answer), encoding="utf-8")


if __name__ == "__main__":
    main()
