"""Reading YAML that people wrote: bounded, without aliases, errors in one line."""

from __future__ import annotations

from pathlib import Path

import yaml

from ema_record.errors import UsageError


def load_yaml(path: Path, *, max_bytes: int = 1 << 20) -> object:
    """Return what the YAML file holds (safe loader, no aliases, bounded size)."""
    try:
        if path.stat().st_size > max_bytes:
            raise UsageError(f"{path}: {path.stat().st_size} bytes, at most {max_bytes}")
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise UsageError(f"{path}: not UTF-8 text: save it as plain YAML") from None
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror or error}: check the file name") from None
    try:
        return yaml.load(text, Loader=_StrictLoader)  # noqa: S506  (a safe loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f" line {mark.line + 1}:" if mark is not None else ""
        what = getattr(error, "problem", None) or str(error).split("\n")[0]
        raise UsageError(f"{path}:{line} malformed YAML: {what}") from None


class _StrictLoader(yaml.SafeLoader):
    """Safe loader without aliases (no exponential expansion)."""

    def compose_node(self, parent, index):
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark
            raise yaml.composer.ComposerError(None, None, "aliases are not allowed", mark)
        return super().compose_node(parent, index)
