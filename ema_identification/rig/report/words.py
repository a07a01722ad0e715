"""Findings and remainders in words, with numbers and units, and the test to run next."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ema_identification.report.words import number, quantity
from ema_identification.result import Parameter, Where
from ema_identification.rig.fit.balance import InputBalance, rms
from ema_identification.rig.laws.base import Term
from ema_identification.rig.search.remainder import Left
from ema_identification.rig.signals.trajectory import Trajectory

LEAST_IN_BIN = 3
"""Rows of a mean that is shown."""


def signal_name(trajectory: Trajectory) -> str:
    """Return the port in words: ``input force``."""
    return f"input {trajectory.axis.input}"


def where(balance: InputBalance, index: int, found: Sequence[Parameter]) -> Where:
    """Return where the effect of a term lives, in words and numbers."""
    term, trajectory = balance.terms[index], balance.design.trajectory
    axis = trajectory.axis
    unit = axis.input_channel.unit
    span = balance.span(index)
    columns = balance.columns[:, span]
    share = rms(columns) * abs(found[0].value) if term.law.name == "control_delay" else rms(
        columns @ balance.fit.coefficients[span])
    values = {p.name.split(".")[1]: p.value for p in found}
    shown = {p.name.split(".")[1]: quantity(p) for p in found}
    fast = float(np.quantile(np.abs(trajectory.speed), 0.98))
    at_fast = f"{unit} at {number(fast)} {axis.speed_unit}"
    text = {
        "coulomb_friction": lambda: f"±{shown['level']} with the direction of motion, at all "
                                    "speeds",
        "offset": lambda: f"{shown['value']} in both directions, at all speeds",
        "asymmetric_friction": lambda: (
            f"grows with speed, by {number(values['viscous_difference'] * fast)} {unit} one way "
            f"and {number(-values['viscous_difference'] * fast)} {unit} the other in friction, at "
            f"{number(fast)} {axis.speed_unit}"),
        "stribeck_friction": lambda: f"{shown['increase']} more towards standstill, gone above "
                                     f"about {shown['speed']}",
        "quadratic_drag": lambda: "rises with the square of the speed, to "
                                  f"{number(values['value'] * fast**2)} {at_fast}",
        "sublinear_viscous_friction": lambda: "rises with the root of the speed, to "
                                              f"{number(values['value'] * math.sqrt(fast))} "
                                              f"{at_fast}",
        "spring": lambda: f"{shown['stiffness']} about rest at {shown['rest']}",
        "control_delay": lambda: "where the input changes fast: the motion lags by "
                                 f"{number(1e3 * values['delay'])} ms",
        "presliding_hysteresis": lambda: "after each reversal, within "
                                         f"{shown['distance']} of travel",
        "periodic_disturbance": lambda: f"a wave in time at {shown['frequency']}, whatever the "
                                        f"motion, amplitude {shown['amplitude']}",
        "position_dependent_inertia": lambda: f"inertia that changes by ±{shown['amplitude']}, "
                                              f"{number(term.shape[0])} times a turn",
        "drive_lag": lambda: "where the input changes fast: time constant "
                             f"{number(1e3 * values['time_constant'])} ms",
        "backlash": lambda: f"after each reversal, while {shown['gap']} are crossed",
    }
    if term.law.in_position:
        said = (f"periodic in position, {wave_words(trajectory, term.shape[0])}, amplitude "
                f"{shown['amplitude']}")
    else:
        said = text.get(term.law.name, lambda: f"{term.law.meaning}: {term.law.equation}")()
    in_angle = term.law.in_position and axis.motion == "rotary"
    against = "rotor angle" if in_angle else term.law.against
    return Where(signal=signal_name(trajectory), against=against,
                 text=f"{said} ({number(share)} {unit} rms)")


def wave_words(trajectory: Trajectory, order: float) -> str:
    """Return an order in words: a turn, or as a period in length."""
    if trajectory.axis.motion == "rotary":
        return f"{number(order, 4)} a turn"
    return f"period {number(1e3 / order, 4)} mm"


def shape_words(left: Left, trajectory: Trajectory) -> str:
    """Return what a nameless shape looks like."""
    axis = trajectory.axis
    unit = axis.input_channel.unit
    port = signal_name(trajectory)
    if left.shape.order is not None:
        size = f"amplitude {number(math.hypot(*left.coefficients[:2]))} {unit}"
        if left.shape.against == "position":
            return (f"{port}, periodic in position, {wave_words(trajectory, left.shape.order)}, "
                    f"{size}")
        whose = "where the motion has one too: an effect of the motion, or a disturbance" \
            if left.shape.of_motion else "whatever the motion: a disturbance"
        return f"{port}, a wave in time at {number(left.shape.order, 4)} Hz {whose}, {size}"
    x, y = curve(left, trajectory)
    if left.shape.label == "speed and direction":
        return f"{port}, friction against speed: {_friction_words(x, y, axis.speed_unit, unit)}"
    low, high = float(np.min(y)), float(np.max(y))
    x_unit = {"position": axis.position_unit, "test phase": "s"}.get(
        left.shape.against, f"{axis.speed_unit}²")
    return (f"{port}, depends on {left.shape.label}: {number(low)} {unit} at "
            f"{number(float(x[np.argmin(y)]))} {x_unit} to {number(high)} {unit} at "
            f"{number(float(x[np.argmax(y)]))} {x_unit}")


def curve(left: Left, trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Return a nameless shape as means over bins of its abscissa."""
    against, label = left.shape.against, left.shape.label
    values = left.shape.columns @ left.coefficients
    quantity = {
        "speed": trajectory.speed, "position": trajectory.position,
        "load": trajectory.acceleration, "test phase": trajectory.time,
    }[against]
    if label == "angle within a turn":
        quantity = np.mod(quantity, 2 * np.pi)
    return binned(quantity, values, 40)


def binned(x: np.ndarray, y: np.ndarray, bins: int) -> tuple[np.ndarray, np.ndarray]:
    """Return means of x and y over bins of equal width in x that hold enough rows.

    Fewer bins where there are few rows; where not even one holds enough, the rows themselves.
    """
    if len(x) < LEAST_IN_BIN:
        return x, y
    low, high = np.quantile(x, [0.002, 0.998])
    if high <= low:
        return x[:1], y[:1]
    bins = min(bins, max(1, len(x) // LEAST_IN_BIN))
    place = np.clip(((x - low) / (high - low) * bins).astype(int), 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    good = count >= max(LEAST_IN_BIN, 0.05 * len(x) / bins)
    if not good.any():
        return binned(x, y, bins // 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_x = np.bincount(place, x, bins) / count
        mean_y = np.bincount(place, y, bins) / count
    return mean_x[good], mean_y[good]


def _friction_words(x: np.ndarray, y: np.ndarray, speed: str, unit: str) -> str:
    """Return how a force against speed behaves on both sides of zero."""
    parts = []
    for word, side in (("forward", x > 0), ("backward", x < 0)):
        if side.sum() < 2:
            continue
        order = np.argsort(np.abs(x[side]))
        near, far = y[side][order][0], y[side][order][-1]
        trend = "constant"
        if abs(far - near) > 0.2 * max(abs(far), abs(near)):
            trend = "rises" if abs(far) > abs(near) else "falls"
        parts.append(
            f"{word} {trend} from {number(float(near))} {unit} at "
            f"{number(float(np.abs(x[side][order][0])))} {speed} to {number(float(far))} {unit} "
            f"at {number(float(np.abs(x[side][order][-1])))} {speed}")
    return ", ".join(parts)


def term_words(term: Term, trajectory: Trajectory) -> str:
    """Return a term's name with its order, for tables."""
    if term.law.in_position:
        return f"{term.law.name} ({wave_words(trajectory, term.shape[0])})"
    return term.law.name


_TESTS: tuple[tuple[frozenset[str], str], ...] = (
    (frozenset({"offset", "asymmetric_friction"}),
     "constant-speed runs in both directions at three speeds or more: an offset stays the same, "
     "direction-dependent friction changes with speed; and one record with the drive on and the "
     "axis held, where only the offset is left"),
    (frozenset({"coulomb_friction", "offset"}),
     "a run in both directions: Coulomb friction changes its sign, an offset does not"),
    (frozenset({"viscous_friction", "back_emf"}),
     "record the current beside the voltage: the back-EMF needs no current"),
    (frozenset({"drive_lag", "winding_inductance"}),
     "a step of voltage with the axis held: the inductance shows in the current alone"),
    (frozenset({"presliding_hysteresis", "backlash"}),
     "slow triangles with an amplitude of a few times the lost motion: in a gap the input is "
     "free, in presliding it rises at once"),
    (frozenset({"quasi_static_compliance", "compliance"}),
     "a sweep up to a few times the resonance, or steps of the input: there the load's inertia "
     "and its frequency stand apart, below it only their ratio"),
    (frozenset({"cogging_torque", "gear_mesh_ripple"}),
     "a full turn at slow constant speed in both directions, with the gear's ratio known: mesh "
     "ripple has a whole number of periods a turn of a gear"),
    (frozenset({"cogging_torque", "current_sensor_offset"}),
     "the same slow turn with the drive off, turned by hand or another motor: cogging stays, what "
     "a current sensor makes does not"),
    (frozenset({"cogging_torque", "current_sensor_gain"}),
     "the same slow turn under twice the load: what a gain of a current sensor makes doubles, "
     "cogging stays"),
    (frozenset({"end_stops", "two_sided_backlash"}),
     "the drive against its load by hand: play is felt about the middle, stops at the ends"),
    (frozenset({"unbalance", "cogging_torque", "speed_sensor_runout"}),
     "the same slow turn with the axis tilted: only the weight of an unbalance changes; "
     "two constant speeds: run-out of a sensor grows with the square of the speed"),
    (frozenset({"gravity", "spring", "cogging_torque"}),
     "a slow run over more than one turn or the whole travel: a wave repeats, a spring does not"),
)
_BY_SPEED = frozenset({"coulomb_friction", "stribeck_friction", "quadratic_drag",
                       "viscous_friction", "sublinear_viscous_friction", "asymmetric_friction"})


def next_test(names: Sequence[str], trajectory: Trajectory) -> str:
    """Return the excitation that would separate `names`, two or more."""
    given = frozenset(names)
    fast = float(np.quantile(np.abs(trajectory.speed), 0.98))
    unit = trajectory.axis.speed_unit
    best = max(_TESTS, key=lambda row: len(row[0] & given))
    if len(best[0] & given) >= 2:
        return best[1]
    if given <= _BY_SPEED:
        return (f"slow constant-speed runs in both directions, at two speeds or more between "
                f"{0.02 * fast:.3g} and {fast:.3g} {unit}")
    return (f"a slow constant-speed run in both directions at {0.05 * fast:.3g} {unit} over the "
            "whole travel, then a run at twice the speed")


def for_unknown(against: str, trajectory: Trajectory) -> str:
    """Return the test that would show an unknown effect more clearly."""
    fast = float(np.quantile(np.abs(trajectory.speed), 0.98))
    unit = trajectory.axis.speed_unit
    if against == "speed":
        return (f"constant-speed runs in both directions at five speeds between "
                f"{0.02 * fast:.3g} and {fast:.3g} {unit}")
    if against == "position":
        return ("a slow constant-speed run in both directions over the whole travel or a full "
                f"turn, at {0.05 * fast:.3g} {unit} or less")
    if against == "frequency":
        return "a record with the axis at rest and the drive on: a disturbance in time stays"
    if against == "load":
        return "the same motion at twice and at half the acceleration"
    return "the same motion repeated ten times without a pause: what changes is heat or wear"
