"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Commanded = Annotated[str | None, typer.Option(
    "--profile", help="The test that was commanded (name or YAML file), in place of a bag's own.")]
Cascade = Annotated[Path | None, typer.Option(
    "--model", help="Model file of 'ema train', in place of the kit's.")]
Baseline = Annotated[Path | None, typer.Option(
    "--baseline", metavar="BAG", help="A healthy bag of the same actuator and test, from its "
    "acceptance: sharpens a verdict.")]
Effect = Annotated[list[str] | None, typer.Option(
    "--effect", "-e", metavar="NAME.PARAMETER=VALUE",
    help="Effect to hide in the simulated actuator; repeatable. 'ema effects' lists them.")]
Changes = Annotated[Path | None, typer.Option(
    "--model", metavar="FILE.yaml",
    help="Actuator parameters and effects: changes over the kit's.")]
Seed = Annotated[int, typer.Option(
    "--seed", help="Of noise and start angle; same seed, same bytes.")]
Noise = Annotated[float, typer.Option("--noise", help="Factor on the sensor noise, 0 for none.")]
Rule = Annotated[str, typer.Option(
    metavar="K/N", help="A fault is confirmed when K of the last N flights find it.")]
Format = Annotated[str, typer.Option(
    "--format", metavar="text|json|csv", help="json: one object a line, see docs/api.md; csv: a "
    "row a fault, with a header.")]
SerialNumber = Annotated[str, typer.Option(
    "--serial-number", metavar="TEXT", help="Of the actuator.")]
TrainingJobs = Annotated[int, typer.Option(
    "--jobs", min=-1, max=256, help="Processes that simulate, -1 for all cores.")]
