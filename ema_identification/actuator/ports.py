"""Unknown: where an effect lives that the catalogue does not hold, and what it looks like.

The signals in which the residual lives point to ports by physics. The effects of the catalogue
that come nearest do not: they make up for what they are not (a friction for a lost motion).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ema_identification.actuator.decision.fit import TestedUnit
from ema_identification.actuator.measure.control_law import ControlLaw
from ema_identification.actuator.measure.features import FeatureMap
from ema_identification.actuator.residuals import ResidualGroup, groups_of
from ema_identification.result import Curve, Panel, Shape

SENSOR_SIGNALS = {"sum of the phase currents", "measured speed minus speed of the rotor angle"}
TORQUE_LINES = "motor torque", "rotor angle"
SENSOR_FEATURES = ("position_step", "speed_step", "position_at_start", "gain_ab", "gain_ac",
                   "offset_a", "offset_b", "offset_c", "slip")
STRONG_FEATURE = 8.0
"""Residual of a feature that by itself settles a port (standard deviations); torque lines do where
their part of the test is off by more than one such feature."""
LEADING = 0.3
"""Least residual of a sensor's features, or of the torque's lines, of the largest of all, at which
they settle a port: a large effect elsewhere moves them too, since it takes the recalibration
astray."""
COMMUTATION, MULTIPLES = 6, (6, 12, 18, 24)
"""Periods a turn of the commutation: ripple of windings has its multiples, and lower orders."""
STRONG_LINE = 8.0
"""Least residual of a line (standard deviations, re and im)."""
COHERENT = 0.85
"""Least part of the power of a line that has one phase in all sections."""
ONE_SPEED = 20.0, 0.95
"""The same two for the sections of one speed alone: two of them agree by chance more often."""


def unknown_shape(
    unit: TestedUnit, residual: np.ndarray, law: ControlLaw | None = None
) -> Shape:
    """Return port and shape of what is left.

    Parameters
    ----------
    unit : the records; the first one tells the port.
    residual : of the recalibrated model, in standard deviations, shape (d,).
    law : what the control law by itself says.
    """
    groups = groups_of(unit, residual)
    first = unit.parts[0]
    rest = unit.split(residual)[0]
    line = largest_line(first.library.fmap, rest, first.library.repeat.deviation(
        first.conditions.noise))
    limit = first.library.model.actuator.control.speed_limit
    jumps = {t.text: min(1.0, abs(t.after - t.before) / limit)
             for t in first.library.fmap.plan.transitions}
    values = {f.name: float(x) for f, x in zip(first.library.fmap.features, rest)}
    ports = _ports(values, line, groups, jumps, law)
    words = _words(line, groups)
    if law is not None and not law.holds:
        words = f"{law.text}; {words}"
    text = f"{', '.join(ports)}: {words}"
    return Shape(port=", ".join(ports), text=text, panel=_panel(first, rest))


def _ports(
    values: dict[str, float], line: tuple[int, float, str] | None,
    groups: Sequence[ResidualGroup], jumps: Mapping[str, float], law: ControlLaw | None,
) -> list[str]:
    found, along = list[str](), _turns_with_direction(values)
    if abs(values.get("bus_slope", 0.0)) > STRONG_FEATURE:
        found.append("supply")
    sensor = max((abs(values.get(n, 0.0)) for n in SENSOR_FEATURES), default=0.0)
    summed = max((g.largest for g in groups if g.signal in SENSOR_SIGNALS), default=0.0)
    largest = max((g.largest for g in groups), default=0.0)
    if max(sensor, summed) > max(STRONG_FEATURE, LEADING * largest):
        found.append("sensor")
    if law is not None and not law.holds:  # nothing else breaks the law
        found += ["controller", *(["sensor"] if "sensor" not in found else [])]
    ripples = [g for g in groups if (g.signal, g.against) == TORQUE_LINES]
    if line is not None and max(g.largest for g in ripples) > LEADING * largest and max(
            g.excess for g in ripples) > np.log1p(STRONG_FEATURE**2):
        if line[0] > COMMUTATION and line[0] % COMMUTATION:
            found += ["motor torque", "transmission"]
        elif along < 0.0:  # what belongs to the windings turns over
            found.append("motor torque")
    if _turns_commutation(values) > 2.0 * STRONG_FEATURE**2:
        found.append("commutation")
    found += [port for port in _by_physics(groups, jumps, law, along) if port not in found]
    return found[:2] or ["controller"]


def _by_physics(
    groups: Sequence[ResidualGroup], jumps: Mapping[str, float], law: ControlLaw | None,
    along: float,
) -> list[str]:
    """Return ports in the order in which the signals point to them.

    `jumps`: by text of a start or stop its change of speed, of the limit. Where the control is as
    it should be, a speed that runs otherwise is friction's or, the larger the jump and so the
    longer the current is at its limit, that of what windings make of a current. `along` : of
    `_turns_with_direction`.
    """
    score: dict[str, float] = defaultdict(float)
    right = law is not None and law.holds
    for group in groups:
        x = max(group.excess, 0.0)
        if group.signal == "motor torque":
            if group.against == "rotor angle":
                score["winding" if along > 0.0 else "motor torque"] += x
            elif group.against == "speed":
                score["friction"] += x
            elif group.against == "position":
                score["load" if "reversal" not in group.place else "friction"] += x
            elif group.against == "test phase":
                score["load" if "start" in group.place else "friction"] += 0.5 * x
        elif group.signal.startswith("phase current"):
            score["winding"] += 0.5 * x
            score["supply"] += 0.25 * x
        elif group.signal.startswith("motor travel"):
            score["transmission"] += 0.5 * x if group.against == "test phase" else x
        elif group.signal == "motor speed":
            if group.against == "test phase" and right:
                jump = jumps.get(group.place, 0.0)
                score["winding"] += 0.5 * jump * x
                score["friction"] += 0.5 * (1.0 - jump) * x
            else:
                loop = group.against in ("frequency", "test phase")
                score["controller" if loop else "load"] += 0.5 * x
        elif group.signal == "surface position":
            score["transmission" if "reversal" in group.place else "sensor"] += x
        elif group.signal == "bus voltage":
            score["supply"] += x
    return [port for port, _ in sorted(score.items(), key=lambda item: -item[1])
            if not (port == "controller" and right)]


def _turns_commutation(values: dict[str, float]) -> float:
    """Return how far the torque's lines at the commutations are turned with the direction.

    With commutations midway between the phases the torque of windings that are alike, whatever
    their shape, is even about the middle of each sector: its lines are in phase with the sectors.
    Commutations that come late at one direction come early at the other, so that quadratures of
    opposite sign are theirs alone; a torque that belongs to the angle has the same both ways.
    """
    return _turns_with_direction({name: x for name, x in values.items() if name.endswith(
        tuple(f".torque_line_{order}_im" for order in MULTIPLES))})


def _turns_with_direction(values: dict[str, float]) -> float:
    """Say whether the torque lines change sign with the direction (positive) or keep it.

    Of sections that follow one another, as `values` has them.
    A torque that belongs to the angle alone (cogging) has the same lines both ways; one that
    modulates the torque constant follows the sign of the current.
    """
    total = 0.0
    names = list(dict.fromkeys(n.split(".")[0] for n in values if ".torque_line_" in n))
    for a, b in zip(names, names[1:]):
        for key in [n for n in values if n.startswith(f"{a}.torque_line_")]:
            other = key.replace(f"{a}.", f"{b}.", 1)
            if other in values:
                total -= float(np.clip(values[key], -30, 30) * np.clip(values[other], -30, 30))
    return total


def _words(line: tuple[int, float, str] | None, groups: Sequence[ResidualGroup]) -> str:
    """Return the measured shape in words with numbers."""
    parts = [] if line is None else [
        "motor torque periodic in rotor angle, {} a turn, {:.2g} N m ({})".format(*line)]
    return "; ".join([*parts, *(
        f"{group.signal} against {group.against}, {group.place}, up to {group.largest:.0f} "
        "standard deviations" for group in groups[:3])])


def _panel(unit: TestedUnit, residual: np.ndarray) -> Panel:
    """Return the residual of every feature, in the order of the test."""
    signals: dict[str, list[int]] = defaultdict(list)
    for k, feature in enumerate(unit.library.fmap.features):
        signals[feature.signal].append(k)
    return Panel(
        name="unknown", title="What is left, feature by feature.",
        x_label="number of the feature, in the order of the test",
        y_label="residual (standard deviations)", step="where", curves=tuple(
            Curve(label=signal, x=np.array(where, dtype=float), y=residual[where], style="points")
            for signal, where in signals.items()))


class _Line(NamedTuple):
    """A line of one order in the sections of one group."""

    common: float
    """Power of one phase (variances, re and im)."""
    coherence: float
    """The same, of all its power."""
    amplitude: float
    """N m."""
    place: str


_Left = Mapping[str, tuple[complex, float]]
"""A line of one order that is left, by section (mA), and the variance of its parts."""


def largest_line(
    fmap: FeatureMap, residual: np.ndarray, deviation: np.ndarray
) -> tuple[int, float, str] | None:
    """Return order, amplitude (N m) and segment of the clearest torque line that is left.

    A ripple of the machine has one phase in rotor angle in all sections of the test, or one that
    turns over with the direction; a limit cycle that keeps step with the rotor in one section has
    neither.

    Parameters
    ----------
    fmap : of the record.
    residual : ndarray, shape (d,), in standard deviations.
    deviation : ndarray, shape (d,). Standard deviations of a repeat.
    """
    speeds = {s.name: s.speed for s in fmap.plan.segments}
    sizes = {name: round(abs(v), 3) for name, v in speeds.items()}
    groups = [(list(speeds), STRONG_LINE, COHERENT)] + [
        ([n for n in speeds if sizes[n] == v], *ONE_SPEED)
        for v in sorted(set(sizes.values()), reverse=True)]
    left = _left(fmap, residual, deviation)
    clear = {order: [line for group in groups if (line := _clear(places, speeds, *group))]
             for order, places in left.items()}
    clear = {order: lines for order, lines in clear.items() if lines}
    if not clear:
        return None
    order = max(clear, key=lambda o: max(line.common for line in clear[o]))
    line = max(clear[order], key=lambda x: x.coherence)
    (text,) = (s.text for s in fmap.plan.segments if s.name == line.place)
    return order, line.amplitude, text


def _left(
    fmap: FeatureMap, residual: np.ndarray, deviation: np.ndarray
) -> dict[int, _Left]:
    """Return the torque lines that are left, by order."""
    found: dict[int, dict[str, tuple[complex, float]]] = defaultdict(dict)
    for feature, x, sd in zip(fmap.features, residual, deviation):
        if ".torque_line_" in feature.name:
            places = found[int(feature.name.split("_")[2])]
            line, variance = places.get(feature.place, (0j, 0.0))
            part = 1.0 if feature.name.endswith("_re") else 1j
            places[feature.place] = line + float(x * sd) * part, variance + 0.5 * float(sd)**2
    return {**found}


def _clear(
    places: _Left, speeds: Mapping[str, float], among: Sequence[str], strong: float,
    coherent: float,
) -> _Line | None:
    """Return what the sections `among` have in common, where that is clear."""
    chosen = [p for p in among if p in places]
    if len(chosen) < 2:
        return None
    lines, variances = (np.array(x) for x in zip(*(places[p] for p in chosen)))
    weight = 1.0 / variances
    sense = np.sign([speeds[p] for p in chosen])
    along = max((_power_along(lines, weight), _power_along(sense * lines, weight)), key=np.sum)
    power = weight * np.abs(lines)**2
    common, whole = float(along.sum()), float(power.sum())
    if (common > max(2.0 * strong**2, coherent * whole)
            and common - along.max() > strong**2):
        return _Line(
            common=common, coherence=common / whole,
            amplitude=2e-3 * float(power @ np.abs(lines) / power.sum()),
            place=chosen[int(np.argmax(power))])
    return None


def _power_along(lines: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the power of each line along the phase that most of their power has.

    How large a line is may differ among sections: at low speed the shaft holds the rotor, and the
    current sees less of the same ripple.
    """
    whole = weight * np.abs(lines) @ lines
    if whole == 0.0:
        return np.zeros(len(lines))
    return np.asarray(weight * np.maximum(0.0, (lines * np.conj(whole / abs(whole))).real)**2)
