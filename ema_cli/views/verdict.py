"""A verdict for a person: what it is, how sure, what to do, why, and what to run next."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ema_cli.console import neutral, styled, unicode_output
from ema_cli.lines import INDENT, NO_BREAK, TextLine, print_lines, wrapped
from ema_prognostics.words import (
    STRANGER,
    feature_words,
    look_alike,
    name_of,
    scaled,
    step_kind,
    words,
)
from ema_record.kit import kit_option

if TYPE_CHECKING:
    from rich.console import Console

STYLES = {
    "healthy": "bold green", "fault": "bold red", "unknown": "bold yellow",
    "incomplete": "bold yellow", "invalid": "bold magenta",
}
BAR = 8
"""Longest bar of a reason (characters)."""
LOGARITHMIC = 100.0
"""Times the healthy spread of the longest bar; the scale is logarithmic."""
Facts = Mapping[str, Any]


def print_verdict(
    verdict: Facts, heading: Facts, console: Console, *, verbose: bool = False,
    quiet: bool = False,
) -> None:
    """Print a verdict.

    Parameters
    ----------
    verdict : the JSON object of ``ema check --json``.
    heading : of `Examination.heading`; empty: not known.
    console : where to; its width is kept to.
    verbose : with the numbers.
    quiet : the first line alone.
    """
    outcome = str(verdict["verdict"])
    say = words()
    head = ("  ".join([neutral(part) for part in heading_parts(verdict, heading)]))
    name = say(f"outcome.{outcome}")
    for k, text in enumerate(wrapped(head, console.width - len(name) - INDENT)):
        first = (name, STYLES.get(outcome, "bold")) if k == 0 else " " * len(name)
        console.print(styled(first, f"{' ' * INDENT}{text}"), soft_wrap=True)
    if quiet:
        return
    lines = list(verdict_lines(verdict))
    unusual = [c for c in heading.get("checks", ()) if c["level"] > 0]
    for k, check in enumerate(() if verbose else unusual):
        lines.append(TextLine(say("label.checks") if k == 0 else "",
                              f"{check['name']}: {check['message']}"))
    if verbose:
        lines += numbers(verdict, heading)
    lines += last_lines(verdict, heading)
    print_lines(lines, console)


def heading_parts(verdict: Facts, heading: Facts) -> list[str]:
    """Return unit, time, test and completeness; of an unreadable bag its path alone."""
    say = words()
    if not heading.get("profile"):
        return [str(verdict.get("bag") or "")]
    checks = heading["checks"]
    good = sum(check["level"] == 0 for check in checks)
    key = "complete" if verdict["verdict"] not in ("incomplete", "invalid") else "not_complete"
    time = heading["start_time"][:16].replace("T", NO_BREAK)
    return [
        *filter(None, [verdict.get("actuator")]),
        heading["serial_number"] or say("head.no_serial"),
        f"{time}{NO_BREAK}UTC" if time else say("head.no_time"),
        say("head.test", profile=heading["profile"]) + ", "
        + say(f"head.{key}", passed=good, all=len(checks)),
    ]


def verdict_lines(verdict: Facts) -> Iterable[TextLine]:
    """Return what is found, how sure it is, what to do and why."""
    say = words()
    yield from _findings(verdict)
    outcome, faults = verdict["verdict"], verdict["faults"]
    yield from (TextLine(say("label.what"), text) for text in _what(verdict))
    for k, text in enumerate(_sure(verdict)):
        yield TextLine(say("label.sure") if k == 0 else "", text)
    if outcome == "fault":
        advice = [say(f"do.{f['fault_class']}.{f['level']}") for f in faults if f["level"]]
    else:
        advice = [step(verdict)]
    if outcome == "healthy" and verdict["alternatives"]:
        advice = [say("alternative.healthy.measure") + "."]
    if advice:
        yield TextLine(say("label.do"), " ".join(dict.fromkeys(filter(None, advice))))
    yield from _why(verdict)


def _findings(verdict: Facts) -> Iterable[TextLine]:
    """Return each fault with its size, interval and level."""
    say = words()
    titles = [title(f) for f in verdict["faults"]]
    wide = max(map(len, titles), default=0)
    for text, fault in zip(titles, verdict["faults"]):
        level = say(f"level.{fault['level']}").upper() if fault["level"] else ""
        parts = [text.ljust(wide), fault_size(fault), level]
        yield TextLine(None, "   ".join(filter(None, parts)), "bold")


def title(fault: Facts) -> str:
    """Return a fault with its phase: ``Shorted turns, phase b``."""
    say = words()
    name = say(f"fault.{fault['fault_class']}.title") or name_of(fault["fault_class"])
    return name + (say("phase", phase=fault["phase"]) if fault["phase"] else "")


def fault_size(fault: Facts) -> str:
    """Return size and interval: ``9.8 % of the turns (9.1 to 10.5)``."""
    if fault["severity"] is None:
        return ""
    scale, unit = scaled(fault["fault_class"], fault["severity_unit"])
    text = f"{short(scale * fault['severity'])} {unit}"
    if fault["severity_interval"]:
        low, high = (short(scale * v) for v in fault["severity_interval"])
        text += f" ({words()('to', low=low, high=high)})"
    return text


def short(value: float) -> str:
    """Return a number with three digits at most, not in powers of ten where it is plain."""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def _what(verdict: Facts) -> list[str]:
    """Return what an answer without a fault means; nothing for a fault."""
    say = words()
    if verdict["verdict"] == "fault":
        return []
    if verdict["verdict"] == "healthy":
        return [say("what.healthy")]
    cause = verdict.get("cause") or "record"
    others = ", ".join(map(name_of, verdict["alternatives"]))
    if cause in ("record", "not_done") or not say.has(f"what.{cause}"):
        problem = "; ".join(r for r in verdict["reasons"][:1])
        bag = f"{verdict.get('bag')}: "
        return [say("what.record", problem=problem.removeprefix(bag))]
    like = most_like(verdict)
    return [say(f"what.{cause}_stranger" if like else f"what.{cause}", others=others, like=like)]


def most_like(verdict: Facts) -> str:
    """Return in words what a record is most like that is of no known fault; empty: of nothing."""
    first = next(iter(verdict.get("evidence") or []), {"feature": ""})["feature"]
    return feature_words(first) if first.startswith(f"{STRANGER}.") else ""


def _sure(verdict: Facts) -> list[str]:
    """Return how sure the verdict is, what else it could be, and what decides."""
    say = words()
    outcome, p = verdict["verdict"], verdict["probabilities"]
    faults, others = verdict["faults"], verdict["alternatives"]
    if outcome == "healthy":
        found = [say("sure.healthy", percent=percent(p["healthy"]))]
        if others:
            found += [say("sure.not_ruled_out", others=", ".join(map(name_of, others)))]
        return [" ".join(found)]
    if outcome == "unknown" and others:
        return [say("sure.most_like", others=", ".join(
            f"{name_of(name)} {percent(p[name])} %" for name in others if name in p))]
    if outcome != "fault":
        return []
    found = []
    for fault in faults:
        name = fault["fault_class"]
        text = say("sure.fault", percent=percent(p[name])) if name in p else ""
        for other in others:
            key = f"alternative.{name}.{other}"
            if say.has(f"{key}.measure"):
                text += " " + say(
                    "sure.alternative", other=look_alike([name], other),
                    measure=say(f"{key}.measure", phase=fault["phase"] or ""))
        if name == "friction" and verdict.get("side"):
            text += " " + say("sure.friction_side", side=say(f"side.{verdict['side']}"))
        key = f"compare.{name}"
        if any(e.get("own") for e in verdict["evidence"]) and say.has(f"{key}_since"):
            key += "_since"
        found.append(f"{text} {say(key)}".strip())
    several = len(faults) > 1
    return [f"{title(f)}: {t}" if several else t
            for f, t in zip(faults, found)]


def percent(probability: float) -> str:
    """Return a probability in percent; never 0 or 100, which nothing is."""
    return f"{min(99.0, max(1.0, 100.0 * probability)):.0f}"


def step(verdict: Facts) -> str:
    """Return what to do about an answer that is no fault."""
    say = words()
    outcome, cause = verdict["verdict"], verdict.get("cause") or ""
    if outcome == "unknown" and cause == "unlike":
        kind = step_kind(verdict["evidence"][0]["feature"]) if verdict["evidence"] else ""
        kind = STRANGER if most_like(verdict) else kind
        return say(f"do.unlike_{kind}" if kind else "do.unlike")
    for key in (cause, "sensor" if outcome == "unknown" else outcome):
        if say.has(f"do.{key}"):
            return say(f"do.{key}")
    return ""


def _why(verdict: Facts) -> Iterable[TextLine]:
    """Return the strongest reasons, with how far off each is and a bar."""
    say = words()
    found = verdict.get("evidence") or []
    if not found:
        return
    measure = found[0]["measure"]
    key = "none" if verdict["verdict"] == "healthy" else "bound" if measure == "bound" else "fault"
    yield TextLine(say("label.why"), say(f"why.{key}"))
    amounts = [times_text(e["times"]) for e in found]
    wide = max(map(len, amounts))
    for amount, evidence in zip(amounts, found):
        yield TextLine("", feature_words(evidence["feature"]), "",
                       f"{amount.rjust(wide)} {bar(abs(evidence['times']), measure)}")


def times_text(times: float) -> str:
    """Return how many times, in two digits: ``24 x``, ``1.4 x``."""
    return f"{abs(times):.{0 if abs(times) >= 9.95 else 1}f} x"


def bar(times: float, measure: str = "healthy") -> str:
    """Return a bar for how many times the healthy spread, or the bound, a number is off."""
    most = LOGARITHMIC if measure == "healthy" else 10.0
    share = math.log1p(times) / math.log1p(most)
    return ("▇" if unicode_output() else "#") * max(1, min(BAR, round(BAR * share)))


def numbers(verdict: Facts, heading: Facts) -> Iterable[TextLine]:
    """Return what -v adds: probabilities, values beside those of healthy units, checks."""
    say = words()
    found = [f"{name_of(name)} {100 * p:.1f} %" for name, p in verdict["probabilities"].items()]
    if found:
        yield TextLine(say("label.numbers"), say("numbers.probabilities") + " " + ", ".join(found))
    for e in verdict.get("evidence") or []:
        if e["value"] is not None:
            text = f"{feature_words(e['feature'])}: {short(e['value'])} {e['unit']}".rstrip()
            for key in ("healthy", "own"):
                if e[key]:
                    low, high = map(short, e[key])
                    text += f"; {say(f'numbers.{key}')} {say('to', low=low, high=high)}"
            yield TextLine("", text)
    known = tuple(e["words"] for e in verdict.get("evidence") or [])
    for reason in verdict["reasons"]:
        if not reason.startswith(known or " "):
            yield TextLine("", reason)
    for check in heading.get("checks", ()):
        yield TextLine("", f"{check['name']}: {check['message']}")
    if verdict["verdict"] == "fault":
        yield TextLine("", say("do.authority"))


def last_lines(verdict: Facts, heading: Facts) -> Iterable[TextLine]:
    """Return the next commands, the record, and the versions that judged."""
    say = words()
    bag = str(verdict.get("bag") or "")
    if bag:
        for k, command in enumerate(next_commands(verdict, heading)):
            yield TextLine(say("label.next") if k == 0 else "", command.replace(" ", NO_BREAK))
        yield TextLine(say("label.record"), bag.replace(" ", NO_BREAK), "dim")
    if heading:
        yield TextLine("", say("head.versions", version=heading["software_version"],
                               model=heading["model"][:12], kit=heading["kit"]), "dim")


def next_commands(verdict: Facts, heading: Facts) -> list[str]:
    """Return the commands to run next, at most two, with the kit and what `heading` has given."""
    bag = shlex.quote(str(verdict["bag"])) + kit_option()
    given = heading.get("given", "")
    outcome, cause = verdict["verdict"], verdict.get("cause") or ""
    name = heading.get("serial_number") or Path(str(verdict["bag"])).name or "report"
    page = re.sub(r"[^\w.-]+", "_", name) + ".html"
    report = f"ema report {bag}{given} --out {page}"
    if outcome == "fault":
        return [report, f"ema explain {verdict['faults'][0]['fault_class']}"]
    if outcome == "healthy":
        return [report]
    if outcome == "unknown" and cause.startswith("unlike"):
        return [f"ema lint {bag}", f"ema identify {bag} --out why"]
    if cause == "rig":
        return [f"ema identify {bag} --check", f"ema identify {bag} --out why"]
    if outcome == "incomplete" and cause == "record":  # a bag that can be read is whole
        return [f"ema recover {bag}"]
    rule = words().has(f"check.{cause}")
    return [f"ema lint {bag}", f"ema explain {cause if rule else outcome}"]
