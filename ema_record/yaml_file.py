"""Reading YAML that people wrote: bounded, without aliases, errors in one line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from ema_record.errors import UsageError
from ema_record.files import read_bounded

MAX_BYTES, MAX_DEPTH, MAX_DIGITS = 1 << 20, 50, 100
"""Largest file; deepest nesting of lists and mappings; most characters of a whole number, which
then is a float too, and can be said in an error."""

_Base: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _OurSafeLoader(_Base):
    """The safe loader, to which ``1e-3`` is a number as in YAML 1.2, not a text as in 1.1."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping of which no key stands there twice, however it is written."""
        found: dict[Any, Any] = super().construct_mapping(node, deep)
        if len(set(map(str, found))) < len(node.value):
            seen: set[object] = set()
            for part, _ in node.value:
                key = self.construct_object(part)
                if {key, str(key)} & seen:
                    raise _refused(f"{part.value[:60]!r} stands there twice", part)
                seen |= {key, str(key)}
        return found


_OurSafeLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+\Z"),
    list("-+.0123456789"))
_OTHER_BASE = re.compile(r"[-+]?(0[0-7_]+|[0-9][0-9_]*(:[0-5]?[0-9])+(\.[0-9_]*)?)\Z")
"""What YAML 1.1 takes for a number of base 8 or 60, and YAML 1.2 and people do not."""

_WHOLE = re.compile(r"[-+]?(0x[0-9a-fA-F_]+|0b[01_]+|[0-9_]+)\Z")


def load_yaml(path: Path) -> object:
    """Return what the YAML file holds (safe loader, no aliases, bounded size)."""
    try:
        text = read_bounded(path, MAX_BYTES).decode("utf-8")
    except UnicodeDecodeError:
        raise UsageError(f"{path}: not UTF-8 text: save it as plain YAML") from None
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror or error}: check the file name") from None
    return yaml_of(text, str(path))


def yaml_of(text: str, where: str) -> object:
    """Return what a YAML text holds, as `load_yaml`; `where` is for errors."""
    try:
        _check_structure(text)
        return yaml.load(text, Loader=_OurSafeLoader)  # noqa: S506  (a safe loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f" line {mark.line + 1}:" if mark is not None else ""
        what = getattr(error, "problem", None) or re.split(r"[\n;]", str(error))[0]
        raise UsageError(f"{where}:{line} malformed YAML: {what}") from None


def _check_structure(text: str) -> None:
    """Refuse what is not meant or not safe, before anything is built.

    That is aliases (exponential expansion), tags (constructors that fail in their own ways), deep
    nesting, a number that is not decimal or beyond all.
    """
    depth = 0
    for event in yaml.parse(text, Loader=_OurSafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise _refused("aliases are not allowed", event)
        tag = getattr(event, "tag", None)
        if tag is not None:
            raise _refused(f"the tag {tag[-60:]!r} is not allowed: leave it out", event)
        bare = event.value if isinstance(event, yaml.ScalarEvent) and event.implicit[0] else ""
        if _OTHER_BASE.match(bare):
            raise _refused(f"{bare[:60]!r} could be a number of base 8 or 60: write a decimal "
                           "one, or a text in quotes", event)
        if len(bare) > MAX_DIGITS and _WHOLE.match(bare):
            raise _refused(f"a number of {len(bare)} characters, at most {MAX_DIGITS}: write a "
                           "smaller one, or a text in quotes", event)
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise _refused(f"nested deeper than {MAX_DEPTH} levels", event)


def _refused(problem: str, event: yaml.Event | yaml.Node) -> yaml.MarkedYAMLError:
    """Return the error for something that YAML allows and we do not."""
    error = yaml.MarkedYAMLError(problem=problem)
    error.problem_mark = event.start_mark  # type: ignore[assignment]
    return error
