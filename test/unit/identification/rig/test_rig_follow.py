"""The same parameters in every record: what was put in lies in their intervals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from ema_identification.rig.fit.model import RigModel
from ema_identification.rig.follow import follow

MODEL = RigModel.model_validate({"terms": [
    {"effect": "inertia"}, {"effect": "viscous_friction"},
    {"effect": "cogging_torque", "parameters": {"order": 8.0, "amplitude": 0.1, "phase": 0.0}},
    {"effect": "backlash", "parameters": {"gap": 0.05}}]})


def named(followed):
    return {p.name: p for p in followed.parameters}


def test_friction_and_cogging_of_each_record_lie_in_their_intervals(bench):
    levels, waves = (0.2, 0.3, 0.4), (0.1, 0.1, 0.2)
    records = [bench(lambda t, q, v, a, f=f, w=w: f * np.sign(v) + w * np.cos(8 * q), seed=k,
                     keep=("position", "speed"))
               for k, (f, w) in enumerate(zip(levels, waves))]
    inside = []
    for found, level, wave in zip(follow(records, MODEL), levels, waves):
        own = named(found)
        assert own["coulomb_friction.level"].value == pytest.approx(level, abs=0.01)
        assert own["cogging_torque.amplitude(8)"].value == pytest.approx(wave, abs=0.01)
        truth = {"inertia.value": 0.05, "viscous_friction.value": 0.4, "offset.value": 0.0,
                 "coulomb_friction.level": level, "cogging_torque.amplitude(8)": wave}
        inside += [own[name].low <= value <= own[name].high for name, value in truth.items()]
        gap = own["backlash.gap"]
        assert (gap.value, gap.low) == (0.0, 0.0) and gap.high > 0.0  # what it could hide
    assert sum(inside) >= binom.ppf(0.005, len(inside), 0.9)  # 90 % intervals


def test_a_gap_is_that_of_its_record(bench):
    def lost(gap):
        def extra(t, q, v, a):
            state = np.zeros(len(q))
            for k in range(1, len(q)):
                state[k] = min(gap / 2, max(-gap / 2, state[k - 1] + q[k] - q[k - 1]))
            crossing = np.abs(state) < gap / 2 * (1 - 1e-9)
            behind = np.gradient(np.gradient(state, t), t)  # with the blow that ends the gap
            return 0.5 * np.sign(v) - 0.03 * behind - crossing * 0.4 * np.sign(v)
        return extra

    records = [bench(lost(gap), seed=3, noise=0.01) for gap in (0.1, 0.15)]
    gaps = [named(f)["backlash.gap"].value for f in follow(records, MODEL)]
    assert gaps == pytest.approx([0.1, 0.15], rel=0.15)


def test_a_record_that_cannot_be_used_says_why_and_the_others_stand(bench):
    good = bench(lambda t, q, v, a: 0.3 * np.sign(v))
    short = replace(good, samples=good.samples[:100], source="short")
    found = follow([good, short, good], MODEL)
    assert [bool(f.why) for f in found] == [False, True, False]
    assert found[1].why.startswith("short: too short") and "\n" not in found[1].why
    assert found[0].parameters == found[2].parameters


@pytest.mark.slow
def test_without_a_model_what_the_first_and_last_record_show_is_followed(bench):
    records = [bench(), bench(lambda t, q, v, a: 0.15 * np.cos(8 * q), seed=2)]
    first, last = (named(f) for f in follow(records))
    waves = [name for name in last if name.startswith("cogging_torque")]
    assert waves == ["cogging_torque.amplitude(8)"]
    assert first[waves[0]].value < 0.01 < 0.14 < last[waves[0]].value


def test_both_sides_measured_give_the_lost_motion(bench, moving):
    _t, _q, v, a = moving()
    lost, wound = 0.02, 1e-4
    record = bench(lambda *_: 0.3 * np.sign(v), seed=0)
    output = record.samples[:, 2] - 0.5 * lost * np.sign(v) - wound * a
    channels = (*record.channels, next(c for c in record.axis.channels
                                       if c.name == "output_position"))
    both = replace(record, samples=np.column_stack([record.samples, output]), channels=channels)
    own = named(follow([both], MODEL)[0])
    assert own["sides.lost_motion"].value == pytest.approx(lost, rel=0.05)
    assert own["sides.wind_up"].value == pytest.approx(wound, rel=0.05)
