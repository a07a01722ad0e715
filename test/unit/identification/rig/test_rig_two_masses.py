"""A load behind a gap, and behind a soft shaft: by its own equation of motion, not by the law."""

import numpy as np
import pytest

from ema_identification.rig.fit.model import RigModel
from ema_identification.rig.workflow import identify_rig

DRIVE, LOAD, LOAD_FRICTION = 0.03, 0.02, 1.0
FINE = 20
"""Steps of the load a sample."""


def model(*names):
    return RigModel.model_validate({"terms": [{"effect": name} for name in names]})


def values(found):
    return {p.name: p for f in found.findings for p in f.parameters}


def across_a_gap(t, q, v, gap, stiffness=2e4, damping=20.0):
    """Return position of a drive under control, its torque: it pushes a load across a gap."""
    fine = np.linspace(t[0], t[-1], FINE * (len(t) - 1) + 1)
    step, place, speed = fine[1], np.full(2, q[0]), np.full(2, v[0])
    rows = np.empty((len(fine), 2))
    for k, (x, w) in enumerate(zip(np.interp(fine, t, q), np.interp(fine, t, v))):
        torque = 40.0 * (x - place[0]) + 2.0 * (w - speed[0])
        rows[k] = place[0], torque
        wound = (place[0] - place[1]) - min(max(place[0] - place[1], -gap / 2), gap / 2)
        push = stiffness * wound + damping * (speed[0] - speed[1]) * (wound != 0.0)
        push = push if push * wound > 0.0 else 0.0
        for side, (force, mass, most) in enumerate((
                (torque - push - 0.4 * speed[0], DRIVE, 0.2), (push, LOAD, LOAD_FRICTION))):
            free, stop = speed[side] + force / mass * step, most / mass * step
            speed[side] = free - min(max(free, -stop), stop)  # friction stops, and no more
            place[side] += speed[side] * step
    return rows[::FINE].T


@pytest.mark.parametrize(("gap", "seed"), [(0.03, 1), (0.08, 2)])
def test_lost_motion_is_that_alone_with_the_blow_at_its_end(moving, recorded, axis, gap, seed):
    t, q, v, _ = moving(duration=10.0, seed=seed)
    x, u = across_a_gap(t, q, v, gap)
    found = identify_rig([recorded(t, u, axis, seed=seed, position=x)], model(
        "inertia", "viscous_friction", "coulomb_friction"))
    assert [f.effect for f in found.findings] == ["backlash"]
    own = values(found)
    assert own["backlash.gap"].value == pytest.approx(gap, rel=0.1)
    assert own["backlash.inertia"].value == pytest.approx(LOAD, rel=0.2)
    assert own["backlash.friction"].value == pytest.approx(LOAD_FRICTION, rel=0.2)


@pytest.mark.parametrize("friction", [0.0, 0.6])
def test_a_sharp_resonance_is_found_between_the_points_of_the_grid(
        recorded, axis, friction):
    resonance, t = 5.2, np.arange(4000) / 250.0
    rng = np.random.default_rng(52)
    omega, damping = 2 * np.pi * resonance, 0.015
    q, u = np.zeros((2, len(t)), complex)
    for w in 2 * np.pi * np.geomspace(0.4, 12.0, 24):
        load = 40.0 / w**2 * np.exp(1j * (w * t + rng.uniform(0, 2 * np.pi)))
        wound = -w**2 * load / (omega**2 + 2j * damping * omega * w)  # the spring moves the load
        q += load + wound
        u += -w**2 * (DRIVE * (load + wound) + LOAD * load) + 0.4j * w * (load + wound)
    v = np.gradient(q.real, t)
    found = identify_rig([recorded(t, u.real + friction * np.sign(v), axis, position=q.real)])
    assert {f.effect for f in found.findings} == {
        "compliance", *(["coulomb_friction"] if friction else [])}
    own = values(found)
    assert own["compliance.frequency"].value == pytest.approx(resonance, rel=0.01)
    assert own["compliance.damping"].value == pytest.approx(damping, abs=0.01)
    assert own["compliance.load_inertia"].value == pytest.approx(LOAD, rel=0.1)
