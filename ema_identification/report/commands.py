"""What to run next, as command lines of `ema`."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from ema_identification.result import Identification

MODEL = "model.yaml"


def next_commands(
    identification: Identification,
    out: Path,
    inputs: Mapping[str, str | Sequence[str]],
    next_test_file: str,
) -> list[str]:
    """Return commands that use the updated model, check it, and run the proposed test."""
    found = []
    measured = " ".join(shlex.quote(path) for path in as_list(inputs.get("measured", ())))
    validate = "".join(
        f" --validate {shlex.quote(path)}" for path in as_list(inputs.get("validate", ())))
    if identification.model_text:
        model = shlex.quote(str(out / MODEL))
        found.append(f"ema simulate --model {model} --profile extended --out simulated")
        if measured:
            again = shlex.quote(f"{out}_again")
            found.append(f"ema identify {measured}{validate} --model {model} --out {again}")
    if identification.next_profile is not None:
        test = shlex.quote(str(out / next_test_file))
        found.append(f"ema bit --profile {test}")
        if measured:
            both = shlex.quote(f"{out}_next")
            found.append(f"ema identify {measured} NEW_RECORD{validate} --out {both}")
    return found


def as_list(value: str | Sequence[str]) -> list[str]:
    """Return one or several texts as a list."""
    return [value] if isinstance(value, str) else [str(item) for item in value]
