"""What a record can show, before anything is fitted, and which motion would show the rest.

Of each base parameter the share of its regressor that the others do not repeat, and the condition
number of all of them scaled to equal size (M. Gautier, W. Khalil, "Exciting trajectories for the
identification of base inertial parameters of robots", Int. J. Robotics Research 11(4), 1992).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_identification.report.words import number
from ema_identification.rig.signals.trajectory import Trajectory

APART = 0.05
"""Least share of a regressor, rms, that is its own, for its parameter to be shown."""
WEAK = 0.15
"""Below this it is shown poorly."""
NAMES = {
    "inertia": "inertia", "viscous_friction": "viscous friction",
    "coulomb_friction": "Coulomb friction", "offset": "an offset", "spring": "a stiffness",
}
_MOTIONS = (
    (frozenset({"inertia", "spring"}), "a second sine at least twice as fast, or steps: at one "
     "frequency the acceleration is the position turned over"),
    (frozenset({"coulomb_friction", "offset"}), "both directions"),
    (frozenset({"viscous_friction", "offset"}), "both directions, at two speeds"),
    (frozenset({"coulomb_friction", "viscous_friction"}), "runs at a tenth of the speed too"),
    (frozenset({"inertia", "viscous_friction"}), "a stretch of constant speed and steps of it"),
    (frozenset({"spring", "offset"}), "more travel"),
    (frozenset({"spring", "viscous_friction"}), "stops at several positions"),
    (frozenset({"inertia", "coulomb_friction"}), "reversals at two accelerations"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Visible:
    """How well one base parameter stands apart in a record."""

    name: str
    own: float
    """Share of its regressor, rms, that the others do not repeat."""
    alike: str
    """The parameter whose regressor is most like it."""
    motion: str
    """That would show it apart."""

    @property
    def shown(self) -> bool:
        """Whether the record can show it."""
        return self.own >= APART


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """What a record can show."""

    condition: float
    """Of the regressors of equal size; infinite where two are the same."""
    parameters: tuple[Visible, ...]

    @property
    def lines(self) -> tuple[str, ...]:
        """The check in words."""
        shown = [NAMES[p.name] + (" (poorly)" if p.own < WEAK else "")
                 for p in self.parameters if p.shown]
        condition = number(self.condition) if self.condition < 1e6 else "above a million"
        lines = [f"this record can show {', '.join(shown) or 'nothing'} (condition number "
                 f"{condition})"]
        lines += [f"it cannot show {NAMES[p.name]} apart from {NAMES[p.alike]} "
                  f"({100 * p.own:.1f} % of it is its own); {p.motion} would"
                  for p in self.parameters if not p.shown]
        return tuple(lines)

    def to_dict(self) -> dict[str, object]:
        """Return it for JSON."""
        return {"condition_number": self.condition, "parameters": [
            {"name": p.name, "own_share": p.own, "shown": p.shown, "alike": p.alike,
             "motion": p.motion} for p in self.parameters]}


def what_shows(trajectory: Trajectory) -> Check:
    """Return which base parameters a trajectory can show: those of `NAMES`."""
    columns = trajectory.reduce(lambda s: np.column_stack([
        s.acceleration, s.speed, np.sign(s.smooth_speed), np.ones(len(s)), s.position]))
    columns[:, 4] -= columns[:, 4].mean()
    size = np.sqrt(np.mean(columns**2, axis=0))
    scaled = columns / np.maximum(size, 1e-300)
    singular = np.linalg.svd(scaled, compute_uv=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0.0 else float("inf")
    found = []
    for k, name in enumerate(NAMES):
        others = np.delete(scaled, k, axis=1)
        fitted, *_ = np.linalg.lstsq(others, scaled[:, k], rcond=1e-12)
        own = float(np.sqrt(np.mean((scaled[:, k] - others @ fitted) ** 2)))
        at = int(np.argmax(np.abs(np.delete(scaled.T @ scaled[:, k], k))))
        alike = [other for other in NAMES if other != name][at]
        found.append(Visible(name=name, own=own if size[k] > 0.0 else 0.0, alike=alike,
                             motion=_motion(name, alike)))
    return Check(condition=condition, parameters=tuple(found))


def _motion(name: str, alike: str) -> str:
    """Return the motion that tells two parameters apart."""
    pair = frozenset({name, alike})
    return next((text for names, text in _MOTIONS if names == pair),
                "trapezoids of speed in both directions, at two speeds and two accelerations")
