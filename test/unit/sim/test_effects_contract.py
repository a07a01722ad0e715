"""What every effect of the catalogue must keep; a new effect is covered by being registered."""

from __future__ import annotations

import ast
import inspect
import sys
from functools import cache
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from ema_record.errors import SimulationError, UsageError
from ema_record.profile import step_profile
from ema_sim.effects import EFFECTS, Choice, Effects, parse_effects
from ema_sim.effects import base as effect_base
from ema_sim.plant import ports, sensor_ports
from ema_sim.plant import state as st
from ema_sim.simulate import simulate
from support.actuators import Machine, both_machines, changed
from support.plant import ROWS, port_values, run, state_of

NAMES = list(EFFECTS)
SHORT = step_profile(0.03, start=-0.02, duration=0.06)


def field_of(name: str, parameter: str):
    return next(f for f in EFFECTS[name].fields if f.name == parameter)


def moved_others(name: str) -> list[Effects]:
    """Return effects with a neutral severity and every other parameter away from its default."""
    found = []
    for low in (True, False):
        values = {}
        for f in EFFECTS[name].fields:
            if f.name in EFFECTS[name].severity:
                continue
            if isinstance(f.kind, Choice):
                values[f.name] = len(f.kind.options) - 1 if low else 1
            else:
                values[f.name] = f.kind.lower if low else f.kind.upper
        if values:
            found.append(Effects()._replace(**{name: EFFECTS[name].parameters(**values)}))
    return found


def severities(name: str) -> list[tuple[str, Effects]]:
    """Return, for each severity, the effects with it moved well off neutral."""
    found = []
    for parameter in EFFECTS[name].severity:
        kind = field_of(name, parameter).kind
        default = field_of(name, parameter).default
        for bound in (kind.lower, kind.upper):
            if bound != default:
                value = default + 0.4 * (bound - default)
                found.append((parameter, parse_effects([f"{name}.{parameter}={value!r}"])))
    return found


@cache
def samples_of(machine: Machine, effects: Effects) -> np.ndarray:
    """Return the samples of a short test."""
    return simulate(SHORT, actuator=machine.actuator, rate=machine.rate, effects=effects,
                    seed=4).samples


@pytest.mark.parametrize("name", NAMES)
def test_declared_in_full(name):
    effect = EFFECTS[name]
    assert effect.name == name
    assert effect.port in get_args(effect_base.Port)
    assert effect.port in {port for port, _ in ROWS}
    assert effect.severity
    assert effect.summary.endswith(".") and len(effect.summary) > 15
    assert len(effect.equation) > 5
    assert len(effect.reference) > 5
    for f in effect.fields:
        assert f.kind.text
        if isinstance(f.kind, Choice):
            assert len(set(f.kind.options)) == len(f.kind.options) > 1
            assert 0 <= f.default < len(f.kind.options)
            assert isinstance(f.default, int)
        else:
            assert f.kind.unit
            assert np.isfinite([f.kind.lower, f.kind.upper]).all()
            assert f.kind.lower <= f.default <= f.kind.upper
            assert f.kind.lower < f.kind.upper
            assert isinstance(f.default, float)
    assert {f.name for f in effect.fields} >= set(effect.severity)
    module = sys.modules[effect.parameters.__module__]
    laws = laws_of(module)
    assert laws, "no law"
    assert all(map(inspect.getdoc, laws.values()))


def laws_of(module):
    """Return the laws that a module defines, by name: it has no other functions."""
    return {name: own for name, own in vars(module).items()
            if inspect.isfunction(own) and own.__module__ == module.__name__}


@pytest.mark.parametrize("name", NAMES)
def test_every_law_is_used_at_a_port(name):
    used = {
        node.attr for module in (ports, sensor_ports)
        for node in ast.walk(ast.parse(Path(module.__file__).read_text()))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
        and node.value.id == name
    }
    module = sys.modules[EFFECTS[name].parameters.__module__]
    assert laws_of(module).keys() <= used


@both_machines
@pytest.mark.parametrize("name", NAMES)
def test_neutral_is_absent_bit_for_bit(name, machine):
    """With a neutral severity no other parameter matters, at the ports or in a record."""
    expected = port_values(Effects(), machine.actuator)
    assert np.isfinite(expected).all()
    for effects in moved_others(name):
        assert EFFECTS[name].is_neutral(getattr(effects, name))
        assert port_values(effects, machine.actuator).tobytes() == expected.tobytes()
        neutral = samples_of(machine, Effects())
        assert samples_of(machine, effects).tobytes() == neutral.tobytes()


@both_machines
@pytest.mark.parametrize("name", NAMES)
def test_a_moved_severity_changes_its_port_and_no_other(name, machine):
    expected = port_values(Effects(), machine.actuator)
    rows_at_port = np.array([port == EFFECTS[name].port for port, _ in ROWS])
    for parameter, effects in severities(name):
        moved = np.any(port_values(effects, machine.actuator) != expected, axis=1)
        assert moved[rows_at_port].any(), f"{parameter} changes nothing"
        assert not moved[~rows_at_port].any(), [
            ROWS[i] for i in np.flatnonzero(moved & ~rows_at_port)
        ]
        samples = samples_of(machine, effects)
        assert not np.array_equal(samples, samples_of(machine, Effects()))


@both_machines
@pytest.mark.parametrize("name", NAMES)
def test_finite_at_the_bounds(name, machine):
    """At both bounds of each parameter: a finite record, or one clear line."""
    effect = EFFECTS[name]
    for f in effect.fields:
        if isinstance(f.kind, Choice):
            continue
        for bound in (f.kind.lower, f.kind.upper):
            values = {f.name: bound}
            if f.name not in effect.severity:
                severity = field_of(name, effect.severity[0])
                values[effect.severity[0]] = severity.kind.upper
            effects = Effects()._replace(**{name: effect.parameters(**values)})
            assert np.isfinite(port_values(effects, machine.actuator)).all()
            try:
                samples = samples_of(machine, effects)
            except SimulationError as error:
                assert "outside what the model holds for" in str(error)
                assert "\n" not in str(error)
            else:
                assert np.isfinite(samples).all()


@both_machines
@pytest.mark.parametrize("name", NAMES)
def test_friction_dissipates(name, machine):
    """At any setting friction opposes motion, and rest is no weaker than motion."""
    row = {what: i for i, (_, what) in enumerate(ROWS)}
    rng = np.random.default_rng(5)
    rng.uniform(0.0, 2.0 * np.pi, 60)
    omega = rng.uniform(-800.0, 800.0, 60)
    for f in EFFECTS[name].fields:
        if isinstance(f.kind, Choice):
            continue
        for bound in (f.kind.lower, f.kind.upper):
            values = port_values(
                Effects()._replace(**{name: EFFECTS[name].parameters(**{f.name: bound})}),
                machine.actuator,
            )
            for body in ("motor", "surface"):
                dynamic = values[row[f"dry dynamic, {body}"]]
                assert np.all(dynamic >= 0.0)
                assert np.all(values[row[f"dry static, {body}"]] >= dynamic)
            assert np.all(values[row["viscous, motor"]] * omega >= 0.0)


def active_settings(effects: Effects) -> dict[str, str]:
    """Return the dotted names and values that differ from neutral."""
    found = {}
    for name, effect in EFFECTS.items():
        values = getattr(effects, name)
        if effect.is_neutral(values):
            continue
        for field in effect.fields:
            value = getattr(values, field.name)
            if value != field.default or field.name in effect.severity:
                found[f"{name}.{field.name}"] = (
                    field.kind.options[value]
                    if isinstance(field.kind, Choice)
                    else f"{value!r}"
                )
    return found


@pytest.mark.parametrize("name", NAMES)
def test_dotted_names_parse_and_round_trip(name):
    for f in EFFECTS[name].fields:
        settings = []
        if f.name not in EFFECTS[name].severity:
            severity = field_of(name, EFFECTS[name].severity[0])
            settings.append(f"{name}.{severity.name}={severity.kind.upper!r}")
        value = f.kind.options[-1] if isinstance(f.kind, Choice) else repr(f.kind.lower)
        settings.append(f"{name}.{f.name}={value}")
        effects = parse_effects(settings)
        text = active_settings(effects)
        if EFFECTS[name].is_neutral(getattr(effects, name)):
            assert text == {}
        else:
            assert parse_effects(f"{k}={v}" for k, v in text.items()) == effects
        if not isinstance(f.kind, Choice):
            beyond = f.kind.upper + abs(f.kind.upper) + 1.0
            with pytest.raises(UsageError, match="out of bounds"):
                parse_effects([f"{name}.{f.name}={beyond!r}"])
        else:
            with pytest.raises(UsageError):
                parse_effects([f"{name}.{f.name}=nonsense"])


def test_friction_of_a_model_without_any_cannot_turn_negative():
    frictionless = changed(motor={"viscous_friction": 0.0, "dynamic_friction": 0.0})
    e = parse_effects(["viscous_friction.coefficient=-1e-4", "motor_friction.increase=-0.9",
                       "stribeck_friction.increase=-0.5", "surface_friction.increase=-0.9"])
    values = port_values(e, frictionless)
    row = {what: i for i, (_, what) in enumerate(ROWS)}
    assert np.all(values[row["dry dynamic, motor"]] == 0.0)
    assert np.all(values[row["viscous, motor"]] == 0.0)
    start = state_of(frictionless, omega_m=100.0)
    assert run(frictionless, start, 0.001, effects=e).state[st.OMEGA_M] <= 100.0


def test_registry_and_effects_are_the_same_list():
    folder = Path(inspect.getfile(effect_base)).parent
    files = {p.stem for p in folder.glob("*.py") if "\nEFFECT = " in p.read_text()}
    assert files == set(EFFECTS) == set(Effects._fields)
    assert active_settings(Effects()) == {}
