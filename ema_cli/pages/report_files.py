"""A test report as a page of A4, as XML in the manner of IEEE Std 1636.1, and as JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from ema_cli.pages import charts
from ema_cli.views.verdict import fault_size, short, times_text, title, verdict_lines
from ema_prognostics.cascade.classes import levels_of
from ema_prognostics.words import ENVIRONMENT, class_name, feature_words, scaled, words
from ema_record.errors import UsageError
from ema_record.files import new_file
from ema_record.record import Record

TONES = {"healthy": "#00704f", "fault": "#a83a00", "unknown": "#8a6100", "incomplete": "#8a6100",
         "invalid": "#7d3a78"}
MOST_NUMBERS = 6
"""Rows of evidence on the page."""
MOST_TRENDS = 2
NO_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")
"""Characters that no XML may hold (XML 1.0, section 2.2); a record's names may."""


def write_report_file(path: Path, data: Mapping[str, Any], record: Record) -> None:
    """Write a report in the format that the ending of a new file names.

    Raises
    ------
    UsageError
        The ending is none of `FORMS`.
    OutputError
        It exists, or cannot be written.
    """
    with new_file(path) as temporary:
        temporary.write_text(
            form_of(path)(data, record), encoding="utf-8", errors="backslashreplace")


def form_of(path: Path) -> Callable[[Mapping[str, Any], Record], str]:
    """Return what makes the text of a report file; UsageError for an ending not known."""
    form = FORMS.get(path.suffix.lower())
    if form is None:
        raise UsageError(f"--out {path}: {path.suffix or 'no ending'} is no form of a report: "
                         f"end the name with {', '.join(FORMS)}")
    return form


def as_json(data: Mapping[str, Any], _record: Record) -> str:
    """Return the report as JSON."""
    return json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def as_xml(data: Mapping[str, Any], _record: Record) -> str:
    """Return the report as XML: a result set with tests, test data, limits and outcomes."""
    unit, test, trace = data["unit"], data["test"], data["trace"]
    root = ET.Element("TestResults", format=data["format"], form=str(data["form"]))

    def add(parent: ET.Element, tag: str, text: object = None, /,
            **attributes: object) -> ET.Element:
        given = {k: str(v) for k, v in attributes.items() if v not in (None, "")}
        child = ET.SubElement(parent, tag, given)
        if text is not None:
            child.text = str(text)
        return child

    def add_faults(parent: ET.Element, faults: Iterable[Mapping[str, Any]]) -> None:
        for fault in faults:
            low, high = fault["severity_interval"] or (None, None)
            add(parent, "Fault", name=fault["fault_class"], phase=fault["phase"],
                severity=fault["severity"], unit=fault["severity_unit"], lower=low, upper=high,
                level=fault["level"])

    add(root, "Personnel", operator=unit["operator"])
    add(root, "WorkOrder", number=unit["work_order"], ataChapter=unit["ata"])
    add(root, "UUT", serialNumber=unit["serial_number"], type=unit["actuator_type"],
        aircraft=unit["aircraft"])
    results = add(root, "ResultSet", name=test["profile"], startDateTime=test["start_time"],
                  duration_s=test["duration_s"], samples=test["samples"], rate_hz=test["rate_hz"])
    add(results, "Outcome", value=data["outcome"])
    for check in data["checks"]:
        group = add(results, "Test", name=check["name"])
        add(group, "Outcome", value=check["outcome"])
        add(group, "Description", check["message"])
        for one in check["values"]:
            result = add(group, "TestResult", name=one["name"])
            add(add(result, "TestData"), "Datum", value=one["value"], unit=one["unit"])
            if one["limit"] is not None:
                add(add(result, "TestLimits"), "Limit", comparator="LE", value=one["limit"],
                    unit=one["unit"])
    verdict = data["verdict"]
    diagnosis = add(results, "Test", name="diagnosis")
    add(diagnosis, "Outcome", value=data["outcome"], qualifier=verdict["verdict"])
    add_faults(diagnosis, verdict["faults"])
    for name, value in verdict["probabilities"].items():
        add(diagnosis, "Probability", name=name, value=value)
    for e in verdict.get("evidence") or []:
        result = add(diagnosis, "TestResult", name=e["feature"])
        add(add(result, "TestData"), "Datum", value=e["value"], unit=e["unit"], times=e["times"])
        for role in ("healthy", "own"):
            if e[role]:
                limits = add(result, "TestLimits", name=role)
                add(limits, "Limit", comparator="GE", value=e[role][0], unit=e["unit"])
                add(limits, "Limit", comparator="LE", value=e[role][1], unit=e["unit"])
    for reason in verdict["reasons"]:
        add(diagnosis, "Reason", reason)
    for flight in data["trend"]:
        add_faults(add(root, "Flight", **{k: v for k, v in flight.items() if k != "faults"}),
                   flight["faults"])
    source = add(root, "Configuration", software=trace["software"], kit=trace["kit"],
                 softwareSha256=trace["software_sha256"], modelSha256=trace["model_sha256"])
    for file in trace["files"]:
        add(source, "File", **file)
    ET.indent(root)
    return NO_XML.sub("\ufffd", ET.tostring(
        root, encoding="unicode", xml_declaration=True)) + "\n"


def as_page(data: Mapping[str, Any], record: Record) -> str:
    """Return the report as a page that needs nothing else and prints on one sheet of A4."""
    source = files("ema_cli.pages").joinpath("templates", "test_report.html")
    page = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True).from_string(
        source.read_text(encoding="utf-8"))
    return page.render(**page_context(data, record))


def page_context(data: Mapping[str, Any], record: Record) -> dict[str, Any]:
    """Return the variables of the template."""
    import os

    say = words()
    verdict, unit, test = data["verdict"], data["unit"], data["test"]

    def text(name: str, **values: object) -> str:
        return say(f"report.{name}", **values)

    lines: list[tuple[str, str]] = []
    for line in verdict_lines(verdict):
        if line.label == say("label.why"):
            break
        if line.label is not None:  # not the findings, which stand above
            lines.append((line.label, line.text))
    return {
        "d": data, "t": text, "language": (os.environ.get(ENVIRONMENT) or "en")[:2],
        "tone": TONES[verdict["verdict"]], "outcome": say(f"outcome.{verdict['verdict']}"),
        "serial": unit["serial_number"] or say("head.no_serial"),
        "fields": [
            (text("serial"), unit["serial_number"]), (text("type"), data["trace"]["kit"]),
            (text("start"), test["start_time"][:19].replace("T", " ") + " UTC"
             if test["start_time"] else ""),
            (text("tested"), text("sizes", profile=test["profile"], samples=test["samples"],
                                  duration=f"{test['duration_s']:.3g}")),
            (text("ata"), unit["ata"]), (text("aircraft"), unit["aircraft"]),
            (text("work_order"), unit["work_order"]), (text("operator"), unit["operator"]),
        ],
        "findings": ["  ".join(filter(None, (
            title(f), fault_size(f), say(f"level.{f['level']}").upper() if f["level"] else "")))
            for f in verdict["faults"]],
        "lines": lines,
        "evidence": Markup(_evidence(verdict)), "trace": Markup(_trace(record)),  # noqa: S704
        "trends": [(name, Markup(chart)) for name, chart in _trends(data["trend"])],  # noqa: S704
        "no_trend": text("one_flight") if len(data["trend"]) < 2 else say("what.healthy"),
        "checks": [_check(check) for check in data["checks"]],
        "hashes": _hashes(data["trace"]), "version": data["trace"]["software"],
    }


def _evidence(verdict: Mapping[str, Any]) -> str:
    say = words()
    rows = [
        {**e, "text": feature_words(e["feature"]), "times": times_text(e["times"]),
         "shown": f"{short(e['value'])} {e['unit'].replace('of the mean torque', '')}".strip()}
        for e in (verdict.get("evidence") or [])[:MOST_NUMBERS] if e["value"] is not None
    ]
    if not rows:
        found = [f"{feature_words(e['feature'])}: {times_text(e['times'])}"
                 for e in verdict.get("evidence") or []]
        return "".join(f"<p>{Markup.escape(line)}</p>" for line in found)
    return charts.evidence(rows, {
        "title": say("report.evidence"), "healthy": say("report.healthy_band"),
        "own": say("report.own_band"), "measured": say("report.measured")})


def _trace(record: Record) -> str:
    from ema_cli.views.phases import phases_of

    say = words()
    measured = record.channel("surface_position")
    if len(record) < 2 or not np.isfinite(measured).all():
        return ""
    return charts.trace(
        record.time, record.profile.command(record.time), measured,
        phases_of(record.profile),
        {"title": say("report.tested"), "command": say("report.command"),
         "measured": say("report.surface")})


def _trends(flights: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Return a chart for each of the largest faults of the flights."""
    say = words()
    if len(flights) < 2:
        return []
    kinds = list(dict.fromkeys(
        (f["fault_class"], f["phase"]) for one in reversed(flights) for f in one["faults"]))
    found = []
    for name, phase in kinds[:MOST_TRENDS]:
        scale, unit = scaled(name)
        series = []
        for number, one in enumerate(flights, start=1):
            fault = next((f for f in one["faults"]
                          if (f["fault_class"], f["phase"]) == (name, phase)
                          and f["severity"] is not None), None)
            low, high = fault["severity_interval"] if fault else (None, None)
            series.append({
                "flight": number, "value": None if fault is None else scale * fault["severity"],
                "low": None if low is None else scale * low,
                "high": None if high is None else scale * high})
        levels = [(say(f"level.{level}"), scale * size)
                  for level, size in zip(("medium", "large"), levels_of(name))]
        label = class_name(name, phase)
        found.append((label, charts.trend(series, levels, {
            "title": label, "unit": unit, "flight": say("report.flights")})))
    return found


def _check(check: Mapping[str, Any]) -> dict[str, Any]:
    say = words()
    word = {"Passed": "passed", "Inconclusive": "unusual", "Failed": "failed"}[check["outcome"]]
    limits = [
        f"≤ {1e3 * one['limit']:.3g} mrad" if one["unit"] == "rad" else
        f"≤ {one['limit']:.3g} {one['unit']}".rstrip()
        for one in check["values"] if one["limit"] is not None
    ]
    return {"name": check["name"], "message": check["message"], "limit": ", ".join(limits),
            "outcome": say(f"report.{word}"), "bad": word != "passed"}


def _hashes(trace: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [(trace["software"], trace["software_sha256"]),
            *((f"{one['role']}: {one['file']}", one["sha256"]) for one in trace["files"])]


FORMS: dict[str, Callable[[Mapping[str, Any], Record], str]] = {
    ".html": as_page, ".xml": as_xml, ".json": as_json}
"""By the ending of a file's name."""
