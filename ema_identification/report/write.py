"""The folder of an identification: the answer, whole or not at all, and then its page."""

from __future__ import annotations

import base64
import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from ema_identification.report.page import MODEL_FILE, NEXT_TEST_FILE, next_commands, page_context
from ema_identification.report.plots import draw_gap, draw_panel
from ema_identification.result import Identification
from ema_record.files import cannot_write, exists, make_new_directory, new_file, sync_directory

HTML_FILE = "report.html"
JSON_FILE = "identification.json"
PLOTS = "plots"
GAP_PLOT = "gap_by_stage"


def write_answer(identification: Identification, out_dir: str | Path) -> Identification:
    """Write the numbers into a new folder; return the identification with its model's path.

    The folder is made beside its place and renamed when all is in it, so a folder of this
    name holds a whole answer.

    Parameters
    ----------
    identification : the result of `identify`.
    out_dir : the folder to make: ``identification.json``, ``model.yaml`` if a model came out,
        ``next_test.yaml`` if a command is proposed.

    Raises
    ------
    OutputError
        The folder exists, or cannot be written.
    """
    out = Path(out_dir)
    if out.exists():
        raise exists(out)
    if identification.model_text:
        identification = replace(identification, model=out / MODEL_FILE)
    making = out.with_name(f".{out.name}.{os.getpid()}.tmp")
    make_new_directory(making)
    try:
        _write_files(making, identification)
        sync_directory(making)
        if out.exists():  # made by someone else meanwhile
            raise exists(out)
        making.rename(out)
        sync_directory(out.parent)
    except OSError as error:
        raise cannot_write(out, error) from None
    finally:
        shutil.rmtree(making, ignore_errors=True)
    return identification


class Page(NamedTuple):
    """The page that was written."""

    path: Path
    not_drawn: dict[str, str]
    """Pictures that failed, each with the reason; the page says so in their place."""


def write_page(
    identification: Identification,
    out_dir: str | Path,
    *,
    title: str,
    inputs: Mapping[str, Sequence[str]],
) -> Page:
    """Draw the plots and write the page into the folder of an answer.

    The same identification gives the same bytes. A picture that cannot be drawn is left out.

    Parameters
    ----------
    identification : the result of `identify`.
    out_dir : the folder that `write_answer` made; it gets ``report.html`` (self-contained) and
        ``plots/*.png``.
    title : headline of the page, for example the serial number.
    inputs : what was compared, by its role: ``{"measured": ["a", "b"], "model": ["nominal"]}``.

    Raises
    ------
    OutputError
        The folder cannot be written.
    """
    out = Path(out_dir)
    panels, unknown = identification.panels, identification.unknown
    if unknown is not None and unknown.panel.name not in {panel.name for panel in panels}:
        panels = (unknown.panel, *panels)
    drawings: dict[str, Callable[[], bytes]] = {GAP_PLOT: partial(draw_gap, identification)}
    drawings |= {panel.name: partial(draw_panel, panel) for panel in panels}
    pictures: dict[str, bytes] = {}
    not_drawn: dict[str, str] = {}
    for name, draw in drawings.items():
        try:
            pictures[name] = draw()
        except Exception as error:  # noqa: BLE001  (the answer is worth more than any picture)
            not_drawn[name] = f"{type(error).__name__}: {error}"
    page = _render(
        **page_context(identification, panels, title=title, inputs=inputs),
        commands=next_commands(identification, out, inputs), not_drawn=not_drawn,
        pictures={name: "data:image/png;base64," + base64.b64encode(png).decode("ascii")
                  for name, png in pictures.items()},
    )
    try:
        (out / PLOTS).mkdir()
        for name, png in pictures.items():
            (out / PLOTS / f"{name}.png").write_bytes(png)
        with new_file(out / HTML_FILE) as path:
            path.write_text(page, encoding="utf-8", errors="backslashreplace", newline="\n")
    except OSError as error:
        raise cannot_write(out, error) from None
    return Page(out / HTML_FILE, not_drawn)


def _write_files(folder: Path, identification: Identification) -> None:
    """Write everything but page and plots."""
    texts = {JSON_FILE: json.dumps(identification.to_dict(), indent=2, ensure_ascii=False) + "\n"}
    if identification.model_text:
        texts[MODEL_FILE] = identification.model_text
    if identification.next_profile is not None:
        profile = identification.next_profile.model_dump(mode="json", exclude_none=True)
        texts[NEXT_TEST_FILE] = yaml.safe_dump(profile, sort_keys=False, allow_unicode=True)
    for name, text in texts.items():
        with (folder / name).open(
                "w", encoding="utf-8", errors="backslashreplace", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())


def _render(**context: Any) -> str:
    """Return the page; all text is escaped but the style sheet, which is ours."""
    templates = files("ema_identification.report") / "templates"
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True,
                              lstrip_blocks=True)
    template = environment.from_string((templates / "report.html").read_text(encoding="utf-8"))
    style = (templates / "report.css").read_text(encoding="utf-8")
    return template.render(style=Markup(style), **context)  # noqa: S704  (a shipped file)
