"""Units and conditions for training: within the kit's spread, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ema_prognostics.training.conditions import (
    COARSE_BITS,
    EXACT_BITS,
    OTHER_RECORDERS,
    RECORDER_SHARE,
    Recorder,
    RunConditions,
    Unit,
    actuator_of,
    draw_conditions,
    draw_unit,
    effects_of,
    harmonic_spread,
)
from ema_prognostics.training.faults import HEALTHY
from ema_prognostics.training.fleet import simulate_fleets
from ema_record.actuator import INSTANT, Actuator, load_actuator
from ema_record.spread import UnitTolerances, load_spread
from ema_sim.effects import parse_effects

NOMINAL = load_actuator()
SPREAD = load_spread()
QUIET_PLACE = SPREAD.conditions._replace(noise_least=1.0, noise_most=1.0)


def units(spread: UnitTolerances, n: int = 400) -> list[Unit]:
    rng = np.random.default_rng(11)
    return [draw_unit(rng, spread) for _ in range(n)]


def one_test() -> RunConditions:
    """Return conditions of nominal noise, recorded by the unit's own recorder."""
    rng = np.random.default_rng(3)
    return next(c for c in (draw_conditions(rng, QUIET_PLACE) for _ in range(99))
                if c.recorder is None)


def ratio(part: str, name: str, unit: Unit) -> float:
    """Return a parameter of a unit over nominal."""
    value = getattr(getattr(actuator_of(NOMINAL, unit, one_test()), part), name)
    return float(value / getattr(getattr(NOMINAL, part), name))


@pytest.mark.parametrize(("part", "name", "half"), [
    ("motor", "phase_resistance", SPREAD.tolerances.resistance),
    ("motor", "dynamic_friction", SPREAD.tolerances.motor_friction),
    ("motor", "inertia", SPREAD.tolerances.inertia),
    ("surface", "inertia", SPREAD.tolerances.inertia),
    ("shaft", "damping", SPREAD.tolerances.damping),
    ("control", "integral_gain", SPREAD.tolerances.control_gain),
    ("inverter", "hysteresis", SPREAD.tolerances.hysteresis),
])
def test_a_tolerance_is_filled_and_not_exceeded(part: str, name: str, half: float) -> None:
    found = np.array([ratio(part, name, unit) - 1.0 for unit in units(SPREAD.tolerances, 120)])
    assert np.abs(found).max() <= half * (1.0 + 1e-9)
    assert found.min() < -0.9 * half
    assert found.max() > 0.9 * half


def test_viscous_friction_is_spread_by_a_factor_evenly_up_and_down() -> None:
    most = SPREAD.tolerances.viscous_factor
    found = np.log([ratio("motor", "viscous_friction", u) for u in units(SPREAD.tolerances)])
    assert np.abs(found).max() <= np.log(most)
    assert abs(found.mean()) < 0.1 * np.log(most)
    assert np.abs(found).max() > 0.95 * np.log(most)


def test_harmonics_differ_as_a_flat_top_of_that_tolerance_makes_them() -> None:
    """Fourier: the ramps of a trapezoid that is flat over 2/3 pi are pi/3 long."""
    def harmonic(order: int, flat_top: float) -> float:
        half = 0.5 * (np.pi - flat_top)
        return float(np.sin(order * half) / (order**2 * np.sin(half)))

    least, most = (2.0 * np.pi / 3.0 + sign * SPREAD.tolerances.flat_top for sign in (-0.5, 0.5))
    drawn = np.array([u.harmonics for u in units(SPREAD.tolerances)])
    for order, found in zip((3, 5, 7), drawn.T):
        half = abs(harmonic(order, most) - harmonic(order, least))
        assert harmonic_spread(order, SPREAD.tolerances.flat_top) == pytest.approx(half, rel=0.01)
        assert 0.95 * half < np.abs(found).max() <= 1.01 * half


def test_static_friction_is_never_below_dynamic() -> None:
    wide = SPREAD.tolerances._replace(static_ratio=0.8)
    for unit in units(wide, 60):
        a = actuator_of(NOMINAL, unit, one_test())
        assert a.motor.static_friction >= a.motor.dynamic_friction
        assert a.surface.static_friction >= a.surface.dynamic_friction


def test_a_type_without_tolerances_has_one_unit() -> None:
    none = UnitTolerances(*(1.0 if n == "viscous_factor" else 0.0 for n in UnitTolerances._fields))
    unit = next(u for u in units(none) if u.recorder.kind == "declared")
    assert actuator_of(NOMINAL, unit, one_test()) == NOMINAL


def test_each_other_recorder_has_its_share() -> None:
    kinds = [u.recorder.kind for u in units(SPREAD.tolerances, 2000)]
    for kind in OTHER_RECORDERS:  # 200 expected, standard deviation 13
        assert kinds.count(kind) == pytest.approx(2000 * RECORDER_SHARE, abs=55)


def with_recorder(recorder: Recorder) -> Actuator:
    return actuator_of(NOMINAL, units(SPREAD.tolerances, 1)[0],
                       replace(one_test(), recorder=recorder))


def test_recorders_round_sample_or_do_neither() -> None:
    c = with_recorder(Recorder("exact")).converters
    assert {c.position_bits, c.speed_bits, c.current_bits, c.angle_bits} == {EXACT_BITS}
    c = with_recorder(Recorder("coarse", ("speed_bits",))).converters
    assert (c.speed_bits, c.position_bits) == (COARSE_BITS, NOMINAL.converters.position_bits)
    assert with_recorder(Recorder("sampled")).acquisition.sampling == INSTANT
    assert with_recorder(Recorder("truncating")).converters.speed_offset == -0.5


def test_a_control_takes_up_to_a_period_beside_what_its_model_has() -> None:
    some, test = units(SPREAD.tolerances), one_test()
    late = np.array([u.computing for u in some])
    assert late.min() >= 0.0
    assert 0.95 < late.max() <= 1.0
    own = parse_effects(["control_delay.delay=1e-4"])
    found = effects_of(NOMINAL, some[0], test, HEALTHY, own).control_delay.delay
    assert found == pytest.approx(1e-4 + late[0] * NOMINAL.control.period)


def test_conditions_stay_within_their_bounds() -> None:
    rng, c = np.random.default_rng(5), SPREAD.conditions
    found = [draw_conditions(rng, c) for _ in range(500)]
    noise = np.array([f.noise for f in found])
    assert c.noise_least <= noise.min() < 1.1 * c.noise_least
    assert 0.95 * c.noise_most < noise.max() <= c.noise_most
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.2  # each sensor has a noise of its own
    assert max(abs(f.load) for f in found) <= c.load
    assert all(c.temperature_least <= f.temperature <= c.temperature_most for f in found)


def test_a_single_step_begins_as_the_last_move_has_left_surface_and_shaft() -> None:
    """Its features look at the start; those of the longer test do not, and it begins at rest."""
    found = simulate_fleets(("step", "extended"), 12, 5, healthy=True)["step"]
    lag = found.both(["lag_at_rest"])[:, 0]
    shaft, surface = NOMINAL.shaft, NOMINAL.surface
    wound = 1e3 * (surface.dynamic_friction / shaft.stiffness + 0.5 * shaft.backlash)
    assert lag.min() < -1.2 * wound < -0.8 * wound < lag.max()
