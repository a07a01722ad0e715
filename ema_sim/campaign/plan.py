"""Campaign files: which runs of the emulated actuator to make, in YAML (docs/campaigns.md)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, field_validator

from ema_record.errors import UsageError, validated
from ema_record.yaml_file import load_yaml
from ema_sim.campaign.distributions import Distribution
from ema_sim.session import RATES

MAX_RUNS = 1_000_000
MAX_PARAMETERS = 200
MAX_PROFILES = 20
SEE = "docs/campaigns.md shows the form"
NAME = re.compile(r"^[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*){0,2}$")

ProfileName = Annotated[str, Field(min_length=1, max_length=4096)]
Setting = Distribution | float | str


class CampaignPlan(BaseModel):
    """A campaign: what is run, what varies, what is kept."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(default="campaign", pattern=r"^[A-Za-z0-9_.-]{1,64}$")
    profile: tuple[ProfileName, ...] = Field(min_length=1, max_length=MAX_PROFILES)
    """Test profiles, names or YAML files; several are taken in turn, like a grid."""
    seed: int = Field(default=0, ge=0, lt=1 << 63)
    runs: int | None = Field(default=None, ge=1, le=MAX_RUNS)
    """Number of runs; default all combinations of the grids."""
    rate: float | None = Field(default=None, ge=RATES[0], le=RATES[1])
    """Samples a second."""
    switching: bool = False
    """Simulate the edges of a carrier (drives pwm and foc), not the means of its periods."""
    model: str | None = Field(default=None, max_length=4096)
    """Model file that the runs start from, default the nominal actuator."""
    parameters: dict[str, Setting] = Field(default_factory=dict, max_length=MAX_PARAMETERS)
    """By dotted name: ``actuator.<part>.<name>``, ``<effect>.<parameter>``, ``noise``,
    ``start_angle``; a distribution or one value."""
    keep: str = Field(default="summary", max_length=200)
    """``summary`` or ``bags``."""

    @field_validator("profile", mode="before")
    @classmethod
    def _one_profile_is_a_list(cls, value: object) -> object:
        return (value,) if isinstance(value, str) else value

    @field_validator("parameters")
    @classmethod
    def _names_are_dotted(cls, value: dict[str, Setting]) -> dict[str, Setting]:
        for name in value:
            if not NAME.match(name):
                raise ValueError(f"{name[:60]!r} is no dotted name")
        return value


def load_plan(path: str | Path) -> CampaignPlan:
    """Return the plan in a campaign file.

    Raises
    ------
    UsageError
        The file cannot be read or is no plan; one line says where and why.
    """
    return plan_from(load_yaml(Path(path)), str(path))


def plan_from(data: object, where: str) -> CampaignPlan:
    """Validate `data` (as read from YAML); `where` names its origin in errors."""
    if not isinstance(data, dict):
        raise UsageError(f"{where}: expected 'profile:', 'runs:' and so on: {SEE}")
    return validated(CampaignPlan.model_validate, data, where, "campaign", SEE,
                     branch="Distribution")
