"""`ema train`: the model file again, from nothing but the simulator and a seed."""

from __future__ import annotations

from json import dumps
from pathlib import Path
from typing import Annotated

import typer

from ema_cli.console import check_new_file, note, print_json, progress_of, stdout
from ema_cli.options import TrainingJobs


def train(
    out: Annotated[Path, typer.Option(
        "--out", "-o", metavar="FILE.json",
        help="New model file; one that exists is not touched.")],
    seed: Annotated[int, typer.Option(
        min=0, max=2**31 - 1, help="Of units, noise and initial weights.")] = 1,
    quick: Annotated[bool, typer.Option(
        "--quick", help="A small training in one to two minutes, to try the way.")] = False,
    jobs: TrainingJobs = -1,
    work: Annotated[Path | None, typer.Option(
        "--work", metavar="DIR", help="Folder that keeps what was simulated: a training that was "
        "stopped goes on.")] = None,
    model: Annotated[Path | None, typer.Option(
        "--model", metavar="FILE.yaml",
        help="Actuator around which the fleets spread: changes over the kit's.")] = None,
    json: Annotated[bool, typer.Option("--json", help="The validation as JSON.")] = False,
) -> int:
    """Train the cascade of networks and write its model file.

    The validation stands beside the model file, as Markdown and as JSON. The same seed gives the
    same bytes, on any number of processes. With --kit it is trained for that actuator; the kit
    takes it as its cascade.json.

    Example: `ema train --out model.json`
    """
    from ema_prognostics.cascade.model_file import load_model, save_model
    from ema_prognostics.training.report import validation_data, validation_report
    from ema_prognostics.training.train_model import train_model
    from ema_sim.model_file import load_model_file

    report, data = out.with_suffix(".validation.md"), out.with_suffix(".validation.json")
    check_new_file(out, report, data)
    actuator = None if model is None else load_model_file(model)
    with progress_of("training") as advance:
        trained = train_model(seed, quick=quick, jobs=jobs or -1, progress=advance, folder=work,
                              actuator=actuator)
    save_model(trained, out)
    loaded = load_model(out)  # what was written is what can be read
    text = validation_report(loaded)
    with report.open("x", encoding="utf-8") as file:
        file.write(text)
    with data.open("x", encoding="utf-8") as file:
        file.write(dumps(validation_data(loaded), indent=1) + "\n")
    if json:
        print_json({"out": str(out), "report": str(report), "sha256": loaded.sha256,
                    "seed": seed, "quick": quick, "held_out": loaded.training["held_out"]})
    else:
        print_report(text)
        note(f"wrote {out} (sha256 {loaded.sha256[:16]}...), {report} and {data}")
    return 0


def print_report(text: str) -> None:
    """Print Markdown: set on a terminal, as it is elsewhere."""
    from rich.markdown import Markdown

    console = stdout()
    console.print(Markdown(text) if console.is_terminal else text)
