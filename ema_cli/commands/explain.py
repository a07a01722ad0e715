"""`ema explain`: what a fault, a reason, a check or a term of a verdict means, and what to do."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import typer

from ema_cli.console import print_json, stdout
from ema_cli.lines import TextLine, print_lines
from ema_cli.views.verdict import short
from ema_prognostics.words import CLASSES, feature_words, scaled, words
from ema_record.errors import UsageError, unknown_name

OUTCOMES = ("healthy", "unknown", "incomplete", "invalid")
TERMS = ("healthy_spread", "interval", "level", "probability", "baseline")
LIST = "'ema explain' lists them"
MOST_SAID = 4
"""Reasons that are named at most where several have the words given."""


def explain(
    name: Annotated[list[str] | None, typer.Argument(
        metavar="[FAULT|REASON|CHECK|TERM]",
        help="A name, or the words of a reason as the verdict has them.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Explain a fault, a reason, a record check or a term of a verdict.

    Without a name it lists what it can explain.

    Example: `ema explain turn_short`
    """
    found = explanation(" ".join(name)) if name else catalogue()
    if as_json:
        print_json({line.label: line.text for line in found if line.label} if not name else
                   {"name": " ".join(name), "text": [line.text for line in found]})
    else:
        print_lines(found, stdout())
    return 0


def catalogue() -> list[TextLine]:
    """Return the names that are explained, a kind a line."""
    say = words()
    kinds = {"finding": CLASSES, "term": (*OUTCOMES, *TERMS), "check": checks(),
             "reason": [*reasons(), *strangers()]}
    return [TextLine(say(f"explain.{kind}"), ", ".join(names)) for kind, names in kinds.items()]


def checks() -> list[str]:
    """Return the names of the record checks and of the rules of the guard."""
    return [name.replace(" ", "_") for name in words("en").below("check")]


def reasons() -> list[str]:
    """Return the names of the features that speak for a fault, lines and phases apart left out."""
    from ema_prognostics.verdict.evidence import RELEVANT

    known = [n for n in feature_names() if not n.endswith("_im")]
    return [n for n in known if any(key in n for keys in RELEVANT.values() for key in keys)]


def strangers() -> list[str]:
    """Return the names of what else a record may be most like."""
    return words("en").below("feature.stranger")


def feature_names() -> list[str]:
    """Return the names of the features of both tests, as the networks of the kit know them."""
    from ema_prognostics.cascade.model_file import load_model

    cascades = load_model().cascades
    return list(dict.fromkeys(
        n for key in sorted(cascades) if key.endswith("/fleet")
        for n in cascades[key].inputs.input_names))


def explanation(text: str) -> list[TextLine]:
    """Return the lines that explain a name; UsageError if it is not known."""
    say = words()
    name = "_".join(text.lower().replace("-", " ").split())
    if name in CLASSES:
        return list(_fault(name))
    if name in (*OUTCOMES, *TERMS):
        kind = "term" if name in TERMS else "verdict"
        found = [TextLine(say(f"explain.{kind}"), name.replace("_", " "), "bold"),
                 TextLine("", say(f"about.{name}"))]
        return found + ([TextLine(say("label.do"), say(f"do.{name}"))] if say.has(f"do.{name}")
                        else [])
    if name in checks():
        return list(_check(name))
    for stranger in strangers():
        seen = feature_words(f"stranger.{stranger}")
        if name == stranger or text.strip() == seen:
            return [TextLine(say("explain.reason"), f"{seen} ({stranger})", "bold"),
                    TextLine("", say("stranger_about"))]
    features = feature_names()
    same = [n for n in features if text.strip() in (n, feature_words(n), feature_words(n, "en"))]
    if not same:
        names = [*CLASSES, *OUTCOMES, *TERMS, *checks(), *strangers(), *features]
        by_title = {say(f"fault.{c}.title").lower(): c for c in CLASSES}
        if text.strip().lower() in by_title:
            return list(_fault(by_title[text.strip().lower()]))
        said = list(dict.fromkeys(w for w in map(feature_words, features) if text.strip() in w))
        if said:
            more = "; ..." if len(said) > MOST_SAID else ""
            raise UsageError(f"{text[:80]!r}: say which: {'; '.join(said[:MOST_SAID])}{more}")
        raise unknown_name("fault, reason, check or term", text[:80], names, LIST)
    return list(_reason(same))


def _fault(name: str) -> Iterator[TextLine]:
    from ema_prognostics.cascade.classes import levels_of
    from ema_prognostics.verdict.evidence import RELEVANT

    say = words()
    yield TextLine(say("explain.finding"), say(f"fault.{name}.title") + f" ({name})", "bold")
    yield TextLine("", say(f"about.{name}"))
    scale, unit = scaled(name)
    medium, large = (f"{short(scale * v)} {unit}" for v in levels_of(name))
    yield TextLine("", say("explain.levels", medium=medium, large=large))
    for other in say.below(f"alternative.{name}"):
        key = f"alternative.{name}.{other}"
        yield TextLine(say("label.sure"), say("sure.alternative", other=say(f"{key}.name"),
                                              measure=say(f"{key}.measure", phase="a|b|c")))
    if say(f"compare.{name}"):
        yield TextLine(say("label.sure"), say(f"compare.{name}"))
    for k, level in enumerate(("small", "medium", "large")):
        yield TextLine(say("label.do") if k == 0 else "",
                       f"{say(f'level.{level}').upper()}: {say(f'do.{name}.{level}')}")
    yield TextLine("", say("do.authority"))
    speaking = dict.fromkeys(
        feature_words(n) for n in feature_names() if any(key in n for key in RELEVANT[name]))
    yield TextLine(say("label.why"), say("explain.seen_in", features="; ".join(speaking)))


def _check(name: str) -> Iterator[TextLine]:
    from ema_record.checks.guard import OUTCOMES as EFFECTS
    from ema_record.checks.guard import RULES
    from ema_record.checks.live import rules_of

    say = words()
    key = f"check.{name}" if say.has(f"check.{name}") else f"check.{name.replace('_', ' ')}"
    yield TextLine(say("explain.check"), name.replace("_", " "), "bold")
    yield TextLine("", say(key))
    parts = [rule for rule in rules_of(name.replace("_", " ")) if rule != name]
    for part in parts:
        yield TextLine("", f"{part}: {say(f'check.{part}')}")
    for remedy in dict.fromkeys(rule.remedy for rule in RULES if rule.name == name):
        yield TextLine(say("label.do"), f"{remedy[0].upper()}{remedy[1:]}.")
    if name in EFFECTS:
        yield TextLine("", say("explain.effect", outcome=say(f"outcome.{EFFECTS[name]}")))


def _reason(names: list[str]) -> Iterator[TextLine]:
    from ema_prognostics.cascade.model_file import load_model
    from ema_prognostics.verdict.evidence import RELEVANT, healthy_range, unit_of

    say = words()
    known = f"{feature_words(names[0])} ({', '.join(names)})"
    yield TextLine(say("explain.reason"), known, "bold")
    yield TextLine("", say("feature_about"))
    for key, cascade in sorted(load_model().cascades.items()):
        test, view = key.split("/")
        if view != "fleet" or names[0] not in cascade.inputs.input_names:
            continue
        low, high = map(short, healthy_range(cascade.inputs, names[0]))
        unit = unit_of(names[0]).name
        yield TextLine("", f"{say('head.test', profile=test)}: {say('numbers.healthy')} "
                       f"{say('to', low=low, high=high)} {unit}".rstrip())
    spoken: list[str] = [say(f"fault.{c}.title") for c, keys in RELEVANT.items()
                         if any(key in names[0] for key in keys)]
    if spoken:
        yield TextLine("", say("explain.speaks_for", faults=", ".join(spoken)))
