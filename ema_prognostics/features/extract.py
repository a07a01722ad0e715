"""The feature vector of a record, by name: what the networks and the guard see."""

from __future__ import annotations

from math import exp

import numpy as np

from ema_prognostics.features.acceleration import inertia
from ema_prognostics.features.balance import (
    HARMONICS,
    Balance,
    torque_balance,
    with_own_constants,
)
from ema_prognostics.features.consistency import consistency
from ema_prognostics.features.control_loop import control_loop
from ema_prognostics.features.dry_friction import dry_friction
from ema_prognostics.features.profile_kind import ProfileKind
from ema_prognostics.features.reversal import LostMotion, reversal_gap
from ema_prognostics.features.signals import Signals, prepare
from ema_prognostics.features.start import start_features
from ema_prognostics.features.vector import SWINGS
from ema_prognostics.features.winding import rise, winding
from ema_record.actuator import FOC, RELAY, Actuator
from ema_record.channels import fall_of_bus, median
from ema_record.errors import IncompleteRecordError
from ema_record.profiles.plan import TestPlan, test_plan
from ema_record.record import Record

LEAST_SAG = 0.05
"""Resistance of a supply, of that of a phase, below which all are alike."""
LEAST_TORQUE = 2e-3
"""Floor of a torque, of that of nominal friction."""


def _lines(found: dict[str, float], name: str, residual: np.ndarray) -> None:
    for h in range(HARMONICS):
        found[f"{name}_m{h + 1}_re"] = 1e3 * float(residual[h].real)
        found[f"{name}_m{h + 1}_im"] = 1e3 * float(residual[h].imag)


def _pair(found: dict[str, float], speed: str, ahead: Balance, back: Balance) -> None:
    """Add what a pair of slews, forward and back, tells."""
    told = ahead.told & back.told  # a line that is not says nothing, as in a healthy unit
    _lines(found, f"{speed}_even", 0.5 * told * (ahead.residual + back.residual))
    _lines(found, f"{speed}_odd", 0.5 * told * (ahead.residual - back.residual))
    found[f"torque_{speed}"] = float(np.log(0.5 * (ahead.torque + back.torque)))
    found[f"load_{speed}"] = 0.5 * (ahead.torque - back.torque)
    found[SWINGS[speed]] = max(ahead.swing, back.swing)
    for band, high in ahead.high.items():
        found[f"high_{band}_{speed}"] = float(np.log(max(high, back.high[band]) + 1e-5))


def _start(signals: Signals, full: Balance, end: float) -> dict[str, float]:
    """Time from the command to 90 % of the full speed (ms), and the peak of the speed."""
    part = signals.between(0.0, end)
    speed = np.abs(signals.speed[part])
    n = max(1, round(5e-4 * signals.rate))
    smooth = np.convolve(speed, np.ones(n) / n, mode="same")
    reached = np.flatnonzero(smooth > 0.9 * full.speed)
    rise = 1e3 * float(reached[0]) / signals.rate if len(reached) else 1e3 * end
    return {"rise_time": rise, "overshoot": float(smooth.max() / full.speed - 1.0) * 1e2,
            "speed_full": float(np.log(full.speed))}


def _slow(signals: Signals, plan: TestPlan, balances: dict[str, Balance]) -> dict[str, float]:
    """What the ramps and their reversals tell of friction, lost motion and stiffness."""
    found: dict[str, float] = {}
    floor = LEAST_TORQUE * signals.actuator.friction_torque
    ramps = list(plan.ramps.values())
    quarters = [plan.segments[n][:2] for n in ("quarter", "quarter_back")]
    ahead, back = (
        float(signals.torque_constant * median(signals.torque_current[signals.between(*window)]))
        for window in ramps)
    found["torque_ramp"] = float(np.log(max(0.5 * (ahead - back), floor)))
    found["load_ramp"] = 0.5 * (ahead + back)
    names = ("quarter", "quarter_back")
    # A reversal turns the rotor by less than two sectors: each phase counts by its own constant.
    torque = with_own_constants(
        signals, [plan.segments[n] for n in names], [balances[n] for n in names])
    gaps: list[LostMotion] = [
        reversal_gap(torque, begin, plan.reversal_length, sense)
        for begin, sense in plan.reversals
    ]
    found["gap_width"] = 1e4 * 0.5 * (gaps[0].width + gaps[1].width)
    found["gap_width_difference"] = 1e4 * (gaps[0].width - gaps[1].width)
    found["gap_torque"] = float(np.log(max(0.5 * (gaps[0].level + gaps[1].level), floor)))
    found["gap_load"] = 0.5 * (gaps[1].level - gaps[0].level)
    found["shaft_slope"] = 0.5 * (gaps[0].slope + gaps[1].slope)
    found["shaft_bend"] = 0.5 * (gaps[0].bend + gaps[1].bend)
    found["gap_error"] = float(np.log(max(g.error for g in gaps) + floor))
    if signals.has_position:
        lag = signals.motor_angle / signals.actuator.gear.ratio - signals.position
        for name, windows in (("ramp", ramps), ("quarter", quarters)):
            first, second = (float(lag[signals.between(*window)].mean()) for window in windows)
            found[f"lag_{name}"] = 1e4 * (first - second)
    return found


def _winding(signals: Signals, plan: TestPlan) -> dict[str, float]:
    """What the currents tell beside their references: of the windings, supply and control."""
    found: dict[str, float] = {}
    if not signals.has_references:
        return found
    kind = signals.actuator.drive.kind
    if kind != FOC:  # sinusoidal references are never far ahead of the currents
        for name, (begin, end, _) in plan.segments.items():
            found[f"rise_{name}"], found[f"rise_spread_{name}"] = rise(signals, begin, end)
    if kind == RELAY:  # the only drive whose leg voltages a record tells
        found |= winding(signals, plan.slow_from)
    return found | control_loop(signals, *plan.full_speed)


def _sag(record: Record, actuator: Actuator) -> float:
    """Return the resistance of the supply, log of ohm: bus voltage against bus current."""
    least = LEAST_SAG * actuator.motor.phase_resistance
    return float(np.log(max(fall_of_bus(record.dc_bus), least)))


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
    plan = test_plan(record.profile, signals.actuator)
    slews = plan.segments
    balances = {
        name: torque_balance(signals, *segment) for name, segment in slews.items()}
    found: dict[str, float] = {}
    if kind == "extended":
        slow = _slow(signals, plan, balances)
        dry, balances = dry_friction(
            signals, balances, list(plan.ramps.values()), exp(slow["torque_ramp"]))
        for speed in ("full", "quarter"):
            _pair(found, speed, balances[speed], balances[f"{speed}_back"])
        found |= slow | dry
        found["torque_full_over_quarter"] = found["torque_full"] - found["torque_quarter"]
        found["torque_quarter_over_ramp"] = found["torque_quarter"] - found["torque_ramp"]
    else:
        _lines(found, "full_even", balances["full"].told * balances["full"].residual)
        found["torque_full"] = float(np.log(balances["full"].torque))
        for band, high in balances["full"].high.items():
            found[f"high_{band}_full"] = float(np.log(high + 1e-5))
        if signals.has_position:
            found |= start_features(signals, *slews["full"][:2])
    found |= _winding(signals, plan)
    found |= _start(signals, balances["full"], slews["full"][0])
    found |= inertia(signals, plan.starts)
    found["bus_sag"] = _sag(record, signals.actuator)
    found |= consistency(signals, slews)
    found["temperature"] = (signals.temperature - 20.0) / 50.0
    found["bus_voltage"] = signals.bus_voltage / (2.0 * signals.actuator.inverter.bus_voltage)
    if not all(np.isfinite(value) for value in found.values()):
        bad = next(name for name, value in found.items() if not np.isfinite(value))
        raise IncompleteRecordError(f"feature {bad} is not finite: repeat the test")
    return found
