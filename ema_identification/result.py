"""`Identification`: what the workflow found, the same for an actuator and for a rig."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from ema_record.profile import Profile
from ema_record.record import html_of

Outcome = Literal[
    "no disagreement", "explained", "partly explained", "unknown effect", "contradicted"]
"""``contradicted``: what explains the fitted records makes the held-out ones worse, or hardly
better (`after_validation`)."""
INTERVAL_LEVEL = 0.9
"""Probability that the interval of a parameter is meant to hold."""


def after_validation(
    verdict: Outcome, before: float, after: float, bound: float, whose: str,
    enough: float = math.inf,
) -> tuple[Outcome, tuple[str, ...]]:
    """Return what validation records leave of a verdict, and what there is to say of their gap.

    Effects that should close a share of the gap are contradicted by one that grew, or that lost
    less and is beyond what the model's own runs leave; one that lost enough and is beyond it is
    explained in part. Of others a gap within that says nothing, whether it grew or fell; beyond it
    one that grew contradicts them, and a record is only explained where it fell.

    Parameters
    ----------
    verdict : of the fitted records.
    before, after : gap on the validation records, of the model as given and with what was found.
    bound : what the model's own runs leave in 95 % of all cases; NaN where that is not known.
    whose : noise `bound` is, in words.
    enough : gap that effects which close a share of it may leave; infinite: they need not.
    """
    named = verdict in ("explained", "partly explained")
    if named and bound < after <= before and not math.isinf(enough):
        verdict, only = ("partly explained", "") if after <= enough else ("contradicted", " only")
        return verdict, (f"the gap on the held-out records fell from {before:.3g} to "
                         f"{after:.3g}{only}; the noise of {whose} reaches {bound:.3g}",)
    if not named or after < before:
        return verdict, ()
    grew = f"the gap on the held-out records grew from {before:.3g} to {after:.3g}"
    if after <= bound and math.isinf(enough):
        return verdict, (f"{grew}, within the noise of {whose} (up to {bound:.3g})",) * (
            after > before)
    if after > before:
        return "contradicted", (f"{grew}; the noise of {whose} reaches {bound:.3g}",)
    return "partly explained", ("the gap on the held-out records did not fall",)


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """A number that was estimated, with its interval of `INTERVAL_LEVEL`."""

    name: str
    """Dotted, as on the command line: ``cogging_torque.amplitude``."""
    value: float
    low: float
    high: float
    unit: str

    def to_dict(self) -> dict[str, Any]:
        """Return the object of the JSON contract."""
        return {"name": self.name, "value": self.value, "interval": [self.low, self.high],
                "unit": self.unit}


@dataclass(frozen=True, slots=True, kw_only=True)
class Where:
    """Where a disagreement lives."""

    signal: str
    """Of the port: ``motor torque``, ``phase current a``, ``input force``."""
    against: str
    """``rotor angle``, ``speed``, ``load``, ``frequency``, ``position`` or ``test phase``."""
    text: str
    """In words, with numbers and units."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """One effect that was tried, and how well it did."""

    effect: str
    score: float
    """What it leaves: of the actuator, misfit of the fitted record (standard deviations); of a
    rig, held-out gap in the unit of `Identification.noise_floor`."""
    p_value: float
    """Of the hypothesis that it adds nothing."""
    reason: str = ""
    """Why it was taken or left."""


class Formula(NamedTuple):
    """The law that was fitted."""

    meaning: str
    equation: str
    """Its symbols are those of the parameters that are given."""
    reference: str


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedEffect:
    """One effect that the model lacks, in the order found."""

    effect: str
    equivalent: tuple[str, ...]
    """Other names that the data cannot tell apart; may be empty."""
    parameters: tuple[Parameter, ...]
    where: Where
    p_value: float
    """Of the hypothesis that it adds nothing to the model with all others."""
    gap_before: float
    gap_after: float
    formula: Formula
    choices: Mapping[str, str] = field(default_factory=dict)
    """Parameters that are no numbers, dotted: ``turn_short.phase`` is ``b``."""
    candidates: tuple[Candidate, ...] = ()
    """All that were compared at this step, best first."""

    def to_dict(self) -> dict[str, Any]:
        """Return the object of the JSON contract."""
        return {
            "effect": self.effect, "equivalent": list(self.equivalent),
            "parameters": [p.to_dict() for p in self.parameters], "choices": dict(self.choices),
            "equation": self.formula.equation,
            "where": asdict(self.where), "p_value": self.p_value,
            "gap_before": self.gap_before, "gap_after": self.gap_after,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """One line or one cloud of points of a plot."""

    label: str
    x: np.ndarray
    y: np.ndarray
    role: Literal["measured", "before", "after", "floor", "other"] = "other"
    style: Literal["line", "points"] = "line"


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One plot as data; `ema_identification.report` draws it."""

    name: str
    """Of its file: short, with ``_``."""
    title: str
    """A whole sentence that says what one sees."""
    x_label: str
    """With unit."""
    y_label: str
    curves: tuple[Curve, ...]
    step: str
    """The step of the workflow that it belongs to, a key of `Identification.steps`."""
    log_y: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """What one step of the workflow did, for people."""

    name: str
    """``align``, ``recalibrate``, ``where``, ``name``, ``add``, ``show``, ``prune``."""
    text: str
    rows: tuple[tuple[str, ...], ...] = ()
    """A table, its first row the headings; may be empty."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """What is known of an effect that the catalogue does not hold."""

    port: str
    text: str
    """``motor torque, periodic in rotor angle, 12 a turn, 0.011 N m``."""
    panel: Panel


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification:
    """Result of `identify`."""

    verdict: Outcome
    gap_before: float
    gap_after: float
    noise_floor: float
    gap_unit: str
    """What the three numbers above are, in words, with unit."""
    held_out: bool = True
    """Whether they are of data that took no part in the fit."""
    machine: Literal["actuator", "rig"] = "actuator"
    findings: tuple[NamedEffect, ...] = ()
    rivals: tuple[Candidate, ...] = ()
    next_test: str | None = None
    """The excitation that would separate what is still ambiguous: a profile or a measure."""
    next_profile: Profile | None = None
    """The command of `next_test`, where it is one that the actuator can be given as it is."""
    model: Path | None = None
    recalibrated: tuple[Parameter, ...] = ()
    """Parameters moved within their tolerances before anything was named; of a rig all of the
    model's own, as fitted with what was found."""
    unexplained: float | None = None
    """Of a rig: share of the input, rms about its mean, that is left where the gap is measured."""
    unknown: Shape | None = None
    reasons: tuple[str, ...] = ()
    steps: tuple[Step, ...] = ()
    panels: tuple[Panel, ...] = ()
    model_text: str = ""
    """The updated model file (YAML)."""
    since: Identification | None = None
    """What has changed since the unit was accepted, where records of then are given."""

    @property
    def exit_status(self) -> int:
        """0 no disagreement or explained, 3 partly explained, unknown or contradicted."""
        return 0 if self.verdict in ("no disagreement", "explained") else 3

    def __repr__(self) -> str:
        """Return one line: what was found, and the gap."""
        named = ", ".join(f"{p.name} = {p.value:.4g}" for f in self.findings for p in f.parameters)
        return (f"<Identification {self.verdict}{': ' if named else ''}{named}; gap "
                f"{self.gap_before:.3g} to {self.gap_after:.3g}>")

    def _repr_html_(self) -> str:
        return html_of(repr(self)[1:-1], (
            *((p.name, f"{p.value:.5g} ({p.low:.5g} to {p.high:.5g}) {p.unit}")
              for f in self.findings for p in f.parameters),
            *(("reason", reason) for reason in self.reasons)))

    def to_dict(self) -> dict[str, Any]:
        """Return the object that ``ema identify --json`` prints."""
        return {
            "verdict": self.verdict, "gap_before": self.gap_before, "gap_after": self.gap_after,
            "noise_floor": self.noise_floor, "gap_unit": self.gap_unit,
            "findings": [f.to_dict() for f in self.findings],
            "rivals": [asdict(r) for r in self.rivals], "next_test": self.next_test,
            "model": None if self.model is None else str(self.model),
            "recalibrated": [p.to_dict() for p in self.recalibrated],
            **({} if self.unexplained is None else {"unexplained": self.unexplained}),
            "unknown": None if self.unknown is None else
            {"port": self.unknown.port, "text": self.unknown.text},
            "reasons": list(self.reasons),
            **({} if self.since is None else {"since_baseline": self.since.to_dict()}),
        }
