"""The feature vector of a record, by name: what the networks and the guard see."""

from __future__ import annotations

from math import exp

import numpy as np

from ema_prognostics.features.acceleration import inertia
from ema_prognostics.features.balance import HARMONICS, Balance, torque_balance
from ema_prognostics.features.consistency import consistency
from ema_prognostics.features.control_loop import control_loop
from ema_prognostics.features.dry_friction import dry_friction
from ema_prognostics.features.profile_kind import ProfileKind
from ema_prognostics.features.reversal import LostMotion, reversal_gap
from ema_prognostics.features.signals import Signals, prepare
from ema_prognostics.features.start import start_features
from ema_prognostics.features.winding import rise, winding
from ema_record.actuator import Actuator
from ema_record.errors import IncompleteRecordError
from ema_record.record import Record

SEGMENTS: dict[ProfileKind, dict[str, tuple[float, float, int]]] = {
    "step": {"full": (0.10, 0.36, 20)},
    "extended": {
        "full": (0.10, 0.36, 20), "full_back": (0.66, 0.878, 16),
        "quarter": (1.09, 1.458, 8), "quarter_back": (1.61, 1.978, 8),
    },
}
"""Begin and end after the first command (s), fewest turns; settled slews only."""
RAMPS = {"ramp": (2.12, 2.498), "ramp_back": (2.66, 2.998)}
"""Slow ramps (s after the first command); too slow for whole turns in number."""
LAST_TIME: dict[ProfileKind, float] = {"step": 0.36, "extended": 3.083}
"""What a record must cover at least (s after the first command)."""
REVERSALS = {"gap": (2.508, -1), "gap_back": (3.008, 1)}
REVERSAL_LENGTH = 0.075
"""Begin (s) and sense after each reversal, and the window's length (s)."""
FULL_SPEED: dict[ProfileKind, tuple[tuple[float, float], ...]] = {
    "step": ((0.06, 0.36),), "extended": ((0.06, 0.36),),
}
"""Slews at the limit of the speed (s after the first command)."""
STARTS: dict[ProfileKind, tuple[tuple[float, float], ...]] = {
    "step": ((0.0, 0.06),),
    "extended": ((0.0, 0.06), (0.47, 0.64), (0.86, 1.0), (1.44, 1.54)),
}
"""Where the motor accelerates and brakes (s after the first command)."""
LEAST_SAG = 0.05
"""Resistance of a supply below which all are alike (ohm)."""
HIGH_BANDS = {"low": slice(0, 6), "mid": slice(6, 14), "top": slice(14, 30)}
"""Bands of the lines 7 to 36."""


def _lines(found: dict[str, float], name: str, residual: np.ndarray) -> None:
    for h in range(HARMONICS):
        found[f"{name}_m{h + 1}_re"] = 1e3 * float(residual[h].real)
        found[f"{name}_m{h + 1}_im"] = 1e3 * float(residual[h].imag)


def _pair(found: dict[str, float], speed: str, ahead: Balance, back: Balance) -> None:
    """Add what a pair of slews, forward and back, tells."""
    _lines(found, f"{speed}_even", 0.5 * (ahead.residual + back.residual))
    _lines(found, f"{speed}_odd", 0.5 * (ahead.residual - back.residual))
    found[f"torque_{speed}"] = float(np.log(0.5 * (ahead.torque + back.torque)))
    found[f"load_{speed}"] = 0.5 * (ahead.torque - back.torque)
    for band, part in HIGH_BANDS.items():
        high = np.maximum(ahead.high[part], back.high[part])
        found[f"high_{band}_{speed}"] = float(np.log(high.max() + 1e-5))


def _ramp_torque(signals: Signals, begin: float, end: float) -> float:
    part = signals.between(begin, end)
    return float(signals.torque_constant * np.median(signals.torque_current[part]))


def _start(signals: Signals, full: Balance) -> dict[str, float]:
    """Time from the command to 90 % of the full speed (ms), and the peak of the speed."""
    part = signals.between(0.0, 0.10)
    speed = np.abs(signals.speed[part])
    n = max(1, round(5e-4 * signals.rate))
    smooth = np.convolve(speed, np.ones(n) / n, mode="same")
    reached = np.flatnonzero(smooth > 0.9 * full.speed)
    rise = 1e3 * float(reached[0]) / signals.rate if len(reached) else 100.0
    return {"rise_time": rise, "overshoot": float(smooth.max() / full.speed - 1.0) * 1e2,
            "speed_full": float(np.log(full.speed))}


def _slow(signals: Signals) -> dict[str, float]:
    """What the ramps and their reversals tell of friction, lost motion and stiffness."""
    found: dict[str, float] = {}
    ahead, back = (_ramp_torque(signals, *w) for w in RAMPS.values())
    found["torque_ramp"] = float(np.log(max(0.5 * (ahead - back), 1e-3)))
    found["load_ramp"] = 0.5 * (ahead + back)
    gaps: list[LostMotion] = [
        reversal_gap(signals, begin, REVERSAL_LENGTH, sense)
        for begin, sense in REVERSALS.values()
    ]
    found["gap_width"] = 1e4 * 0.5 * (gaps[0].width + gaps[1].width)
    found["gap_width_difference"] = 1e4 * (gaps[0].width - gaps[1].width)
    found["gap_torque"] = float(np.log(max(0.5 * (gaps[0].level + gaps[1].level), 1e-3)))
    found["gap_load"] = 0.5 * (gaps[1].level - gaps[0].level)
    found["shaft_slope"] = 0.5 * (gaps[0].slope + gaps[1].slope)
    found["shaft_bend"] = 0.5 * (gaps[0].bend + gaps[1].bend)
    found["gap_error"] = float(np.log(max(g.error for g in gaps) + 1e-3))
    ratio = signals.actuator.gear.ratio
    lag = signals.motor_angle / ratio - signals.position
    for name, windows in (
        ("ramp", RAMPS.values()),
        ("quarter", [SEGMENTS["extended"][s][:2] for s in ("quarter", "quarter_back")]),
    ):
        first, second = (float(lag[signals.between(*w)].mean()) for w in windows)
        found[f"lag_{name}"] = 1e4 * (first - second)
    return found


def _sag(record: Record) -> float:
    """Return the resistance of the supply, log of ohm: bus voltage against bus current."""
    if len(record.dc_bus) < 4:
        return float(np.log(LEAST_SAG))
    voltage, current = (record.dc_bus[:, k] - record.dc_bus[:, k].mean() for k in (1, 2))
    slope = -float(voltage @ current) / max(float(current @ current), 1e-3)
    return float(np.log(max(slope, 0.0) + LEAST_SAG))


def extract(
    record: Record, kind: ProfileKind, actuator: Actuator | None = None
) -> dict[str, float]:
    """Return the features of `record` by name.

    Parameters
    ----------
    record : a test of this kind.
    kind : step or extended.
    actuator : nominal parameters, default those of the model file.

    Raises
    ------
    RecordError
        The record does not hold what the features need.
    """
    signals = prepare(record, actuator)
    wide = kind == "extended"
    balances = {
        name: torque_balance(signals, *segment, high=True)
        for name, segment in SEGMENTS[kind].items()
    }
    found: dict[str, float] = {}
    if wide:
        for speed in ("full", "quarter"):
            _pair(found, speed, balances[speed], balances[f"{speed}_back"])
        found |= _slow(signals)
        found |= dry_friction(signals, balances, list(RAMPS.values()), exp(found["torque_ramp"]))
        found["torque_full_over_quarter"] = found["torque_full"] - found["torque_quarter"]
        found["torque_quarter_over_ramp"] = found["torque_quarter"] - found["torque_ramp"]
    else:
        _lines(found, "full_even", balances["full"].residual)
        found["torque_full"] = float(np.log(balances["full"].torque))
        for band, part in HIGH_BANDS.items():
            high = balances["full"].high[part]
            found[f"high_{band}_full"] = float(np.log(high.max() + 1e-5))
        found |= start_features(signals, *SEGMENTS[kind]["full"][:2])
    for name, (begin, end, _) in SEGMENTS[kind].items():
        found[f"rise_{name}"], found[f"rise_spread_{name}"] = rise(signals, begin, end)
    found |= _start(signals, balances["full"])
    found |= winding(signals)
    found |= control_loop(signals, FULL_SPEED[kind])
    found |= inertia(signals, STARTS[kind])
    found["bus_sag"] = _sag(record)
    found |= consistency(signals, SEGMENTS[kind])
    found["temperature"] = (signals.temperature - 20.0) / 50.0
    found["bus_voltage"] = signals.bus_voltage / (2.0 * signals.actuator.inverter.bus_voltage)
    if not all(np.isfinite(value) for value in found.values()):
        bad = next(name for name, value in found.items() if not np.isfinite(value))
        raise IncompleteRecordError(f"feature {bad} is not finite: repeat the test")
    return found
