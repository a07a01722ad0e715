"""`ema train`: the model file again, from nothing but the simulator and a seed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ema_cli.console import check_new, note, print_json, progress, stdout


def train(
    out: Annotated[Path, typer.Option(help="New model file; one that exists is not touched.")],
    seed: Annotated[int, typer.Option(
        min=0, max=2**31 - 1, help="Of units, noise and initial weights.")] = 1,
    quick: Annotated[bool, typer.Option(
        "--quick", help="A small training in under a minute, to try the way.")] = False,
    jobs: Annotated[int, typer.Option(
        min=-1, max=256, help="Processes that simulate, -1 for all cores.")] = -1,
    json: Annotated[bool, typer.Option("--json", help="The held-out results as JSON.")] = False,
) -> int:
    """Train the cascade of networks and write its model file.

    The same seed gives the same bytes, on any number of processes.

    Example: ema train --out model.json --seed 1
    """
    from ema_prognostics.model_file import load_model, save_model
    from ema_prognostics.train_model import total_steps, train_model

    check_new(out)
    with progress("training", total_steps(seed, quick=quick)) as advance:
        done = 0

        def step(_: str) -> None:
            nonlocal done
            done += 1
            advance(done)

        model = train_model(seed, quick=quick, jobs=jobs or -1, progress=step)
    save_model(model, out)
    loaded = load_model(out)  # what was written is what can be read
    if json:
        print_json({"out": str(out), "sha256": loaded.sha256, "seed": seed, "quick": quick,
                    "held_out": loaded.training["held_out"]})
    else:
        for kind, result in loaded.training["held_out"].items():
            _print_confusion(kind, result)
        note(f"wrote {out} (sha256 {loaded.sha256[:16]}...)")
    return 0


def _print_confusion(kind: str, result: dict[str, Any]) -> None:
    from rich.table import Table

    verdicts = ["healthy", "turn_short", "rotor_eccentricity", "unknown"]
    table = Table(title=f"held-out fleet, profile {kind}: runs by verdict", title_justify="left")
    table.add_column("injected")
    for verdict in verdicts:
        table.add_column(verdict, justify="right")
    for injected, counts in result["confusion"].items():
        table.add_row(injected, *(str(counts.get(v, 0)) for v in verdicts))
    console = stdout()
    console.print(table)
    for name, s in result["severity"].items():
        if not s["named"]:
            continue
        text = (
            f"{name}: median error {100 * s['median_relative_error']:.1f} % of the severity, "
            f"{100 * s['interval_coverage']:.1f} % of the 95 % intervals hold the truth, largest "
            f"called healthy {100 * s['largest_called_healthy']:.2f} %"
        )
        if "phase_right" in s:
            text += f", phase right in {100 * s['phase_right']:.1f} %"
        console.print(text, highlight=False)
