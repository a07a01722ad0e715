"""`diagnose_robust`: from a record, a model and perhaps a baseline to a verdict."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ema_prognostics.robust.cascade import SHORTS, Cascade, Finding
from ema_prognostics.robust.conditions import CLASS_OF, FAULTS, OUTPUTS
from ema_prognostics.robust.explain import reasons_of_fault, reasons_of_guard
from ema_prognostics.robust.features import Kind, extract, kind_of
from ema_prognostics.robust.model import RobustModel, View, load_robust_model
from ema_prognostics.robust.vector import differences
from ema_prognostics.turns import check_finite
from ema_prognostics.verdict import Fault, Verdict
from ema_record.channels import N_CHANNELS
from ema_record.errors import (
    IncompleteRecordError,
    InvalidRecordError,
    RecordError,
    UsageError,
)
from ema_record.record import Record

LEVELS = {"turn_short": (0.05, 0.15), "rotor_eccentricity": (0.010, 0.023),
          "friction": (0.2, 0.5), "backlash": (3e-4, 1e-3)}
"""Bounds between small, medium and large; those of the paper for its two faults, in parts."""
UNITS = {"turn_short": "1", "rotor_eccentricity": "1", "friction": "1", "backlash": "rad"}
LARGEST_GAP = 1.5
"""Longest interval between samples, in sample intervals."""


@lru_cache(maxsize=1)
def _shipped() -> RobustModel:
    return load_robust_model()


def check_whole(record: Record) -> None:
    """Raise RecordError unless the record is finite, whole and without gaps."""
    status = record.provenance.status
    if status != "complete":
        raise IncompleteRecordError(f"the test was {status}: repeat it")
    if record.samples.shape[1] != N_CHANNELS or len(record) < 2:
        raise IncompleteRecordError(f"{len(record)} samples: repeat the test")
    check_finite(record)
    gap = float(np.diff(record.time).max()) * record.rate
    if gap > LARGEST_GAP:
        raise IncompleteRecordError(f"a gap of {gap:.1f} sample intervals: repeat the test")
    missing = record.profile.duration - float(record.time[-1])
    if missing > 2.0 / record.rate + 1e-3:
        raise IncompleteRecordError(
            f"the record ends {missing:.3f} s before the test does: repeat the test"
        )


def level_of(fault_class: str, severity: float) -> str:
    """Return small, medium or large."""
    low, high = LEVELS[fault_class]
    return "small" if severity < low else "medium" if severity < high else "large"


def diagnose_robust(
    record: Record, model: RobustModel | None = None, baseline: Record | None = None
) -> Verdict:
    """Say what is wrong with the actuator that `record` comes from.

    Parameters
    ----------
    record : one built-in test.
    model : default the shipped one.
    baseline : a healthy record of the same actuator and test, from its acceptance.

    Returns
    -------
    Verdict
        Always, for any record: what cannot be judged is incomplete, invalid or unknown.

    Raises
    ------
    ModelError
        No usable model.
    UsageError
        The baseline cannot serve: another test, or not a whole record.
    """
    model = _shipped() if model is None else model
    try:
        check_whole(record)
    except InvalidRecordError as error:
        return Verdict(outcome="invalid", reasons=(str(error),))
    except RecordError as error:
        return Verdict(outcome="incomplete", reasons=(str(error),))
    kind = kind_of(record.profile)
    fleet = model.view(kind, "fleet") if kind is not None else None
    if kind is None or fleet is None:
        return _unknown((
            f"the test {record.profile.name!r} is not one that the networks know: run the "
            "profile extended",))
    try:
        features = extract(record, kind)
    except RecordError as error:
        return _unknown((str(error),))
    if set(features) != set(fleet.names):
        return _unknown(("the record does not hold every feature: its interval with the "
                         "inverter off is missing",))
    cascade = _cascade(model, kind, "fleet")
    x = np.array([features[n] for n in fleet.names])
    finding = cascade.find(x[None])[0]
    unusual = reasons_of_guard(cascade, finding)
    if unusual:
        return _unknown(("the record is unlike anything the networks were trained on",
                         *unusual))
    own = model.view(kind, "baseline")
    if baseline is not None and own is not None:
        base = _baseline_features(baseline, kind, fleet.names)
        cascade = _cascade(model, kind, "baseline")
        x = differences(fleet.names, x[None], base[None])[0]
        finding = cascade.find(x[None])[0]
    return _verdict(cascade, x, finding)


def _baseline_features(baseline: Record, kind: Kind, names: list[str]) -> np.ndarray:
    try:
        check_whole(baseline)
        if kind_of(baseline.profile) != kind:
            raise UsageError(
                f"the baseline is of the test {baseline.profile.name!r}, the record of another: "
                "give a baseline of the same test"
            )
        found = extract(baseline, kind)
    except RecordError as error:
        raise UsageError(f"the baseline cannot serve: {error}") from None
    return np.array([found[n] for n in names])


_CASCADES: dict[tuple[int, str], tuple[RobustModel, Cascade]] = {}


def _cascade(model: RobustModel, kind: Kind, view: View) -> Cascade:
    """Return the built cascade; the last few are kept."""
    key = (id(model), f"{kind}/{view}")
    kept = _CASCADES.get(key)
    if kept is not None and kept[0] is model:
        return kept[1]
    data = model.view(kind, view)
    assert data is not None
    if len(_CASCADES) >= 8:
        _CASCADES.clear()
    cascade = Cascade(data)
    _CASCADES[key] = (model, cascade)
    return cascade


def _unknown(reasons: tuple[str, ...]) -> Verdict:
    return Verdict(outcome="unknown", probabilities={"unknown": 1.0}, reasons=reasons)


def probabilities(finding: Finding) -> dict[str, float]:
    """Return the probability of each class, and of healthy: none of them."""
    by_class = dict.fromkeys(FAULTS, 0.0)
    for name, p in zip(OUTPUTS, finding.probability):
        by_class[CLASS_OF[name]] = max(by_class[CLASS_OF[name]], float(p))
    return {"healthy": float(np.prod([1.0 - p for p in by_class.values()])), **by_class}


def _verdict(cascade: Cascade, x: np.ndarray, finding: Finding) -> Verdict:
    if not finding.outputs:
        return Verdict(
            outcome="healthy", probabilities=probabilities(finding),
            reasons=("no feature lies outside what the healthy fleet shows",),
        )
    faults, reasons = [], []
    for output, severity in zip(finding.outputs, finding.severity):
        name = CLASS_OF[output]
        faults.append(Fault(
            fault_class=name, phase=output[-1] if output in SHORTS else None,
            severity=severity.value, severity_unit=UNITS[name],
            severity_interval=(severity.lower, severity.upper),
            level=level_of(name, severity.value),
        ))
        if name == "friction":
            side = "motor" if output == "motor_friction" else "surface"
            reasons.append(f"the friction is that of the {side}")
        reasons += reasons_of_fault(cascade, x, output)
    faults.sort(key=lambda f: -(f.severity or 0.0) / LEVELS[f.fault_class][1])
    short = any(f.fault_class == "turn_short" for f in faults)
    other = any(f.fault_class == "rotor_eccentricity" for f in faults)
    if short and not other:
        reasons.append("a rotor off centre in a fixed direction (static eccentricity) would "
                       "look the same")
    return Verdict(
        outcome="fault", faults=tuple(faults), reasons=tuple(reasons),
        probabilities=probabilities(finding),
        alternatives=("rotor_eccentricity",) if short and not other else (),
    )
