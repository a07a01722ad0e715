"""`ema paper`: the paper's experiment again, its tables beside ours."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from ema_cli.console import note, print_json, progress, stdout


def paper(
    seed: Annotated[int, typer.Option(
        min=0, max=2**31 - 1, help="Of start angles, noise and initial weights.")] = 1,
    quick: Annotated[bool, typer.Option(
        "--quick", help="One start angle and few draws, to try the way.")] = False,
    json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> int:
    """Repeat the paper's experiment, its numbers beside ours.

    Everything is simulated and trained anew; nothing is kept. The experiment is of the paper's
    actuator, the default one: another kit is left aside, and that is said. Exit status 0 whether
    or not a statement of the paper was reproduced.

    Example: `ema paper --json`
    """
    from ema_prognostics.paper.experiment import PaperSettings, run_experiment
    from ema_prognostics.paper.report import paper_report
    from ema_record.kit import is_default_kit, kit_name, using_kit

    if not is_default_kit():
        note(f"{kit_name()} is left aside: the paper's experiment is of the default actuator")
    settings = PaperSettings(seed=seed)
    if quick:
        settings = PaperSettings(
            seed=seed, train_angles=1, unseen_angles=1, train_draws=6, test_draws=4,
            unseen_draws=2, n_restarts=1,
        )
    with using_kit(None), progress("paper's experiment", settings.steps) as advance:
        done = 0

        def step(_: str) -> None:
            nonlocal done
            done += 1
            advance(done)

        experiment = run_experiment(settings, step)
    report = paper_report(experiment)
    if json:
        print_json(report)
    else:
        print_report(report)
    return 0


def print_report(report: dict[str, Any]) -> None:
    """Print the report of `paper_report` as tables."""
    console = stdout()
    settings = report["settings"]
    console.print(
        f"seed {settings['seed']}; start angles trained on: "
        + ", ".join(f"{a:.3f}" for a in settings["start_angles"]) + " rad; never seen: "
        + ", ".join(f"{a:.3f}" for a in settings["unseen_start_angles"]) + " rad.\n"
        "Noise: white, deviation 0, 2.5 and 5 % of the maximum in the window at 1 MS/s; a sample "
        "at 20 kS/s is a mean over its interval and has 1/√50 of that.\n"
        "The row at a cut belongs to both levels, as in the paper's target: either counts as "
        "right.\nOurs: mean output over noise draws and start angles."
    )
    for name, table in report["tables"].items():
        _print_table(name, table)
    _print_accuracies(report["accuracies"])
    _print_statements(report["statements"])


def _print_table(name: str, table: dict[str, Any]) -> None:
    from rich.table import Table

    columns = len(table["rows"][0]["ours"])
    view = Table(title=f"{name.replace('_', ' ')}: {table['title']}", title_justify="left")
    view.add_column(f"{table['extent']} (%)", justify="right")
    for source in ("paper", "ours"):
        for column in range(columns):
            view.add_column(f"{source} {column + 1}", justify="right")
    for row in table["rows"]:
        view.add_row(
            f"{row['extent_percent']:g}",
            *("-" if v is None else f"{v:.4f}" for v in [*row["paper"], *row["ours"]]),
        )
    stdout().print(view)


def _print_accuracies(accuracies: list[dict[str, Any]]) -> None:
    from rich.box import SIMPLE
    from rich.table import Table

    view = Table(title="accuracy on fresh noise draws (%)", title_justify="left", box=SIMPLE,
                 pad_edge=False, padding=(0, 1, 0, 0))
    for name in ("network", "angles", "draws", "all", "0 %", "2.5 %", "5 %", "target", "met"):
        view.add_column(
            name, justify="left" if name in ("network", "angles") else "right", no_wrap=True
        )
    for a in accuracies:
        view.add_row(
            _network_name(a), a["start_angles"], str(a["draws"]), f"{100 * a['accuracy']:.2f}",
            *(f"{100 * v['accuracy']:.1f}" for v in a["by_noise_level"].values()),
            f"{100 * a['target']:.1f}", "yes" if a["met"] else "no",
        )
    stdout().print(view)
    stdout().print(
        "SC: turn short, RE: rotor eccentricity. angles: of the rotor at the start, the same as "
        "in training or never seen. ANN_A must meet its target at each noise level."
    )


def _network_name(accuracy: dict[str, Any]) -> str:
    fault = "SC" if "turn_short" in accuracy["network"] else "RE"
    columns = accuracy["columns"]
    return f"ANN_B {fault}, {columns} col." if columns else f"ANN_A {fault}"


def _print_statements(statements: list[dict[str, Any]]) -> None:
    from rich.table import Table

    view = Table(title="the paper's statements, section V", title_justify="left")
    for name in ("section", "statement", "reproduced", "evidence"):
        view.add_column(name)
    for s in statements:
        view.add_row(s["section"], s["text"], "yes" if s["reproduced"] else "NO", s["evidence"])
    stdout().print(view)
