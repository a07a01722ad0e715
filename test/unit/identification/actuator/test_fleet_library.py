"""What the library of a fleet is made of: units, quadratic mean, laws of the noise."""

import shutil
from dataclasses import replace
from functools import partial
from itertools import permutations

import numpy as np
import pytest
from sklearn.covariance import ledoit_wolf_shrinkage

from ema_identification.__main__ import main
from ema_identification.actuator.decision import fit
from ema_identification.actuator.decision.joint import joint_unit
from ema_identification.actuator.decision.models import Models
from ema_identification.actuator.decision.proposals import scores
from ema_identification.actuator.fleet.surrogate import (
    FleetLibrary,
    NoiseLaw,
    bent,
    design,
    fit_mean,
    flattening,
    noise_law,
    shrunk,
)
from ema_identification.actuator.fleet.units import (
    FULL,
    STRIBECK,
    LibrarySizes,
    deviations,
    draw_fleet_conditions,
    draw_fleet_unit,
    fleet_record,
    fleet_runs,
    fleet_unit,
    of_day,
    unit_numbers,
)
from ema_identification.actuator.gap import LETS_GO, HeldOut
from ema_identification.actuator.library import build as library_build
from ema_identification.actuator.library.baseline import with_baselines
from ema_identification.actuator.library.build import (
    agrees,
    as_arrays,
    fleet_library,
    from_arrays,
    probed,
    title,
)
from ema_identification.actuator.measure.features import feature_map
from ema_identification.actuator.measure.runs import spread_out
from ema_identification.actuator.measure.tolerances import (
    NOISES,
    RecordConditions,
    align,
    conditions_of,
)
from ema_record import array_cache
from ema_record.actuator import (
    FOC,
    HARMONICS,
    INSTANT,
    MEAN,
    PWM,
    PWM_INDEPENDENT,
    RELAY,
    TRAPEZOID,
)
from ema_record.kit import LIBRARY, shipped_kit, using_kit
from ema_record.profile import Profile, load_profile
from ema_record.spread import harmonic_spread, load_spread
from ema_sim.effects import parse_effects
from ema_sim.model_file import load_model_file
from ema_sim.simulate import simulate, start_of

MODEL, SPREAD = load_model_file(), load_spread()


def at(kind=RELAY, shape=TRAPEZOID, **moved):
    a = MODEL.actuator._replace(drive=MODEL.actuator.drive._replace(kind=kind),
                                motor=MODEL.actuator.motor._replace(back_emf=shape))
    names = unit_numbers(a)
    z = np.zeros(len(names))
    for name, value in moved.items():
        z[names.index(name.replace("__", "."))] = value
    return fleet_unit(MODEL._replace(actuator=a), SPREAD, z, RecordConditions())[0]


def test_runs_that_were_stopped_go_on_where_they_were(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    done = []

    def part(k):
        if k == 3 and len(done) == 3:
            raise KeyboardInterrupt
        done.append(k)
        return np.full((2, 2), float(k))

    jobs = [(k,) for k in range(5)]
    with pytest.raises(KeyboardInterrupt):
        spread_out(part, jobs, workers=1, keep="part_of_a_test")
    done.append("again")
    found = spread_out(part, jobs, workers=1, keep="part_of_a_test")
    assert done == [0, 1, 2, "again", 3, 4]
    assert np.concatenate(found)[::2, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    array_cache.save("part_of_a_test_too", {"rows": np.zeros(1)})
    array_cache.forget("part_of_a_test")
    assert [p.stem for p in (tmp_path / "ema_phm").iterdir()] == ["part_of_a_test_too"]


def test_a_library_comes_back_as_it_was_kept():
    law = NoiseLaw(quiet=np.array([1.0, 2.0]), noisy=np.array([[0.5, 0.0], [0.25, 0.25]]),
                   correlation=np.array([[1.0, 0.25], [0.25, 1.0]]))
    library = FleetLibrary(
        model=MODEL, spread=SPREAD, fmap=None, weights=np.ones((3, 2)), surrogate=law,
        repeat=law.scaled(2.0), healthy=np.ones((4, 2)), carried=0.3,
        aside=(np.zeros((4, 5)), np.ones((4, 2))))
    again = from_arrays(as_arrays(library), MODEL, SPREAD, None)
    assert (again.carried, again.repeat.quiet.tolist()) == (0.3, [2.0, 4.0])
    assert again.surrogate.covariance((1.5, 0.5)) == pytest.approx(law.covariance((1.5, 0.5)))


def test_what_is_kept_is_rounded_to_multiples_of_a_power_of_two():
    values = np.random.default_rng(1).normal(size=1000)
    kept = array_cache.rounded(values, 0.01)
    assert kept.dtype == np.float32 and np.abs(kept - values).max() <= 2.0**-8
    assert (kept % 2.0**-7 == 0.0).all()


@pytest.fixture(scope="module", params=["step", "extended"])
def shipped(request):
    """Return the library of a test as it is shipped, and what is kept of it."""
    profile = load_profile(request.param)
    fmap = feature_map(profile, MODEL.actuator, simulate(
        profile, actuator=MODEL.actuator, effects=MODEL.effects, seed=0,
        rate=MODEL.actuator.acquisition.rate))
    kept = array_cache.load(f"library_{title(MODEL, SPREAD, fmap, FULL, 0)}",
                            shipped_kit() / LIBRARY)
    assert kept is not None, "python -m ema_identification step extended makes it"
    return from_arrays(kept, MODEL, SPREAD, fmap), kept


@pytest.mark.slow
def test_the_shipped_library_is_of_this_code(shipped):
    """Its runs, statistics and ranks come out again: else it is to be made anew."""
    library, kept = shipped
    found = probed(library, seed=0)
    assert agrees(library, kept, found)
    # Other code: features that are a little off, another fit, other ranks.
    step = library.repeat.deviation((1.0, 1.0))
    assert not agrees(library, kept, found | {"probed_units": found["probed_units"] + 2.0 * step})
    assert not agrees(library, kept, found | {"probed_laws": found["probed_laws"] + 0.5 * step})
    assert not agrees(library, kept, found | {"probed_fit": 1.001 * found["probed_fit"]})
    assert not agrees(replace(library, healthy=1.1 * library.healthy), kept, found)
    assert not agrees(library, {k: v for k, v in kept.items() if k != "probed_laws"}, found)


@pytest.mark.slow
def test_units_set_aside_are_ranked_alike_by_any_number_of_workers(shipped):
    known, _ = shipped
    alone, shared = (np.concatenate(spread_out(
        partial(library_build._ranked, known), [(0, 3), (3, 5)], workers=n)) for n in (1, 2))
    assert np.array_equal(alone, shared)
    assert alone == pytest.approx(known.healthy[:5], rel=library_build.SAME[1])


@pytest.mark.slow
def test_what_is_shipped_of_healthy_units_is_of_the_shipped_libraries(tmp_path, monkeypatch):
    """The first use of held-out, accepted or several records need not fit them all anew."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    units = []
    for path in sorted((shipped_kit() / LIBRARY).glob("library_*.npz")):
        kept = array_cache.load(path.stem, path.parent)
        profile = load_profile(str(kept["test"]))
        fmap = feature_map(profile, MODEL.actuator, simulate(
            profile, actuator=MODEL.actuator, effects=MODEL.effects, seed=0,
            rate=MODEL.actuator.acquisition.rate))
        known = from_arrays(kept, MODEL, SPREAD, fmap)
        units.append(fit.TestedUnit(library=known, values=known.aside[1][0],
                                    conditions=conditions_of(known.aside[0][0])))
    for held, fitted in permutations(units, 2):
        gaps = HeldOut(unit=held, fitted=fitted).healthy
        assert len(gaps) == FULL.set_aside and 1.0 < np.median(gaps) < 4.0
        both = joint_unit([held, fitted], scores).library
        assert both.healthy.shape == (FULL.set_aside, 4)
    for unit in units:
        changed, apart = with_baselines(unit.library)
        assert changed.healthy.shape == (FULL.set_aside, 4) and 0.0 < apart < 2.0
    made = [path.name for path in tmp_path.rglob("*.npz") if not path.name.startswith("agreed_")]
    assert made == []  # python -m ema_identification step extended


@pytest.mark.slow
def test_the_day_of_a_held_out_record_is_found_where_its_shaft_slips():
    """Wound to its bound, beside its rest and under load, it slips as the test begins."""
    def tested(name, z):
        library = fleet_library(MODEL, load_profile(name), rate=20_000.0, workers=2)
        record = fleet_record(MODEL, SPREAD, library.fmap, z, RecordConditions(), seed=4)
        return fit.TestedUnit(library=library, values=library.fmap.extract(record), workers=2,
                              conditions=align(record, MODEL))

    z = np.zeros(len(unit_numbers(MODEL.actuator)))
    fitted = tested("extended", z)
    z[LETS_GO] = -0.9, 1.0, 1.0
    found = HeldOut(unit=tested("step", z), fitted=fitted).gap([Models(fitted).null])
    assert found.values[0] < found.bound


def test_a_library_of_another_model_test_or_code_has_another_name(shipped):
    library, _ = shipped
    of = [library.model, library.spread, library.fmap, FULL, 0]
    a = MODEL.actuator
    other = MODEL._replace(actuator=a._replace(motor=a.motor._replace(
        phase_resistance=1.001 * a.motor.phase_resistance)))
    names = {title(*of), title(other, *of[1:]), title(*of[:4], 1),
             title(*of[:3], FULL._replace(units=10), 0),
             title(*of[:2], replace(library.fmap, rate=1e4), FULL, 0),
             title(*of[:2], replace(library.fmap, features=library.fmap.features[1:]), FULL, 0)}
    assert len(names) == 6


@pytest.mark.parametrize("damage", [
    lambda kept: kept.pop("weights"),
    lambda kept: kept.update(repeat_correlation=kept["repeat_correlation"][:5]),
])
def test_a_damaged_library_is_made_anew(damage, tmp_path, monkeypatch):
    class MadeAnewError(Exception):
        pass

    def built(*_: object) -> None:
        raise MadeAnewError

    for path in (shipped_kit() / LIBRARY).glob("library_*.npz"):
        kept = dict(array_cache.load(path.stem, path.parent))
        damage(kept)
        array_cache.save(path.stem, kept, tmp_path)
    monkeypatch.setattr(library_build, "kit_path", lambda _: tmp_path)
    monkeypatch.setattr(library_build, "_built", built)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with pytest.raises(MadeAnewError):
        library_build.fleet_library(load_model_file(), load_profile("step"))


def test_conditions_of_healthy_units_are_those_that_their_records_tell():
    """As of a measured record: the noise is an estimate, not the number that was drawn."""
    profile = load_profile("step")
    fmap = feature_map(profile, MODEL.actuator, simulate(profile, seed=1))
    runs = fleet_runs(MODEL, SPREAD, fmap, LibrarySizes(1, 1, 0, 1))
    drawn = np.random.default_rng([0, 7, 0])
    z, given = draw_fleet_unit(drawn, MODEL.actuator), draw_fleet_conditions(drawn, SPREAD)
    assert runs.z[0].tolist() == z.tolist()
    assert runs.conditions[0, NOISES] == pytest.approx(given.noise, rel=0.1)
    assert (runs.conditions[0, NOISES] != given.noise).all()
    assert np.isfinite(runs.again).all() and (runs.again != runs.features[:1]).any()


def test_bands_are_those_of_the_kit():
    a, t = MODEL.actuator, SPREAD.tolerances
    for sign in (-1.0, 1.0):
        m = at(motor__viscous_friction=sign).motor
        assert m.viscous_friction == pytest.approx(
            a.motor.viscous_friction * t.viscous_factor**sign)
        assert at(shaft__stiffness=sign).shaft.stiffness == pytest.approx(
            a.shaft.stiffness * (1.0 + sign * t.stiffness))
        assert at(inverter__hysteresis=sign).inverter.hysteresis == pytest.approx(
            a.inverter.hysteresis * (1.0 + sign * t.hysteresis))
        assert at(acquisition__command_latency=sign).acquisition.command_latency == pytest.approx(
            a.acquisition.command_latency + 0.5 * (1.0 + sign) * t.latency)
        assert at(control__integral_gain=sign).control.integral_gain == pytest.approx(
            a.control.integral_gain * (1.0 + sign * t.control_gain))
        for kind in (PWM, FOC, PWM_INDEPENDENT):
            assert at(kind, drive__integral_gain=sign).drive.integral_gain == pytest.approx(
                a.drive.integral_gain * (1.0 + sign * t.control_gain))
            share = a.drive.integral_gain / a.drive.pwm_frequency / a.drive.proportional_gain
            assert at(kind, drive__proportional_gain=sign).drive.proportional_gain == (
                pytest.approx(a.drive.proportional_gain * (1.0 + sign * t.control_gain)
                              / (1.0 if sign > 0.0 else 1.0 + share)))
            assert "inverter.hysteresis" not in unit_numbers(at(kind))
        for order in (5, 7):
            name = f"harmonic_{order}"
            assert getattr(at(FOC, HARMONICS, **{f"motor__{name}": sign}).motor, name) == (
                pytest.approx(sign * harmonic_spread(order, t.flat_top)))
        assert "motor.flat_top" not in unit_numbers(at(FOC, HARMONICS))
    assert at(motor__static_ratio=-1.0).motor.static_friction >= a.motor.dynamic_friction
    for sign in (-1.0, 1.0):  # one that truncates, one that rounds up
        assert at(converters__speed_offset=sign).converters.speed_offset == 0.5 * sign
    noises = [at(noise__position=sign).noise.position / a.noise.position for sign in (-1.0, 1.0)]
    assert noises == pytest.approx([SPREAD.conditions.noise_least, SPREAD.conditions.noise_most])


@pytest.mark.parametrize("within", [0.5, 1.0])
def test_dry_friction_of_a_healthy_unit_falls_within_a_share_of_the_speed(within):
    names = unit_numbers(MODEL.actuator)
    z = np.zeros(len(names))
    z[names.index("motor.stribeck_speed")] = 2.0 * within - 1.0
    a, e = fleet_unit(MODEL, SPREAD, z, RecordConditions())
    law = e.stribeck_friction
    assert law.speed == pytest.approx(within * STRIBECK * a.control.speed_limit)
    assert (1.0 + law.increase) * a.motor.dynamic_friction == a.motor.static_friction
    assert deviations(MODEL.actuator, SPREAD, z)["motor.stribeck_speed"] == (law.speed, "rad/s")
    hidden = MODEL.effects._replace(stribeck_friction=law._replace(increase=0.8, speed=20.0))
    assert fleet_unit(MODEL, SPREAD, z, RecordConditions(), hidden)[1] == hidden


@pytest.mark.parametrize(("rate", "sampling"), [(20e3, MEAN), (10e3, MEAN), (10e3, INSTANT)])
def test_noises_of_speed_and_currents_are_read_apart(rate, sampling):
    nominal = MODEL.actuator
    a = nominal._replace(
        acquisition=nominal.acquisition._replace(sampling=sampling),
        noise=nominal.noise._replace(speed=1.6 * nominal.noise.speed,
                                     current=0.4 * nominal.noise.current))
    record = simulate(load_profile("step"), actuator=a, seed=3, rate=rate)
    model = MODEL._replace(actuator=nominal._replace(acquisition=a.acquisition))
    assert align(record, model).noise == pytest.approx((1.6, 0.4), rel=0.1)


def test_speed_that_shows_only_steps_has_the_noise_of_the_currents():
    rough = parse_effects(["quantisation.speed_bits_lost=6"], MODEL.effects)
    found = align(simulate(load_profile("step"), effects=rough, seed=3), MODEL).noise
    assert found.speed == found.current == pytest.approx(1.0, rel=0.1)


def test_conditions_are_within_the_kits():
    c = SPREAD.conditions
    drawn = [draw_fleet_conditions(np.random.default_rng(k), SPREAD) for k in range(100)]
    noises = np.array([d.noise for d in drawn])
    assert noises.min() >= c.noise_least and noises.max() <= c.noise_most
    assert abs(np.corrcoef(np.log(noises).T)[0, 1]) < 0.3  # each sensor has its own
    assert all(abs(d.bus) <= c.bus for d in drawn)


def test_residuals_of_units_left_out_are_those_of_refits():
    rng = np.random.default_rng(2)
    v = rng.uniform(-1.0, 1.0, (700, 34))
    features = np.column_stack([v[:, 0] + v[:, 1] * v[:, 2] + 0.1 * rng.normal(size=700),
                                rng.normal(size=700)])
    weights, rest = fit_mean(v, features)
    own, _ = fit_mean(v[1:], features[1:])
    missed = features[0] - design(v[:1])[0] @ own
    # The refit may centre otherwise by 1/700 and take another ridge; the residual is its own.
    assert rest[0] == pytest.approx(missed, abs=0.15)
    assert design(v)[:, :1].std() == 0.0
    assert (design(v) @ weights - features)[:, 0].std() < 0.2


def test_law_of_the_noise_is_found():
    rng = np.random.default_rng(3)
    noise = np.exp(rng.uniform(np.log(0.25), np.log(2.0), (4000, 2)))
    rest = np.column_stack([rng.normal(size=4000), noise[:, 0] * rng.normal(size=4000),
                            np.zeros(4000), 2.0 * noise[:, 1] * rng.normal(size=4000)])
    law = noise_law(rest, noise, np.full(4, 1e-6))
    assert law.quiet[0] + law.noisy[:, 0].sum() == pytest.approx(1.0, rel=0.15)
    assert law.noisy[:, 1] == pytest.approx([1.0, 0.0], abs=0.15)
    assert law.noisy[:, 3] == pytest.approx([0.0, 4.0], abs=0.6)
    assert law.quiet[1] < 0.15
    assert np.isfinite(law.covariance((1.0, 1.0))).all()
    assert law.deviation(noise[:2]) == pytest.approx(np.array(
        [law.deviation(one) for one in noise[:2]]))


@pytest.mark.parametrize(("rows", "columns"), [(400, 6), (60, 90), (40, 1)])
def test_shrinkage_is_that_of_scikit_learn(rows, columns):
    rng = np.random.default_rng(rows)
    x = rng.normal(size=(rows, columns)) @ rng.normal(size=(columns, columns))
    expected = ledoit_wolf_shrinkage(x, assume_centered=True)
    covariance, share = shrunk(x)
    assert share == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert covariance == pytest.approx((1.0 - share) * (x.T @ x) / rows, rel=1e-9)


def test_large_residuals_count_by_their_logarithm():
    x = np.linspace(-400.0, 400.0, 4001)
    assert bent(np.array([0.1]))[0] == pytest.approx(0.1, rel=1e-3)
    assert bent(np.array([500.0]))[0] == pytest.approx(5.0 * np.log(200.0), rel=1e-3)
    assert np.gradient(bent(x), x) == pytest.approx(flattening(x), abs=1e-2)


def test_a_library_of_a_test_that_there_is_not_is_refused_in_a_line(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["ema_identification", "step", "nonsense"])
    with pytest.raises(SystemExit) as refused:
        main()
    assert refused.value.code == 2
    assert "unknown profile 'nonsense'" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.slow
def test_a_library_that_this_code_would_make_is_signed_anew(tmp_path, monkeypatch):
    """A comment in a source is enough for another signature; all else stays as it is."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    kit = shutil.copytree(shipped_kit(), tmp_path / "kit")
    kept = {p: k for p in (kit / LIBRARY).glob("library_*.npz")
            if str((k := array_cache.load(p.stem, p.parent))["test"]) == "step"}
    (path, before), = kept.items()
    array_cache.save(path.stem, before | {"made_by": np.array("another")}, path.parent,
                     compressed=True)
    names = {p.name for p in path.parent.iterdir()}
    monkeypatch.setattr("sys.argv", ["ema_identification", "step", "--workers", "1"])
    with using_kit(kit):
        main()
    after = array_cache.load(path.stem, path.parent)
    assert str(after["made_by"]) == array_cache.key_of(module=library_build.MADE_BY)
    assert all((after[name] == before[name]).all() for name in before if name != "made_by")
    assert {p.name for p in path.parent.iterdir()} == names


def test_how_surface_and_shaft_stand_at_the_start_belongs_to_the_day():
    a, names = MODEL.actuator, unit_numbers(MODEL.actuator)
    reach = a.surface.static_friction / a.shaft.stiffness + a.shaft.backlash
    z = np.zeros(len(names))
    z[names.index("start.position")], z[names.index("start.twist")] = 0.5, -1.0
    profile = load_profile("step")
    assert start_of(a, profile, z[-2:]) == pytest.approx((profile.start + 0.5 * reach, -reach))
    assert deviations(a, SPREAD, z)["start.twist"] == (pytest.approx(-reach), "rad")
    assert of_day(len(z))[-2:].all()
    edge = Profile(name="edge", points=((0.0, -a.surface.end_stop), (1.0, 0.0)))
    z[names.index("start.position")] = -1.0
    assert start_of(a, edge, z[-2:])[0] == -a.surface.end_stop
