"""Two independent integrations agree: the event-driven kernel and the fixed step of 0.1 µs.

The relays make trajectories chaotic, so features are compared, not waveforms. What a feature
may differ by is its spread over the start angle of the rotor, and over the whole panel of
faults the differences, in units of their standard error, must look like chance.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from ema_record.actuator import (
    CIRCLE,
    FOC,
    HARMONICS,
    HEXAGON,
    PWM,
    PWM_INDEPENDENT,
    SINE,
    load_actuator,
)
from ema_record.profile import Profile
from ema_record.record import Record
from ema_sim.effects import EFFECTS, parse_effects
from ema_sim.plant.kernel import MAX_STEP
from ema_sim.simulate import simulate, simulate_traced
from support.actuators import changed
from support.reference import simulate_reference

pytestmark = pytest.mark.slow

# Full slew up, a turn-round, full slew down.
PROFILE = Profile(
    name="there_and_back",
    points=((0.0, -0.1), (0.022, -0.1), (0.022, 0.1), (0.17, 0.1), (0.17, -0.1), (0.27, -0.1)),
)
UP, HOLD, DOWN = (0.05, 0.123), (0.16, 0.17), (0.2, 0.266)
RATIO = 500.0
FAULTS = {
    "healthy": [[]],
    "turn_short": [
        [f"turn_short.fraction={x}", f"turn_short.phase={p}"]
        for x, p in ((0.03, "a"), (0.1, "b"), (0.4, "c"))
    ],
    "rotor_eccentricity": [
        [f"rotor_eccentricity.zeta={z}", f"rotor_eccentricity.mode={mode}"]
        for mode, z in (("paper", 0.03), ("paper", 0.1), ("paper", -0.4), ("common", 0.1),
                        ("shifted", 0.1), ("static", 0.1))
    ],
    "motor_friction": [[f"motor_friction.increase={x}"] for x in (0.1, 0.4, 1.5)],
    "surface_friction": [[f"surface_friction.increase={x}"] for x in (0.1, 0.4, 1.5)],
    "backlash": [[f"backlash.increase={x}"] for x in (2e-4, 1e-3, 5e-3)],
}
N_KERNEL, N_REFERENCE = 24, 2
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))  # spreads any number of angles, favours no line


def features(record: Record, pole_pairs: int = 1) -> dict[str, float]:
    """Return means, spread and complex lines of the record, by name."""
    t, speed = record.time, record.channel("motor_speed")
    theta = np.unwrap(record.channel("rotor_angle"))
    current = np.stack([record.channel(f"phase_current_{p}") for p in "abc"], axis=1)
    asked = np.stack([record.channel(f"reference_current_{p}") for p in "abc"], axis=1)
    ahead = theta / pole_pairs / RATIO - record.channel("surface_position")
    found, mean_ahead = {}, {}
    for name, (begin, end) in {"up": UP, "down": DOWN}.items():
        first, last = np.searchsorted(t, (begin, end))
        turns = int(abs(theta[last] - theta[first]) / (2.0 * np.pi))
        last = first + int(np.argmax(abs(theta[first:] - theta[first]) > 2.0 * np.pi * turns))
        w, phi = slice(first, last), theta[first:last]
        drift = np.linspace(-1.0, 1.0, len(phi))
        columns = [np.ones(len(phi)), drift, drift**2]
        for h in range(1, 7):
            columns += [np.cos(h * phi), np.sin(h * phi)]
        fit = np.linalg.lstsq(np.stack(columns, axis=1), speed[w], rcond=None)[0]
        for h in range(1, 7):
            found[f"{name} speed cos {h}"] = fit[2 * h + 1]
            found[f"{name} speed sin {h}"] = fit[2 * h + 2]
        found[f"{name} slew speed"] = speed[w].mean()
        for k, p in enumerate("abc"):
            found[f"{name} mean |current {p}|"] = np.abs(current[w, k]).mean()
        found[f"{name} rms current"] = np.sqrt((current[w] ** 2).sum(axis=1).mean())
        found[f"{name} envelope"] = np.quantile(np.abs(asked[w]).max(axis=1), 0.98)
        mean_ahead[name] = ahead[w].mean()
    found["lost motion"] = mean_ahead["up"] - mean_ahead["down"]
    hold = (t > HOLD[0]) & (t < HOLD[1])
    found["hold position"] = record.channel("surface_position")[hold].mean()
    passing = (t > 0.095) & (t < 0.105)  # over many steps of the converter
    found["travel at 0.1 s"] = record.channel("surface_position")[passing].mean()
    return found


def panel(run, settings: list[str], seeds: range, pole_pairs: int = 1) -> np.ndarray:
    """Return the features of runs at spread start angles, one a seed, shape (n, features)."""
    effects = parse_effects(settings)
    return np.array([
        list(features(
            run(PROFILE, effects=effects, seed=seed, start_angle=seed * GOLDEN_ANGLE), pole_pairs
        ).values())
        for seed in seeds
    ])


@pytest.fixture(scope="module")
def names() -> list[str]:
    return list(features(simulate(PROFILE)))


@pytest.fixture(scope="module")
def differences() -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return difference of the means, spread and mean of the features, by case."""
    found, used = {}, 0
    for fault, cases in FAULTS.items():
        for settings in cases:  # seeds are used once, so that cases are independent
            kernel = panel(simulate, settings, range(used, used + N_KERNEL))
            used += N_KERNEL
            reference = panel(simulate_reference, settings, range(used, used + N_REFERENCE))
            used += N_REFERENCE
            found[" ".join(settings) or fault] = (
                kernel.mean(axis=0) - reference.mean(axis=0), kernel.std(axis=0, ddof=1),
                reference.mean(axis=0),
            )
    return found


def test_every_fault_is_in_the_panel():
    faults = {name for name, effect in EFFECTS.items() if effect.fault_class is not None}
    assert faults == set(FAULTS) - {"healthy"}
    assert all(len(cases) >= 3 for fault, cases in FAULTS.items() if fault != "healthy")


CASES = [" ".join(settings) or fault for fault, cases in FAULTS.items() for settings in cases]
UNMET = {"motor_friction.increase=1.5": "speed line 3 differs by 3.2 spreads"}


@pytest.mark.parametrize("case", [
    pytest.param(case, marks=pytest.mark.xfail(reason=UNMET[case])) if case in UNMET else case
    for case in CASES])
def test_features_agree_within_the_spread_over_start_angles(differences, names, case):
    difference, spread, _ = differences[case]
    worst = np.argmax(np.abs(difference) / spread)
    assert abs(difference[worst]) < 3.0 * spread[worst], names[worst]


def test_differences_are_no_larger_than_chance(differences, names):
    """Over the panel: the rms of the differences in standard errors, and no common bias."""
    z = np.array([
        difference / (spread * np.sqrt(1.0 / N_KERNEL + 1.0 / N_REFERENCE))
        for difference, spread, _ in differences.values()
    ])
    assert np.sqrt(np.mean(z**2)) < 1.3
    bias = z.mean(axis=0) * np.sqrt(len(z))
    assert np.max(np.abs(bias)) < 5.0, names[int(np.argmax(np.abs(bias)))]


def test_the_faults_show(differences, names):
    """The panel is no comparison of nothing with nothing."""
    healthy = differences["healthy"][2]
    at = {name: i for i, name in enumerate(names)}

    def change(case: str, name: str) -> float:
        return abs(differences[case][2][at[name]] - healthy[at[name]])

    assert change("backlash.increase=0.005", "lost motion") == pytest.approx(5e-3, rel=0.02)
    assert change("motor_friction.increase=1.5", "up rms current") > 5.0
    assert change("surface_friction.increase=1.5", "up rms current") > 2.0
    assert change("turn_short.fraction=0.4 turn_short.phase=c", "up speed cos 2") > 1.0


def test_features_have_converged_in_the_step(names):
    """Four times shorter steps of the kernel change no feature beyond chance."""
    def fine(profile: Profile, **settings) -> Record:
        return simulate_traced(profile, trace=False, max_step=5e-6, **settings).record

    settings = ["turn_short.fraction=0.1"]
    coarse = panel(simulate, settings, range(1000, 1000 + N_KERNEL))
    finer = panel(fine, settings, range(2000, 2000 + N_KERNEL))
    error = np.hypot(coarse.std(axis=0, ddof=1), finer.std(axis=0, ddof=1)) / np.sqrt(N_KERNEL)
    z = (coarse.mean(axis=0) - finer.mean(axis=0)) / error
    assert np.max(np.abs(z)) < 4.5, names[int(np.argmax(np.abs(z)))]
    assert np.sqrt(np.mean(z**2)) < 1.6


def test_features_agree_with_four_pole_pairs(names):
    nominal = load_actuator()
    a = nominal._replace(motor=nominal.motor._replace(pole_pairs=4))
    kernel = panel(partial(simulate, actuator=a), [], range(N_KERNEL), 4)
    reference = panel(partial(simulate_reference, actuator=a), [], range(N_REFERENCE), 4)
    z = np.abs(kernel.mean(axis=0) - reference.mean(axis=0)) / kernel.std(axis=0, ddof=1)
    assert z.max() < 3.0, names[int(np.argmax(z))]


@pytest.mark.parametrize("pairs", [1, 4])
@pytest.mark.parametrize(("kind", "modulation", "shape"), [
    (PWM, HEXAGON, {}), (PWM_INDEPENDENT, HEXAGON, {}), (FOC, HEXAGON, {}), (FOC, CIRCLE, {}),
    (FOC, SINE,
     {"back_emf": HARMONICS, "harmonic_3": 0.1, "harmonic_5": -0.04, "harmonic_7": 0.02})],
    ids=["pwm", "pwm_independent", "foc", "foc circle", "foc sine, harmonics"])
@pytest.mark.parametrize("settings", [
    [], ["turn_short.fraction=0.1", "current_sensor_gain.phase_b=0.05",
         "hall_misalignment.angle=0.1", "bus_voltage_sag.resistance=0.2"]],
    ids=["healthy", "effects"])
def test_drives_with_a_carrier_agree_as_waveforms(
    kind, modulation, shape, pairs, settings
):
    """Two integrators give the same waveforms of a drive with a carrier.

    Nothing is chaotic there: every sample of a step, against edges at 0.1 µs. To 0.1 % of the
    rms of the speed and 1 % of the currents': 0.1 µs is 0.2 % of the voltage of the bus in each
    leg, 0.2 V through K_p = 4 V/A. Six-step references are taken once a period of the carrier: a
    commutation edge next to its begin falls into this period or that, which the reference at half
    the step decides otherwise too (7 % of the currents). Of independent controls, limited at each
    commutation of four pole pairs, the kernel's longest step decides it: 13 % of the currents with
    50 µs, with effects 13 % down to 5 µs and 5 % with 1 µs; with 0.2 µs both agree to 0.02 %.
    Where a circle limits the voltages of four pole pairs, 50 µs are 1.0 % of the currents and 5 µs
    0.2 %; the reference takes 20 ns there, with which it comes nearer the kernel (sine: 1.4 % with
    100 ns, 0.4 % with 50, 0.2 % with 20).
    """
    a = changed(drive={"kind": kind, "modulation": modulation, "proportional_gain": 4.0,
                       "integral_gain": 1200.0},
                motor={**shape, "pole_pairs": pairs},
                converters={"speed_bits": 32, "position_bits": 32})
    profile = Profile(name="step", points=((0.0, -0.1), (0.022, -0.1), (0.022, 0.0), (0.1, 0.0)))
    options = {"actuator": a, "noise": 0.0, "seed": 2, "effects": parse_effects(settings)}
    step = 0.2e-6 if kind == PWM_INDEPENDENT else MAX_STEP if modulation == HEXAGON else 5e-6
    one = simulate_traced(profile, switching=True, trace=False, max_step=step, **options).record
    edges = {} if modulation == HEXAGON else {"step": 2e-8}
    other = simulate_reference(profile, **options, **edges)
    speed, current = (1e-3, 0.01) if kind == FOC else (3e-3, 0.1)
    for k, share in enumerate([speed, *[current] * 6], start=1):
        error = one.samples[:, k] - other.samples[:, k]
        scale = np.sqrt(np.mean(other.samples[:, k] ** 2))
        assert np.sqrt(np.mean(error**2)) < share * scale, k
    assert np.abs(one.samples[:, 9] - other.samples[:, 9]).max() < 2e-4
    assert one.dc_bus[-1, 1:] == pytest.approx(other.dc_bus[-1, 1:], rel=0.01)
