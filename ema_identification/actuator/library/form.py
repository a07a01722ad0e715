"""What a kept library must look like: numbers, finite, of the shapes of `build.as_arrays`.

A kit's library comes from outside. Its hash tells a damaged file, not one of another form.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ema_identification.actuator.decision.proposals import Scores
from ema_identification.actuator.measure.tolerances import CONDITIONS

MAY_FAIL = {"features", "conditions", "added"}
"""What is not finite where a run failed."""


def check_form(kept: Mapping[str, np.ndarray], features: int) -> None:
    """Raise ValueError unless arrays have the form of a library of so many features.

    KeyError where one is missing. Nothing is made of them before.
    """
    d, below = features, features * (features - 1) // 2
    shapes: dict[str, tuple[int | None, ...]] = {
        "weights": (None, d), "healthy": (None, len(Scores._fields)), "carried": (),
        "features": (None, d), "conditions": (None, CONDITIONS)}
    for law in ("surrogate", "repeat"):
        shapes |= {f"{law}_quiet": (d,), f"{law}_noisy": (2, d), f"{law}_correlation": (below,)}
    for name in ("added", "probed_laws", "probed_units"):
        shapes |= {name: (None, d)} if name in kept else {}
    shapes |= {"probed_fit": (None,)} if "probed_fit" in kept else {}
    for name, shape in shapes.items():
        check_array(name, kept[name], shape, finite=name not in MAY_FAIL)
    if len(kept["features"]) != len(kept["conditions"]):
        raise ValueError("features: as many rows as conditions are needed")


def check_array(
    name: str, array: np.ndarray, shape: tuple[int | None, ...], *, finite: bool = True
) -> None:
    """Raise ValueError unless an array is of numbers and of a shape; None: any length above 0."""
    fits = array.ndim == len(shape) and all(
        n > 0 if wanted is None else n == wanted for n, wanted in zip(array.shape, shape))
    if not fits or array.dtype.kind != "f" or (finite and not np.isfinite(array).all()):
        raise ValueError(f"{name}: {array.dtype} of shape {array.shape}, expected finite numbers "
                         f"of shape {shape}")
