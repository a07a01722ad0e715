"""Records that many tests look at: simulated ones, each once a process, and closed forms."""

from __future__ import annotations

import dataclasses
import functools
import shutil
from pathlib import Path

import numpy as np
import yaml

from ema_prognostics.cascade.model_file import model_of, parse_model, save_model
from ema_record.actuator import Actuator, load_actuator
from ema_record.actuator_type import actuator_hash
from ema_record.kit import ACTUATOR, CASCADE, PROFILES, shipped_kit, using_kit
from ema_record.profile import Profile, load_profile, step_profile
from ema_record.record import Record
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate

TURN = 2 * np.pi
DESCRIPTION = Path(__file__).with_name("second_actuator.yaml")
SECOND_STEP = step_profile(1.4, start=-0.7, duration=1.5)
"""A test of the second actuator: nearly all of its travel."""


def second_actuator() -> Actuator:
    """Return an actuator that shares no number with the default one."""
    return load_actuator(DESCRIPTION)


@functools.lru_cache(maxsize=100)
def _simulated(profile: str | Profile, effects: tuple[str, ...], seed: int, **options) -> Record:
    loaded = load_profile(profile) if isinstance(profile, str) else profile
    return simulate(loaded, effects=parse_effects(effects), seed=seed, **options)


def record_of(profile: str | Profile, *effects: str, seed: int, **options) -> Record:
    """Return a record of the default actuator; its samples may be changed.

    Parameters
    ----------
    profile : name of a shipped profile, or one.
    effects : as on the command line, "turn_short.fraction=0.1".
    seed : of noise and start angle.
    options : further ones of `simulate` that can be compared: rate, noise, serial_number.
    """
    found = _simulated(profile, effects, seed, **options)
    return dataclasses.replace(found, samples=found.samples.copy())


def column(index, law):
    """Return what changes one channel of a record, or several, by `law`."""
    def change(record: Record) -> Record:
        samples = record.samples.copy()
        samples[:, index] = law(samples[:, index])
        return dataclasses.replace(record, samples=samples)
    return change


def without(record: Record, *columns: int) -> Record:
    """Return a record as a recorder without those channels has it."""
    return column(list(columns), lambda x: np.full_like(x, np.nan))(record)


def slewing_record(
    *, speed=790.6, rate=20_000.0, duration=0.45, speed_lines=(), current=7.0,
    current_lines=(), direction=1, noise=0.0, seed=0,
):
    """Return a step of a rotor at constant speed; lines are (harmonic, amplitude, phase)."""
    n = round(duration * rate)
    time = (np.arange(n) + 0.5) / rate
    theta = direction * speed * time + 0.3
    samples = np.zeros((n, 10))
    samples[:, 0] = time
    omega = np.full(n, direction * speed)
    for h, amplitude, phase in speed_lines:
        omega += amplitude * np.cos(h * theta + phase)
    reference = np.full(n, current)
    for h, amplitude, phase in current_lines:
        reference += amplitude * np.cos(h * theta + phase)
    samples[:, 1] = omega
    sector = np.floor(np.mod(theta - TURN / 12, TURN) / (TURN / 6)).astype(int)
    signs = np.array(
        [[1, -1, 0], [1, 0, -1], [0, 1, -1], [-1, 1, 0], [-1, 0, 1], [0, -1, 1]]
    )[sector]
    samples[:, 5:8] = signs * reference[:, None] * direction
    samples[:, 2:5] = samples[:, 5:8] * (time > 0.020)[:, None]
    samples[:, 8] = np.mod(theta, TURN)
    samples[:, 9] = -0.4 + theta / 500
    samples[:, 1:5] += noise * np.random.default_rng(seed).normal(size=(n, 4))
    return Record(samples=samples, profile=load_profile("step"))


def make_kit(folder: Path, changes: dict[str, dict[str, object]], *tests: Profile,
             cascade: bool = True) -> Path:
    """Return a new kit: the shipped one with some parameters changed, section by section.

    `tests` take the place of its tests of those names; the cascade is that of the shipped one,
    said to be its own; without `cascade` it is not trained.
    """
    shutil.copytree(shipped_kit(), folder)
    file = folder / ACTUATOR
    description = yaml.safe_load(file.read_text(encoding="utf-8"))
    for section, values in changes.items():
        description[section] = {**description.get(section, {}), **values}
    file.write_text(yaml.safe_dump(description), encoding="utf-8")
    for profile in tests:
        text = yaml.safe_dump(profile.model_dump(mode="json"))
        (folder / PROFILES / f"{profile.name}.yaml").write_text(text, encoding="utf-8")
    text = (folder / CASCADE).read_text(encoding="utf-8")
    (folder / CASCADE).unlink()
    if cascade:
        body = parse_model(text, CASCADE).body
        with using_kit(folder):
            save_model(model_of(body.model_copy(update={"actuator": actuator_hash()})),
                       folder / CASCADE)
    return folder


def second_kit(folder: Path, **options: bool) -> Path:
    """Return a kit of the second actuator, whose test ``step`` goes through all of its travel."""
    changes = yaml.safe_load(DESCRIPTION.read_text(encoding="utf-8"))
    return make_kit(folder, changes, SECOND_STEP.model_copy(update={"name": "step"}), **options)
