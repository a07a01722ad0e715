"""Records of other recorders: fewer channels, other rates, finer, coarser, quieter converters."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from ema_record.actuator import load_actuator
from ema_record.bag.read import write_bag
from ema_record.channels import ALL
from ema_record.checks.facts import facts_of_record
from ema_record.checks.guard import guard_findings, outcome_of
from ema_record.checks.live import Level, check_record, worst
from ema_record.checks.run import lint_bag
from ema_record.checks.sensors import held_share
from ema_record.checks.stream import irregular, reception_clock
from ema_record.checks.whole_turns import RULES, WholeTurns, whole_turns
from ema_record.record import SampleBlock
from support.actuators import changed
from support.simulations import column, record_of, second_actuator, without

FLAGS = {4: "phase_current_c", 5: "reference_currents", 8: "rotor_angle", 9: "surface_position"}
ABSENT = {
    "third current": (4,), "references": (5, 6, 7), "angle": (8,), "position": (9,),
    "all but the least": (4, 5, 6, 7, 8, 9), "angle and position": (8, 9),
    "third current and references": (4, 5, 6, 7),
}
ROW = 3000


def kit_of(columns):
    """Return the default actuator with an acquisition that lacks these columns."""
    return changed(acquisition={FLAGS[c]: 0 for c in columns if c in FLAGS})


def rules(record, actuator=None):
    return [finding.rule for finding in guard_findings(record, actuator)]


def test_a_dead_current_sensor_is_in_no_other_unit():
    record = record_of("extended", seed=1)
    record.samples[:, 3] = noise(0.01)(np.zeros(len(record.samples)))
    findings = guard_findings(record)
    assert "wrong_unit" not in [f.rule for f in findings]
    assert any(f.rule == "stuck_channel" and "phase_current_b" in f.message for f in findings)
    assert outcome_of(findings) == "unknown"


def noise(deviation):
    return lambda x: x + np.random.default_rng(1).normal(0.0, deviation, len(x))


def stuck(x):
    return np.where(np.arange(len(x)) < ROW, x, x[ROW])


@pytest.mark.parametrize("columns", ABSENT.values(), ids=ABSENT)
@pytest.mark.parametrize("effects", [
    (), ("turn_short.fraction=0.3", "turn_short.phase=b"), ("motor_friction.increase=1.0",),
    ("rotor_eccentricity.zeta=0.3", "rotor_eccentricity.mode=shifted"),
])
@pytest.mark.parametrize("profile", ["step", "extended"])
def test_what_a_recorder_lacks_is_no_defect(profile, effects, columns):
    record, actuator = without(record_of(profile, *effects, seed=3), *columns), kit_of(columns)
    assert rules(record, actuator) == []
    assert worst(check_record(record, actuator)) == Level.OK


@pytest.mark.parametrize("columns", ABSENT.values(), ids=ABSENT)
def test_what_the_kit_says_is_recorded_must_be_there(columns, tmp_path):
    record = without(record_of("step", seed=3), *columns)
    found = guard_findings(record)
    assert [f.rule for f in found] == ["missing_channel"] and outcome_of(found) == "unknown"
    assert "the acquisition of the default kit records" in found[0].message
    (finding,) = lint_bag(write_bag(record, tmp_path / "bag")).findings
    assert finding.rule == "missing_channel"
    assert rules(record_of("step", seed=3), kit_of(columns)) == [], "more than the kit says"


FLAWS = {
    "speed in rpm": ("wrong_unit", 1, lambda x: x * 30.0 / np.pi),
    "angle in degrees": ("wrong_unit", 8, np.degrees),
    "position in degrees": ("wrong_unit", 9, np.degrees),
    "speed scaled": ("sensor_scale", 1, lambda x: 1.1 * x),
    "position scaled": ("sensor_scale", 9, lambda x: 0.9 * x),
    "current held": ("held_samples", 2, lambda x: x[np.arange(len(x)) // 2 * 2]),
    "current stuck": ("stuck_channel", 3, stuck),
    "speed stuck": ("stuck_channel", 1, stuck),
    "position stuck": ("stuck_channel", 9, stuck),
    "current at rest": ("sensor_offset", 2, lambda x: x - 1.0),
    "current later": ("sensor_offset", 2, lambda x: x + (np.arange(len(x)) > ROW)),
    "speed noisy": ("sensor_noise", 1, noise(20.0)),
    "spike": ("spike", 3, lambda x: x + 60.0 * (np.arange(len(x)) == ROW)),
    "no number": ("not_finite", 3, lambda x: np.where(np.arange(len(x)) == ROW, np.nan, x)),
    "sign of the speed": (("sign_flip", "swapped_phases"), 1, np.negative),
    "sign of a current": (("sign_flip", "swapped_phases"), 2, np.negative),
}
ALONE = {("speed scaled", "all but the least"), ("speed scaled", "angle and position")}
"""What nothing else in the record says."""


@pytest.mark.parametrize(("name", "absent"), [
    (name, absent) for name, (_, index, _) in FLAWS.items() for absent in ABSENT
    if index not in ABSENT[absent]])
def test_flaws_are_found_with_the_channels_that_there_are(name, absent):
    rule, index, law = FLAWS[name]
    record = column(index, law)(without(record_of("step", seed=3), *ABSENT[absent]))
    found = rules(record, kit_of(ABSENT[absent]))
    expected = {rule} if isinstance(rule, str) else set(rule)
    assert bool(expected & set(found)) == ((name, absent) not in ALONE)


@pytest.mark.parametrize("absent", ABSENT)
def test_swapped_phases_and_lost_samples(absent):
    actuator, record = kit_of(ABSENT[absent]), without(record_of("step", seed=3), *ABSENT[absent])
    assert "swapped_phases" in rules(column([2, 3], lambda x: x[:, ::-1])(record), actuator)
    lost = np.delete(record.samples, slice(ROW, ROW + 90), axis=0)
    assert rules(replace(record, samples=lost), actuator)[0] == "gap"


def test_a_part_of_a_channel_is_a_defect():
    record = record_of("step", seed=3)
    record.samples[:ROW, 8] = np.nan
    assert rules(record)[0] in ("gap", "not_finite")
    result = {r.name: r for r in check_record(record)}["finite"]
    assert result.level == Level.ERROR and "rotor_angle" in result.message


@pytest.mark.parametrize("rate", [2_500.0, 5_000.0, 50_000.0])
@pytest.mark.parametrize("effects", [(), ("turn_short.fraction=0.3", "turn_short.phase=b")])
def test_other_rates(rate, effects):
    actuator = changed(acquisition={"rate": rate})
    record = record_of("step", *effects, seed=3, actuator=actuator)
    assert rules(record, actuator) == []
    assert worst(check_record(record, actuator)) == Level.OK
    k = np.arange(len(record)) - len(record) // 3
    for rule, index, law in (
        FLAWS["speed in rpm"], FLAWS["position scaled"], FLAWS["current at rest"],
        ("stuck_channel", 3, lambda x: np.where(k < 0, x, x[np.argmin(np.abs(k))])),
        ("spike", 3, lambda x: x + 60.0 * (k == 0)),
    ):
        assert rule in rules(column(index, law)(record), actuator)


BITS = ("position_bits", "speed_bits", "current_bits", "angle_bits")


@pytest.mark.parametrize("bits", [12, 14, 32])
@pytest.mark.parametrize("level", [0.0, 0.25, 2.0])
@pytest.mark.parametrize("profile", ["step", "extended"])
def test_better_is_never_suspicious(profile, level, bits):
    """No noise at all, no rounding, or a coarse converter: the kit says what was expected."""
    other = changed(converters=dict.fromkeys(BITS, bits))
    record = record_of(profile, seed=3, actuator=other, noise=level)
    assert rules(record) == []


def test_an_exact_sum_is_not_suspicious():
    record = record_of("extended", seed=3)
    record.samples[:, 4] = -record.samples[:, 2] - record.samples[:, 3]
    record.samples[:, 7] = -record.samples[:, 5] - record.samples[:, 6]
    assert rules(record) == []


def test_what_repeats_and_what_is_held():
    rng, driven = np.random.default_rng(2), np.ones(20_000, dtype=bool)
    true = np.cumsum(rng.normal(0.0, 1.0, 20_001))
    assert held_share(np.abs(np.diff(true)), driven)[0] == 0.0
    coarse = np.abs(np.diff(np.rint(true)))
    assert (coarse == 0.0).mean() > 0.2 and held_share(coarse, driven)[0] == 0.0
    for every in (2, 3, 8):
        kept = np.rint(50.0 * true[np.arange(20_001) // every * every])
        share = held_share(np.abs(np.diff(kept)), driven)[0]
        assert share == pytest.approx(1.0 - 1.0 / every, abs=0.02)
    kept = np.where(rng.random(20_001) < 0.1, np.nan, np.rint(50.0 * true))  # now and then
    rows = np.maximum.accumulate(np.where(np.isnan(kept), 0, np.arange(20_001)))
    assert held_share(np.abs(np.diff(kept[rows])), driven)[0] == pytest.approx(0.1, abs=0.03)
    still = np.where(np.arange(20_001) % 100 < 50, 0.0, np.rint(50.0 * true))
    assert held_share(np.abs(np.diff(still)), driven)[0] == 0.0


class Sinusoidal:
    """A record in closed form: sinusoidal currents at constant speed, both ways (drive foc)."""

    actuator = changed(second_actuator(), drive={"kind": 2})

    def __init__(self, rate=10_000.0, lag=0.0):
        a = self.actuator
        n = round(1.2 * rate)
        time = (np.arange(n) + 0.5) / rate
        speed = np.interp(time, [0.1, 0.12, 0.6, 0.64, 1.12, 1.14],
                          [0.0, 100.0, 100.0, -100.0, -100.0, 0.0])
        motor = np.cumsum(speed) / rate
        theta = a.motor.pole_pairs * motor + 0.3
        q = 8.0 * np.tanh(speed / 20.0)
        phases = 2.0 * np.pi / 3.0 * np.arange(3)
        self.samples = np.zeros((n, 10))
        self.samples[:, 0], self.samples[:, 1] = time, speed
        self.samples[:, 5:8] = q[:, None] * np.sin(theta[:, None] - phases)
        self.samples[:, 2:5] = q[:, None] * np.sin(theta[:, None] - phases - lag)
        self.samples[:, 8] = np.mod(theta, 2.0 * np.pi)
        self.samples[:, 9] = motor / a.gear.ratio

    def record(self):
        from ema_record.profile import load_profile_dict
        from ema_record.record import Record

        course = np.column_stack([self.samples[:, 0], self.samples[:, 9]])[::200]
        end = (len(self.samples)) / 10_000.0
        points = [(0.0, 0.0), *map(tuple, course[1:].tolist()), (end, float(course[-1, 1]))]
        profile = load_profile_dict({"name": "both-ways", "points": points}, "test")
        return Record(samples=self.samples.copy(), profile=profile)


@pytest.mark.parametrize("lag", [0.0, 0.3])
def test_sinusoidal_references_of_a_drive_with_field_orientation(lag):
    record, actuator = Sinusoidal(lag=lag).record(), Sinusoidal.actuator
    assert rules(record, actuator) == []
    for factor, found in ((1.1, ["sensor_scale"]), (0.97, [])):
        scaled = record.samples.copy()
        scaled[:, 2:5] *= factor
        assert rules(replace(record, samples=scaled), actuator) == found
    swapped = record.samples.copy()
    swapped[:, [2, 4]] = swapped[:, [4, 2]]
    assert "swapped_phases" in rules(replace(record, samples=swapped), actuator)


@pytest.mark.parametrize("effects", [(), ("turn_short.fraction=0.3", "turn_short.phase=b")])
def test_two_currents_over_whole_turns(effects):
    """Without the third one: gain and offset, from some moment on; a fault is neither."""
    columns = ABSENT["third current and references"]
    record, actuator = without(record_of("extended", *effects, seed=4), *columns), kit_of(columns)
    assert rules(record, actuator) == []
    late = np.arange(len(record)) > len(record) // 3
    assert "sensor_offset" in rules(column(2, lambda x: x + 1.0 * late)(record), actuator)
    if not effects:
        scaled = column(2, lambda x: x * (1.0 + 0.15 * late))(record)
        assert rules(scaled, actuator) == ["sensor_scale"]


@pytest.mark.parametrize(("means", "ratios", "found"), [
    ([2.0, 2.1, -3.1], [1.0], []), ([2.0, 2.1, 1.9], [1.0], ["sensor_offset"]),
    ([0.0], [1.2, 1.25, 0.85], []), ([0.0], [1.2, 1.22, 1.18], ["sensor_scale"]),
])
def test_what_a_sensor_does_it_does_in_every_turn(means, ratios, found):
    """A motor that sticks and slips carries more in one phase for some turns, not for all."""
    columns = ABSENT["third current and references"]
    facts = facts_of_record(without(record_of("extended", seed=4), *columns), kit_of(columns))
    n, size = 30, np.full((30, 2), 4.0)
    size[:, 0] *= np.resize(ratios, n)
    facts.derived(whole_turns)
    facts._derived[whole_turns] = WholeTurns(
        0.02 * np.arange(n), np.full(n, 0.25 * facts.actuator.control.speed_limit),
        np.column_stack([np.resize(means, n), np.zeros(n)]), size)
    assert [rule.name for rule in RULES if list(rule.find(facts))] == found


def test_turns_of_a_motor_that_creeps_are_not_compared():
    """Of one that could turn three times as fast, a quarter of the speed is below a tenth."""
    record = without(record_of("extended", seed=4), *ABSENT["third current and references"])
    highest = load_actuator().control.speed_limit
    for most, slow in ((highest, True), (3.0 * highest, False)):
        facts = facts_of_record(record, changed(control={"speed_limit": most}))
        speed = whole_turns(facts).speed
        assert (speed > 0.9 * highest).any()
        assert (speed < 0.3 * highest).any() == slow


@pytest.mark.parametrize("angle", [0.0, 0.6, 1.05])
def test_a_motor_that_does_not_turn_is_in_no_other_unit(angle):
    """Currents of a rotor that stands are in proportion to references of any phase."""
    record = record_of("step", seed=4)
    samples, rng = record.samples.copy(), np.random.default_rng(3)
    asked = 20.0 * np.cos(angle - 2.0 * np.pi / 3.0 * np.arange(3))
    live = samples[:, 0] > record.profile.inverter_off + 0.01
    samples[:, 1], samples[:, 8], samples[:, 9] = 0.0, samples[0, 8], samples[0, 9]
    current = np.where(live[:, None], asked, 0.0)
    samples[:, 5:8] = current * (1.0 + 0.3 * np.sin(200.0 * samples[:, :1]))
    samples[:, 2:5] = current + 0.1 * rng.standard_normal((len(samples), 3))
    found = {f.rule for f in guard_findings(replace(record, samples=samples))}
    assert not found & {"wrong_unit", "swapped_phases", "sign_flip"}
    samples[:, 2:5] *= 1000.0
    found = {f.rule for f in guard_findings(replace(record, samples=samples))}
    assert "wrong_unit" in found


def test_all_channels_are_meant():
    assert {c for columns in ABSENT.values() for c in columns} | {0, 1, 2, 3} == set(ALL)
    assert load_actuator().acquisition.rotor_angle == 1


def blocks_of(record, *, pace, begin):
    """Return facts of a record whose blocks came from `begin` (s) on, `pace` times as fast."""
    start, samples = 1_700_000_000_000_000_000, record.samples
    blocks = [
        SampleBlock(start + round(1e9 * (begin + 0.02 * number / pace)), samples[row:row + 400])
        for number, row in enumerate(range(0, len(samples), 400))
    ]
    provenance = replace(record.provenance, start_time=start)
    return replace(facts_of_record(record), blocks=blocks, provenance=provenance)


@pytest.mark.parametrize("pace", [100.0, 3.0, 0.05])
def test_samples_that_come_after_the_move_come_in_a_time_of_their_own(pace):
    record = record_of("step", seed=1)
    facts = blocks_of(record, pace=pace, begin=0.5)
    assert facts.uploaded
    assert list(reception_clock(facts)) == []
    assert irregular(facts) == []


@pytest.mark.parametrize("pace", [100.0, 0.05])
def test_samples_that_an_upload_lacks_are_missing(pace):
    record = record_of("step", seed=1)
    record = replace(record, samples=np.delete(record.samples, slice(4000, 4400), axis=0))
    ((kind, hit),) = irregular(blocks_of(record, pace=pace, begin=0.5))
    assert kind == "gap" and hit.message == "400 samples are missing after 0.2000 s"


def test_a_clock_that_jumps_while_samples_stream_is_found():
    record = record_of("step", seed=1)
    facts = blocks_of(record, pace=1.0, begin=0.02)
    assert not facts.uploaded
    assert list(reception_clock(facts)) == []
    late = [SampleBlock(b.log_time + 300_000_000 * (k > 10), b.samples)
            for k, b in enumerate(facts.blocks)]
    (hit,) = reception_clock(replace(facts, blocks=late))
    assert hit.message == "the recorder's clock jumps by 0.300 s against the samples'"


@pytest.mark.parametrize("profile", ["step", "extended"])
@pytest.mark.parametrize("delay", [2e-4, 1e-3, 4e-3])
def test_a_speed_that_comes_late_is_no_offset(profile, delay):
    """A first-order low-pass, as where the speed is an encoder's differences: it lags by its time.

    One that is off beside that still is.
    """
    def low_pass(x):
        return lfilter([1.0 - pole], [1.0, -pole], x, zi=[pole * x[0]])[0]

    pole = np.exp(-5e-5 / delay)
    record = column(1, low_pass)(record_of(profile, seed=3))
    assert rules(record) == []
    off = column(1, lambda x: low_pass(x) + 30.0 * (np.arange(len(x)) > ROW))
    assert "sensor_offset" in rules(off(record_of(profile, seed=3)))
