"""From the features of a record to the inputs of each network.

Each network sees what physics says its fault moves, and what may be mistaken for it, and no
more: given all features at once, networks of the same size trained on the same records found
shorts and eccentricities three to ten times larger only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ema_prognostics.cascade.classes import scale_of
from ema_prognostics.cascade.lines import DERIVED, NOISE, LineFilter, short_lines_told
from ema_prognostics.features.vector import ABSOLUTE, squash, steady
from ema_record.actuator import load_actuator

SURFACE = "surface_torque"
MECHANICAL = (SURFACE, "viscous_torque", "compliance", "stiffness_agreement")
"""Names of what `mechanical` returns, in order; the last two need the position."""
LEAST_TORQUE = 0.024
"""Floor of the surface's torque, of `Actuator.friction_torque`."""
LEAST_LAG = 0.3
"""Floor of the wind-up, in `classes.scale_of` the lost motion."""
_WINDING = ("resistance_", "inductance_")
"""How the windings of the phases differ."""
_SCATTER = ("noise_speed", "torque_quarter", "torque_full")
"""What the scatter of the lines depends on."""
_ASYMMETRY = (
    "amplitude_1", "amplitude_2", "amplitude_3", "amplitude_4", "short_like_best", "short_unlike",
    "resistance_spread", "inductance_spread", "winding_like_best", "lines_and_winding_best",
    *_SCATTER)
"""What phases that are unlike each other move."""
_RECORDER = ("amplitude_", "torque_rms_", "noise_current_least", "noise_speed", "high_")
"""What tells lines of the rotor from those of the recorder: samples that are instants fold the
switching onto any line, by as much as onto the others."""
_BALANCE = (
    "dry_torque", "viscous_share", "torque_", "gap_torque", SURFACE, "gap_load", "gap_width",
    "load_", "temperature", "bus_voltage", "lag_", "shaft_slope", "start_stiffness",
    "start_gap", "start_viscous", "short_like_best", "amplitude_1", "amplitude_3",
    "noise_speed", "winding_back_emf", "inertia",
)
"""What the mean torque depends on."""
GROUPS: dict[str, tuple[str, ...]] = {
    "asymmetry": _ASYMMETRY,
    "short": ("short_like_a", "short_like_b", "short_like_c", "short_unlike", "amplitude_1",
              "amplitude_3", "winding_like_", *_WINDING, *_SCATTER),
    "eccentricity": ("first_line_strength", "third_line_strength", *_RECORDER),
    "static_eccentricity": _ASYMMETRY,
    "motor_friction": _BALANCE,
    "surface_friction": _BALANCE,
    "backlash": ("gap_", "lag_", "shaft_slope", "start_stiffness", "start_gap",
                 "torque_ramp", "load_ramp", "torque_full", "noise_speed"),
}
"""Beginnings of the names of the inputs of each network."""
SIZES = {
    "eccentricity": ("amplitude_", "third_line_along", "third_line_across", "third_line_size",
                     "short_unlike", "odd_amplitude", *_SCATTER),
}
"""The same, of networks that say how much and see other inputs than those that say whether."""

ITSELF = ("eccentricity",)
"""Groups that see the record itself with a baseline too, not the difference: no tolerance makes
the lines of an eccentricity, so a baseline would only add its noise."""


def group_inputs(group: str, input_names: Sequence[str], *, size: bool = False) -> list[str]:
    """Return the names of the inputs of a network, the absolute ones with a baseline too.

    Parameters
    ----------
    group : of `GROUPS`.
    input_names : of all inputs.
    size : of the network that says how much.
    """
    beginnings = SIZES.get(group, GROUPS[group]) if size else GROUPS[group]
    found = [n for n in input_names if n.removeprefix(ABSOLUTE).startswith(beginnings)]
    own = [n for n in found if n.startswith(ABSOLUTE)]
    return own if own and group in ITSELF else found


def input_names(names: Sequence[str]) -> list[str]:
    """Return the names of all inputs for features `names`."""
    surface = mechanical_names(names)
    own = any(n.startswith(ABSOLUTE) for n in names)
    return [*names, *DERIVED, *surface,
            *(f"{ABSOLUTE}{n}" for n in (*DERIVED, *surface) if own)]


def mechanical_names(names: Sequence[str]) -> list[str]:
    """Return those of `MECHANICAL` that features `names` tell of."""
    if "gap_torque" not in names:
        return []
    return list(MECHANICAL if "lag_ramp" in names else MECHANICAL[:2])


def mechanical(names: Sequence[str], x: np.ndarray) -> np.ndarray:
    """Return `MECHANICAL` of features `x`, shape (n, d); shape (n, 0) for a test without gap.

    The torque on the slow ramp is that of motor and surface, the torque in the gap of zero
    shaft torque that of the motor alone, so their difference is what the surface takes (log of
    N m). Dry friction falls out of the torque at full less that at a quarter of the speed (N m).
    The torque of the surface winds the shaft up, one way on the ramp forward, the other way on
    the ramp back: the lag between them less the lost motion is twice the compliance times the
    torque (log, over nominal). Compliance and stiffness from the reversals must agree (log of
    their product).
    """
    wanted = mechanical_names(names)
    if not wanted:
        return np.empty((len(x), 0))

    def of(name: str) -> np.ndarray:
        return np.asarray(x[:, names.index(name)])

    nominal = load_actuator()
    torque = np.maximum(np.exp(of("torque_ramp")) - np.exp(of("gap_torque")),
                        LEAST_TORQUE * nominal.friction_torque)
    found = [np.log(torque), np.exp(of("torque_full")) - np.exp(of("torque_quarter"))]
    if len(wanted) > len(found):
        least = 1e4 * LEAST_LAG * scale_of("backlash")  # 0.1 mrad
        wound = np.maximum(of("lag_ramp") - of("gap_width"), least)
        twice_a_torque = 2.0 * 1e4 * nominal.gear.ratio / nominal.shaft.stiffness  # 0.1 mrad/(N m)
        compliance = np.log(wound / (twice_a_torque * torque))
        found += [compliance, compliance + np.log(np.maximum(of("shaft_slope"), 0.05))]
    return np.column_stack(found)


def derive(
    names: Sequence[str], x: np.ndarray, lines: LineFilter, absolute: LineFilter | None
) -> np.ndarray:
    """Return features and filtered lines, shape (n, inputs), not squashed.

    Parameters
    ----------
    names : of the features; with a baseline the absolute ones follow the differences.
    x : ndarray, shape (n, d).
    lines, absolute : filters of the lines, and with a baseline those of the absolute lines.
    """
    if absolute is None:
        return np.hstack([x, lines.derive(names, x), mechanical(names, x)])
    own = [k for k, n in enumerate(names) if n.startswith(ABSOLUTE)]
    bare = [names[k].removeprefix(ABSOLUTE) for k in own]
    record = x[:, own]
    baseline = record - x[:, [names.index(n) for n in bare]]
    now, then = mechanical(bare, record), mechanical(bare, baseline)
    told = short_lines_told(bare, record) & short_lines_told(bare, baseline)
    return np.hstack([x, lines.derive(names, x, told), now - then,
                      absolute.derive(bare, record), now])


class Inputs:
    """The inputs of all networks of one view."""

    def __init__(
        self, names: Sequence[str], lines: LineFilter, absolute: LineFilter | None,
        center: np.ndarray, spread: np.ndarray,
    ) -> None:
        """Keep what one view needs; `center` and `spread` have shape (inputs,)."""
        self.names = list(names)
        self.input_names = input_names(names)
        self._lines, self._absolute = lines, absolute
        self.center, self.spread = center, spread
        """Of the healthy fleet, shape (inputs,)."""

    def deviations(self, x: np.ndarray) -> np.ndarray:
        """Return all inputs in healthy deviations, shape (n, inputs), of features `x`."""
        return (self.raw(x) - self.center) / self.spread

    def raw(self, x: np.ndarray) -> np.ndarray:
        """Return all inputs in their units, shape (n, inputs), of features `x`."""
        x = steady(self.names, x, self.center[:len(self.names)])
        return derive(self.names, x, self._lines, self._absolute)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return all inputs, squashed, shape (n, inputs), of features `x`, shape (n, d)."""
        return squash(self.raw(x), self.center, self.spread)

    def noise(self, u: np.ndarray) -> np.ndarray:
        """Return the noise of the records themselves, shape (n,), of all inputs `u`, squashed.

        Zero where no interval without current tells it.
        """
        for name in (ABSOLUTE + NOISE, NOISE):
            if name in self.input_names:
                return np.asarray(u[:, self.input_names.index(name)])
        return np.zeros(len(u))

    def columns(self, inputs: Sequence[str]) -> np.ndarray:
        """Return where `inputs` stand; ValueError if one is unknown."""
        place = {n: k for k, n in enumerate(self.input_names)}
        missing = [n for n in inputs if n not in place]
        if missing:
            raise ValueError(f"unknown input {missing[0]!r}")
        return np.array([place[n] for n in inputs])
