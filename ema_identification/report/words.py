"""Numbers and verdicts in words, as the report prints them."""

from __future__ import annotations

import math

from ema_identification.result import Finding, Identification, Parameter
from ema_sim.effects import EFFECTS


def number(value: float, digits: int = 3) -> str:
    """Return a number with `digits` significant digits, plain where that is readable."""
    if not math.isfinite(value):
        return "not known" if math.isnan(value) else ("∞" if value > 0.0 else "−∞")
    if value == round(value) and abs(value) < 1e4:
        return f"{value:.0f}".replace("-", "−")
    if not 1e-3 <= abs(value) < 1e5:
        mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
        return f"{mantissa} × 10{_superscript(int(exponent))}".replace("-", "−")
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{decimals}f}".replace("-", "−")


def _superscript(value: int) -> str:
    return str(value).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def probability(value: float) -> str:
    """Return a p-value as it is read."""
    if not math.isfinite(value):
        return "–"
    return "< 0.001" if value < 1e-3 else f"{value:.2g}"


def with_unit(text: str, unit: str) -> str:
    """Return a number and its unit; a ratio has none."""
    return text if unit in ("", "1") else f"{text} {unit}"


def quantity(parameter: Parameter) -> str:
    """Return value and unit."""
    return with_unit(number(parameter.value), parameter.unit)


def interval(parameter: Parameter) -> str:
    """Return the interval with its unit; a dash where it is a choice, not an estimate."""
    if parameter.low == parameter.high:
        return "–"
    low, high = number(parameter.low), number(parameter.high)
    return with_unit(f"{low} to {high}", parameter.unit)


def pretty(name: str) -> str:
    """Return the name of an effect as a person writes it."""
    return name.replace("_", " ").replace("back emf", "back-EMF")


def named(finding: Finding) -> str:
    """Return the name, with those that cannot be told from it."""
    names = [pretty(name) for name in (finding.effect, *finding.equivalent)]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"


def listed(identification: Identification) -> str:
    """Return all names that were found, in one phrase."""
    names = [named(finding) for finding in identification.findings]
    return names[0] if len(names) == 1 else f"{'; '.join(names[:-1])}; and {names[-1]}"


SHOWS = 1.5
"""Noise floors from which a held-out record shows a gap at all."""


def held_out_shows(identification: Identification) -> bool:
    """Whether the gap before stands out of the noise floor on the held-out data."""
    return identification.gap_before >= SHOWS * identification.noise_floor > 0.0


def closed_share(identification: Identification) -> float | None:
    """Return how much of the gap above the noise floor was closed, None if none stood out."""
    if not held_out_shows(identification):
        return None
    above = identification.gap_before - identification.noise_floor
    return (identification.gap_before - identification.gap_after) / above


def verdict_sentence(identification: Identification) -> str:
    """Return the answer in one sentence."""
    before, after = number(identification.gap_before), number(identification.gap_after)
    floor = number(identification.noise_floor)
    if identification.verdict == "no disagreement":
        return (f"Model and measurement agree: the gap on held-out data is {before}, with a "
                f"noise floor of {floor}. Nothing is missing that these data can show.")
    if identification.verdict == "explained":
        return (f"The model lacked {listed(identification)}; with it the gap on held-out data "
                f"falls from {before} to {after}, with a noise floor of {floor}.")
    if identification.verdict == "partly explained":
        return (f"The model lacked {listed(identification)}; with it the gap on held-out data "
                f"falls from {before} to {after}, but the noise floor is {floor}: something is "
                "left that the catalogue does not explain.") if identification.findings else (
                f"A gap of {before} was found, with a noise floor of {floor}, and only a part "
                "of it is explained.")
    shape = identification.unknown.text if identification.unknown is not None else "no shape found"
    return (f"Something is missing that the catalogue does not hold: {shape.rstrip('.')}. The gap "
            f"on held-out data is {after}, with a noise floor of {floor}.")


def summary_of(effect: str) -> tuple[str, str, str]:
    """Return summary, equation and source of an entry of the catalogue, empty if it is none."""
    entry = EFFECTS.get(effect)
    return ("", "", "") if entry is None else (entry.summary, entry.equation, entry.reference)
