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
    """Return commands that use the updated model, check it, and run the proposed test.

    Parameters
    ----------
    identification : the result.
    out : the folder of the report.
    inputs : as `write_report` has them; what `ema identify` was given is given again.
    next_test_file : name of the proposed command's file in `out`.
    """
    found = []
    measured = " ".join(shlex.quote(path) for path in as_list(inputs.get("measured", ())))
    given = "".join(
        f" --{option} {shlex.quote(value)}" for option in ("validate", "without", "profile")
        for value in as_list(inputs.get(option, ())))
    if identification.model_text:
        model = shlex.quote(str(out / MODEL))
        if identification.machine == "actuator":
            found.append(f"ema simulate --model {model} --profile extended --out simulated")
        if measured:
            again = shlex.quote(f"{out}_again")
            found.append(f"ema identify {measured}{given} --model {model} --out {again}")
    if identification.next_profile is not None:
        test = shlex.quote(str(out / next_test_file))
        found.append(f"ema bit --profile {test}")
        if measured:
            both = shlex.quote(f"{out}_next")
            found.append(f"ema identify {measured} NEW_RECORD{given} --out {both}")
    return found


def as_list(value: str | Sequence[str]) -> list[str]:
    """Return one or several texts as a list."""
    return [value] if isinstance(value, str) else [str(item) for item in value]
