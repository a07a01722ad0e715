"""How units of one type and the conditions of their tests differ: sections of `actuator.yaml`.

Both are drawn evenly within their bounds. What a record cannot measure is spread as real
actuators spread (docs/kit.md); acceptance records may narrow it.

What healthy machines leave over their best model, feature by feature, is the type's discrepancy
(`left_over`). Its mean over units is measured with an error, the spread between units over the
root of their number; what is not larger than that error is no discrepancy. So each mean is shrunk
by 1 − error² / mean², not below 0 (the positive part of James and Stein 1961), and its error is
part of the spread. Where units differ more than the model's do, so is the rest of their variance;
of few units it is known but badly, and a hundred features together tell how badly (`moderated`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar, get_type_hints

import numpy as np
from pydantic import TypeAdapter

from ema_record.actuator import NOMINAL, quantity, sections_of
from ema_record.errors import UsageError, unknown_name, validated
from ema_record.kit import ACTUATOR, kit_file


class UnitTolerances(NamedTuple):
    """Half widths of the bands of a type's units, relative where no unit stands."""

    resistance: Annotated[float, quantity("1", 0.0, 0.5, "of a phase")]
    inductance: Annotated[float, quantity("1", 0.0, 0.5, "of a phase")]
    back_emf: Annotated[float, quantity("1", 0.0, 0.3, "of all phases together")]
    back_emf_phase: Annotated[float, quantity("1", 0.0, 0.1, "of each phase")]
    flat_top: Annotated[float, quantity("rad", 0.0, 0.5, "of the trapezoid")]
    motor_friction: Annotated[float, quantity("1", 0.0, 0.8, "dry, of the motor")]
    surface_friction: Annotated[float, quantity("1", 0.0, 0.8, "dry, of the surface")]
    static_ratio: Annotated[float, quantity("1", 0.0, 0.8, "static over dynamic friction")]
    viscous_factor: Annotated[float, quantity("1", 1.0, 10.0, "factor up and down")]
    inertia: Annotated[float, quantity("1", 0.0, 0.5, "of the motor")]
    stiffness: Annotated[float, quantity("1", 0.0, 0.8, "of the shaft")]
    damping: Annotated[float, quantity("1", 0.0, 0.9, "of the shaft")]
    control_gain: Annotated[float, quantity("1", 0.0, 0.5, "each gain of the control")]
    hysteresis: Annotated[float, quantity("1", 0.0, 0.5, "band of the relay")]
    backlash: Annotated[float, quantity("1", 0.0, 0.8, "lost motion of the gear")]
    latency: Annotated[float, quantity("1", 0.0, 20.0, "control periods, 0 up to this")]


def harmonic_spread(order: int, flat_top: float) -> float:
    """Return by what a harmonic of a back-EMF varies where a flat top varies by `flat_top` (rad).

    A trapezoid that is flat over 2/3 pi has harmonics sin(h x) / (h² sin x) of the first, with x
    the half of a ramp, pi/6; a wider top makes x half as much shorter. So the windings of sound
    units differ as much, whatever shape their back-EMF is described by.
    """
    x = math.pi / 6.0
    slope = (order * math.cos(order * x) * math.sin(x) - math.sin(order * x) * math.cos(x)) / (
        order * math.sin(x)) ** 2
    return abs(0.5 * flat_top * slope)


class Conditions(NamedTuple):
    """Bounds of the conditions of a test."""

    temperature_least: Annotated[float, quantity("degC", -70.0, 200.0, "winding, least")]
    temperature_most: Annotated[float, quantity("degC", -70.0, 200.0, "winding, most")]
    bus: Annotated[float, quantity("1", 0.0, 0.5, "change of the bus voltage, + and -")]
    load: Annotated[float, quantity("N m", 0.0, 1e5, "torque on the surface, + and -")]
    noise_least: Annotated[float, quantity("1", 0.0, 100.0, "factor on the noise, least")]
    noise_most: Annotated[float, quantity("1", 0.0, 100.0, "factor on the noise, most")]
    current_gain: Annotated[float, quantity("1", 0.0, 0.2, "of each current sensor, + and -")]
    current_offset: Annotated[float, quantity("A", 0.0, 100.0, "of each sensor, + and -")]


class TypeSpread(NamedTuple):
    """What differs from unit to unit and from test to test."""

    tolerances: UnitTolerances
    conditions: Conditions


def most_of(name: str) -> float:
    """Return the largest value of one of `UnitTolerances`."""
    field = get_type_hints(UnitTolerances, include_extras=True)[name].__metadata__[-1]
    return float(next(item.le for item in field.metadata if hasattr(item, "le")))


_Part = TypeVar("_Part", UnitTolerances, Conditions)


def load_spread() -> TypeSpread:
    """Return the spread that the present kit describes.

    Raises
    ------
    UsageError
        An unknown name, or a value out of bounds.
    """
    return _of_kit(*kit_file(ACTUATOR))


@cache
def _of_kit(path: Path, _changed: int) -> TypeSpread:
    data = sections_of(path)
    return TypeSpread(_section(UnitTolerances, "tolerances", data, str(path)),
                      _section(Conditions, "conditions", data, str(path)))


def _section(part: type[_Part], name: str, data: Mapping[str, Any], where: str) -> _Part:
    values = data.get(name, {})
    if not isinstance(values, Mapping):
        raise UsageError(f"{where}: {name}: expected parameters and values")
    for key in values:
        if key not in part._fields:
            raise unknown_name(f"parameter of {name} in {where}", str(key), part._fields,
                               f"see {NOMINAL}")
    found = validated(TypeAdapter(part).validate_python, dict(values), f"{where}: {name}", name,
                      f"see {NOMINAL}")
    if isinstance(found, Conditions):
        for what in ("temperature", "noise"):
            least, most = getattr(found, f"{what}_least"), getattr(found, f"{what}_most")
            if least > most:
                raise UsageError(f"{where}: conditions: {what}_least {least:g} is above "
                                 f"{what}_most {most:g}")
    return found


LEAST_RATIO, LEAST_FEATURES, MOST_FREEDOM = 1e-6, 10, 1e4
"""Variance ratio of a feature that differs at all; fewest of these that tell a prior; its degrees
of freedom from which all variances are as good as equal."""


def left_over(
    off: np.ndarray, units: np.ndarray, spread: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and spread of what the units of a type leave over the model, shapes (d,).

    Parameters
    ----------
    off : ndarray, shape (n, d). Measured features less the model's.
    units : ndarray, shape (n,). Unit of each.
    spread : ndarray, shape (d,). Standard deviation that the model itself gives to units.
    """
    means = np.array([off[units == unit].mean(axis=0) for unit in np.unique(units)])
    n = len(means)
    left = means.mean(axis=0)
    own = spread
    if n > 1:
        own = spread * np.sqrt(moderated((means.std(axis=0, ddof=1) / spread)**2, n - 1))
    error = np.maximum(own, spread) / np.sqrt(n)
    share = np.clip(1.0 - error**2 / np.maximum(left**2, 1e-30), 0.0, 1.0)
    more = np.maximum(own**2 - spread**2, 0.0)
    return share * left, np.sqrt(share * error**2 + more)


def moderated(ratio: np.ndarray, freedom: int) -> np.ndarray:
    """Return variance ratios of many features, each of few degrees of freedom, drawn together.

    Empirical Bayes with a scaled inverse chi-square prior, whose scale and degrees of freedom
    fit the logarithms of all (Smyth 2004, section 6.2).

    Parameters
    ----------
    ratio : ndarray, shape (d,). Measured, not negative.
    freedom : of each.
    """
    from scipy.optimize import brentq
    from scipy.special import digamma, polygamma

    known = ratio > LEAST_RATIO
    if np.count_nonzero(known) < LEAST_FEATURES:
        return ratio
    half = 0.5 * freedom
    logs = np.log(ratio[known]) - digamma(half) + np.log(half)
    beyond = float(logs.var(ddof=1) - polygamma(1, half))
    if beyond <= float(polygamma(1, 0.5 * MOST_FREEDOM)):
        prior = MOST_FREEDOM
    else:
        prior = 2.0 * brentq(lambda v: float(polygamma(1, v)) - beyond, 1e-3, 0.5 * MOST_FREEDOM)
    scale = np.exp(logs.mean() + digamma(0.5 * prior) - np.log(0.5 * prior))
    return np.asarray((prior * scale + freedom * ratio) / (prior + freedom))
