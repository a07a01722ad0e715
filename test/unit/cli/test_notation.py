"""The notation table names every parameter of the actuator, with its unit, and no other."""

import re
from typing import get_args, get_type_hints

from ema_record.actuator import Actuator
from ema_sim.effects import EFFECTS


def rows(text, heading):
    """Return the rows of the table below a heading: code and unit."""
    table = text.split(f"## {heading}\n")[1].split("\n## ")[0]
    cells = [[c.strip() for c in line.strip("|").split("|")]
             for line in table.splitlines() if line.startswith("|")][2:]
    return {name: row[3] for row in cells for name in re.findall(r"`([\w.]+)`", row[1])}


def test_parameters_and_units_are_those_of_the_code(repository):
    text = (repository / "docs" / "notation.md").read_text(encoding="utf-8")
    expected = {}
    for section, part in get_type_hints(Actuator).items():
        for name, hint in get_type_hints(part, include_extras=True).items():
            field = next(note for note in get_args(hint)[1:] if hasattr(note, "json_schema_extra"))
            unit = field.json_schema_extra["unit"]
            expected[f"{section}.{name}"] = unit
    assert rows(text, "Parameters") == expected


def test_faults_and_units_are_those_of_the_catalogue(repository):
    text = (repository / "docs" / "notation.md").read_text(encoding="utf-8")
    for dotted, unit in rows(text, "Faults").items():
        effect, name = dotted.split(".")
        (field,) = [f for f in EFFECTS[effect].fields if f.name == name]
        assert field.kind.unit == unit
