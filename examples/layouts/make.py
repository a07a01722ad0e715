"""Layouts of Foxglove and PlotJuggler for the topics of one actuator.

    python examples/layouts/make.py [--namespace left_aileron] [--out FOLDER]

writes `foxglove.json` (Foxglove: Layout, Import from file; with the `foxglove-sdk` package) and
`plotjuggler.xml` (PlotJuggler: File, Load Layout). The ones beside this file are of no namespace.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

COLORS = ("#1f77b4", "#d62728", "#2ca02c")


class Curve(NamedTuple):
    """One line of a plot."""

    topic: str
    field: str
    """Of the message, as Foxglove writes it."""
    name: str
    """Of the joint, as PlotJuggler writes it; empty: the field."""
    label: str


class Plot(NamedTuple):
    """Lines that share an axis."""

    title: str
    curves: tuple[Curve, ...]


def _joint(index: int, name: str, what: str, label: str) -> Curve:
    return Curve("/ema/joint_states", f"{what}[{index}]", f"{name}/{what}", label)


PLOTS = (
    Plot("Surface (rad)", (
        Curve("/ema/command", "points[0].positions[0]", "points[0]/positions[0]",
              "first point of the command"),
        _joint(1, "surface", "position", "position"))),
    Plot("Motor speed (rad/s)", (_joint(0, "motor", "velocity", "motor"),)),
    Plot("Phase currents (A)", tuple(
        Curve("/ema/phase_currents", f"vector.{axis}", "", phase)
        for axis, phase in zip("xyz", "abc"))),
    Plot("Bus (V, A)", (Curve("/ema/dc_bus", "voltage", "", "voltage"),
                        Curve("/ema/dc_bus", "current", "", "current"))),
    Plot("Winding (degC)", (
        Curve("/ema/winding_temperature", "temperature", "", "temperature"),)),
)
VERDICT, INTERLOCK = "/ema/verdict", "/aircraft/weight_on_wheels"
PHASE = "/ema/phase"
"""In what `ema export --format mcap` writes."""


def topic_of(topic: str, namespace: str) -> str:
    """Return a topic under a namespace; the aircraft's own stay as they are."""
    return f"/{namespace}{topic}" if namespace and topic.startswith("/ema/") else topic


def foxglove(namespace: str = "") -> str:
    """Return the layout of Foxglove, JSON."""
    import foxglove.layouts as fl

    def series(curve: Curve, color: str) -> fl.PlotSeries:
        return fl.PlotSeries(value=f"{topic_of(curve.topic, namespace)}.{curve.field}",
                             label=curve.label, color=color, timestamp_method="publishTime")

    plots = [fl.SplitItem(proportion=2, content=fl.PlotPanel(
        title=plot.title, config=fl.PlotConfig(
            paths=[series(c, color) for c, color in zip(plot.curves, COLORS)],
            show_legend=True, is_synced=True))) for plot in PLOTS]
    states = fl.StateTransitionsPanel(title="Phases of the test, weight on wheels", config=(
        fl.StateTransitionsConfig(is_synced=True, paths=[
            fl.StateTransitionsSeries(value=f"{topic_of(PHASE, namespace)}.data", label="phase"),
            fl.StateTransitionsSeries(value=f"{INTERLOCK}.data", label="weight on wheels")])))
    verdict = fl.RawMessagesPanel(title="Verdict", config=fl.RawMessagesConfig(
        topic_path=topic_of(VERDICT, namespace)))
    layout = fl.Layout(content=fl.SplitContainer(direction="row", items=[
        fl.SplitItem(proportion=3, content=fl.SplitContainer(direction="column", items=[
            *plots, fl.SplitItem(proportion=1, content=states)])),
        fl.SplitItem(proportion=1, content=verdict)]))
    return json.dumps(json.loads(layout.to_json()), indent=1) + "\n"


def plotjuggler(namespace: str = "") -> str:
    """Return the layout of PlotJuggler, XML."""
    root = ET.Element("root")
    window = ET.SubElement(
        root, "tabbed_widget", name="Main Window", parent="main_window")
    tab = ET.SubElement(window, "Tab", tab_name="Built-in test", containers="1")
    splitter = ET.SubElement(
        ET.SubElement(tab, "Container"), "DockSplitter", orientation="-",
        count=str(len(PLOTS)), sizes=";".join([f"{1.0 / len(PLOTS):g}"] * len(PLOTS)))
    for plot in PLOTS:
        area = ET.SubElement(splitter, "DockArea", name=plot.title)
        box = ET.SubElement(area, "plot", style="Lines", mode="TimeSeries",
                                     flip_x="false", flip_y="false")
        ET.SubElement(box, "limitY")
        for curve, color in zip(plot.curves, COLORS):
            path = curve.name or curve.field.replace(".", "/")
            ET.SubElement(box, "curve", color=color,
                                   name=f"{topic_of(curve.topic, namespace)}/{path}")
    ET.SubElement(window, "currentTabIndex", index="0")
    ET.indent(root)
    return "<?xml version='1.0' encoding='UTF-8'?>\n" + ET.tostring(
        root, encoding="unicode") + "\n"


def main() -> None:
    """Write both files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--namespace", default="", help="of the actuator")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for name, text in (("foxglove.json", foxglove(options.namespace)),
                       ("plotjuggler.xml", plotjuggler(options.namespace))):
        (options.out / name).write_text(text, encoding="utf-8")
        print(options.out / name)


if __name__ == "__main__":
    main()
