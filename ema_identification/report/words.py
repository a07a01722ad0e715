"""Numbers and verdicts in words, as the report prints them."""

from __future__ import annotations

import math

from ema_identification.result import Identification, NamedEffect, Parameter


def number(value: float, digits: int = 3) -> str:
    """Return a number with `digits` significant digits, plain where that is readable."""
    if not math.isfinite(value):
        return "not known" if math.isnan(value) else ("∞" if value > 0.0 else "−∞")
    if value == round(value) and abs(value) < 1e4:
        return f"{value:.0f}".replace("-", "−")
    if not 1e-3 <= abs(value) < 1e5:
        mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
        power = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        return f"{mantissa} × 10{power}".replace("-", "−")
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{decimals}f}".replace("-", "−")


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


def named(finding: NamedEffect) -> str:
    """Return the name with its phase or mode, and those that cannot be told from it."""
    choices = ", ".join(f"{pretty(name.rpartition('.')[2])} {value}"
                        for name, value in finding.choices.items())
    own = pretty(finding.effect) + (f" ({choices})" if choices else "")
    names = [own, *(pretty(name) for name in finding.equivalent)]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"


def listed(identification: Identification) -> str:
    """Return all names that were found, in one phrase."""
    names = [named(finding) for finding in identification.findings]
    return names[0] if len(names) == 1 else f"{'; '.join(names[:-1])}; and {names[-1]}"


SHOWS = 1.5
"""Noise floors from which data show a gap at all."""


def data_of(identification: Identification) -> str:
    """Return what the gap is measured on."""
    return "held-out data" if identification.held_out else "the fitted data"


def gap_shows(identification: Identification) -> bool:
    """Whether the gap before stands out of the noise floor."""
    return identification.gap_before >= SHOWS * identification.noise_floor > 0.0


def closed_share(identification: Identification) -> float | None:
    """Return how much of the gap above the noise floor was closed, 1 at most.

    None if none stood out, or if it grew.
    """
    if not gap_shows(identification) or identification.gap_after > identification.gap_before:
        return None
    above = identification.gap_before - identification.noise_floor
    return min(1.0, (identification.gap_before - identification.gap_after) / above)


def gap_change(identification: Identification) -> str:
    """Return what the gap did, with the noise floor."""
    before, after = identification.gap_before, identification.gap_after
    way = "grows" if after > before else "falls"
    within = ", within the noise," if identification.held_out and after > before else ","
    return (f"the gap on {data_of(identification)} {way} from {number(before)} to "
            f"{number(after)}{within} with a noise floor of {number(identification.noise_floor)}")


def change_sentence(since: Identification) -> str:
    """Return what has changed since the baseline, in one sentence."""
    if since.verdict == "no disagreement":
        return "Nothing has changed since the baseline that these data can show."
    if since.verdict in ("explained", "partly explained") and since.findings:
        return (f"What has changed since the baseline is {since.verdict} by {listed(since)}; "
                f"{gap_change(since)}.")
    return f"What has changed since the baseline: {since.verdict}; {gap_change(since)}."


def verdict_sentence(identification: Identification) -> str:
    """Return the answer in one sentence."""
    before, after = number(identification.gap_before), number(identification.gap_after)
    floor, data = number(identification.noise_floor), data_of(identification)
    if identification.verdict == "no disagreement":
        return (f"Model and measurement agree: the gap on {data} is {before}, with a "
                f"noise floor of {floor}. Nothing is missing that these data can show.")
    if identification.verdict == "contradicted":
        grew = identification.gap_after > identification.gap_before
        way, only = ("grew", "") if grew else ("fell", " only")
        return (f"The fitted data ask for {listed(identification)}, and the held-out data speak "
                f"against it: their gap {way} from {before} to {after}{only}, with a noise floor "
                f"of {floor}.")
    if identification.verdict == "explained":
        return f"The model lacked {listed(identification)}; with it {gap_change(identification)}."
    if identification.verdict == "partly explained":
        left = ("more is left than noise: its values are not sure enough for these data, or "
                "something else is missing" if identification.unknown is None else
                "something is left that the catalogue does not explain")
        return (f"The model lacked {listed(identification)}; with it "
                f"{gap_change(identification)}: {left}.") if identification.findings else (
                f"A gap of {before} was found, with a noise floor of {floor}, and only a part "
                "of it is explained.")
    shape = identification.unknown.text if identification.unknown is not None else "no shape found"
    return (f"Something is missing that the catalogue does not hold: {shape.rstrip('.')}. The gap "
            f"on {data} is {after}, with a noise floor of {floor}.")
