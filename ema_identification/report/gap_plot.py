"""The gap on the held-out record, before and after each addition, against the noise floor."""

from __future__ import annotations

from ema_identification.identification import Identification
from ema_identification.report.plots import INK, ROLES, new_figure, to_png
from ema_identification.report.words import number, pretty


def gap_stages(identification: Identification) -> list[tuple[str, float]]:
    """Return the gap of the given model and after each effect that was added."""
    stages = [("model as given,\nrecalibrated" if identification.recalibrated
               else "model as given", identification.gap_before)]
    findings = identification.findings
    for place, finding in enumerate(findings):
        last = place == len(findings) - 1
        gap = identification.gap_after if last else finding.gap_after
        stages.append((f"+ {pretty(finding.effect)}", gap))
    return stages


def draw_gap(identification: Identification) -> bytes:
    """Return the PNG: one bar a stage, the noise floor as a line."""
    stages = gap_stages(identification)
    height = 1.35 + 0.42 * len(stages)
    figure, axes = new_figure(
        "Gap between model and measurement on held-out data, against the noise floor",
        (5.8, height))
    places = list(range(len(stages)))[::-1]
    values = [value for _, value in stages]
    colours = [ROLES["before"]["color"]] + [ROLES["after"]["color"]] * (len(stages) - 1)
    axes.barh(places, values, height=0.58, color=colours, zorder=3)
    limit = 1.16 * max(*values, identification.noise_floor, 1e-300)
    for place, value in zip(places, values):
        axes.text(value + 0.012 * limit, place, number(value), va="center", fontsize=8.5,
                  color=INK, zorder=6,
                  bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8})
    axes.axvline(identification.noise_floor, color=INK, linewidth=1.2, linestyle=(0, (4, 2)),
                 zorder=5, label=f"noise floor {number(identification.noise_floor)}")
    axes.set_yticks(places, [name for name, _ in stages], fontsize=8.5, color=INK,
                    parse_math=False)
    axes.set_xlim(0.0, limit)
    axes.set_xlabel(identification.gap_unit, fontsize=8.5, color=INK, parse_math=False, wrap=True)
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.legend(fontsize=8, loc="lower right", frameon=True, framealpha=0.85, edgecolor="none")
    return to_png(figure)
