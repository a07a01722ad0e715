"""Effects as users write them: dotted names, checked against the catalogue."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ema_record.errors import UsageError, bounded, unknown_name
from ema_sim.effects.base import Choice
from ema_sim.effects.registry import EFFECTS, Effects

LISTED = "'ema effects' lists them"


def parse_effects(settings: Iterable[str], base: Effects | None = None) -> Effects:
    """Return the effects named by settings such as ``turn_short.fraction=0.1``.

    Parameters
    ----------
    settings : ``name.parameter=value``; a later one overrides an earlier one.
    base : effects to start from, default neutral.
    """
    values: dict[str, str] = {}
    for setting in settings:
        name, separator, value = setting.partition("=")
        if not separator or not value.strip():
            raise UsageError(
                f"effect {setting!r}: expected NAME.PARAMETER=VALUE, "
                "for example turn_short.fraction=0.1"
            )
        values[name.strip()] = value.strip()
    return effects_from_mapping(values, base)


def effects_from_mapping(values: Mapping[str, Any], base: Effects | None = None) -> Effects:
    """Return the effects of a mapping of dotted names to values (text, numbers).

    Nested mappings (as in YAML) serve too: ``{"turn_short": {"fraction": 0.1}}``.
    """
    effects = base if base is not None else Effects()
    for dotted, value in _flatten(values):
        name, _, parameter = dotted.partition(".")
        if name not in EFFECTS:
            raise unknown_name("effect", name, EFFECTS, LISTED)
        fields = {f.name: f for f in EFFECTS[name].fields}
        if not parameter:
            raise UsageError(f"effect {name!r}: name a parameter too: {', '.join(fields)}")
        if parameter not in fields:
            raise unknown_name(f"parameter of effect {name}", parameter, fields, LISTED)
        kind = fields[parameter].kind
        if isinstance(kind, Choice):
            checked: float | int = _option(dotted, value, kind)
        else:
            checked = bounded(dotted, value, kind.lower, kind.upper, kind.unit)
        effects = effects._replace(
            **{name: getattr(effects, name)._replace(**{parameter: checked})}
        )
    return effects


def _flatten(values: Mapping[str, Any]) -> Iterable[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            for parameter, inner in value.items():
                yield f"{name}.{parameter}", inner
        else:
            yield str(name), value


def _option(name: str, value: Any, kind: Choice) -> int:
    text = str(value)
    if text in kind.options:
        return kind.options.index(text)
    raise unknown_name(name, text, kind.options, f"choose one of {', '.join(kind.options)}")
