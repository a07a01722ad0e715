"""The contract of `contract.verdict_object` as pydantic models: they write its JSON Schema."""

from __future__ import annotations

import json
from typing import Annotated, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from ema_prognostics.verdict.contract import SCHEMA
from ema_prognostics.verdict.verdict import Measure, Outcome

Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Probability = Annotated[float, Field(ge=0.0, le=1.0)]
Level = Literal["small", "medium", "large"]


class _Object(BaseModel):
    model_config = ConfigDict(extra="allow")  # keys may be added


class FaultObject(_Object):
    """One fault."""

    fault_class: str
    phase: Literal["a", "b", "c"] | None
    severity: float | None
    severity_unit: str | None
    severity_interval: tuple[float, float] | None
    level: Level | None


class SymptomObject(_Object):
    """One number that speaks for a verdict."""

    feature: Annotated[str, Field(description="Its name.")]
    words: Annotated[str, Field(description="The same in words.")]
    measure: Annotated[Measure, Field(
        description="What 'times' counts: spreads of healthy units, or the guard's usual bound.")]
    times: Annotated[float, Field(description="How far off it is.")]
    value: Annotated[float | None, Field(description="Null: a distance of several features.")]
    unit: str
    healthy: Annotated[tuple[float, float] | None, Field(
        description="Range of 90 % of healthy units of the type.")]
    own: Annotated[tuple[float, float] | None, Field(
        description="The same of this unit, by its baseline; null: without one.")]


class KitObject(_Object):
    """The kit that judged."""

    name: str
    sha256: Sha256


class VerdictObject(_Object):
    """The verdict on one bag; the largest fault stands at the top too."""

    schema_: Annotated[Literal["ema_phm.verdict/1"], Field(alias="schema")]
    bag: str
    actuator: Annotated[str | None, Field(
        description="Its name among those of the aircraft; absent where it has none.")] = None
    verdict: Outcome
    fault_class: str | None
    phase: Literal["a", "b", "c"] | None
    severity: float | None
    severity_unit: str | None
    severity_interval: tuple[float, float] | None
    level: Level | None
    faults: list[FaultObject]
    alternatives: list[str]
    probabilities: dict[str, Probability]
    reasons: list[str]
    cause: Annotated[str | None, Field(
        description="Why there is no answer, in a word: 'unlike', 'doubt', 'record', or the name "
        "of a record check; null where there is one.")] = None
    evidence: Annotated[list[SymptomObject], Field(
        description="The numbers that say the most, largest first.")] = []
    side: Annotated[Literal["motor", "surface"] | None, Field(
        description="Of a friction that is found, where it is most likely.")] = None
    serial_number: str | None
    time: AwareDatetime | None
    profile: str | None
    record_sha256: Sha256 | None
    software_version: str
    model_sha256: Sha256
    kit: KitObject


def schema_text() -> str:
    """Return the JSON Schema, as `verdict.schema.json` holds it."""
    found = VerdictObject.model_json_schema(by_alias=True)
    return json.dumps({
        "$schema": "https://json-schema.org/draft/2020-12/schema", "$id": SCHEMA, **found,
    }, indent=1) + "\n"
