"""The cascade at work on networks that say what they see: which, how much, doubt, strangers."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from ema_prognostics.cascade.classes import (
    CLASS_OF,
    FAMILIES,
    KINDS_FOUND,
    OUTPUTS,
    SEVERITY_OF,
    probability_known,
)
from ema_prognostics.cascade.find import Cascade, Detection
from ema_prognostics.cascade.guard import STRANGER_RATE, Guard, Strange
from ema_prognostics.networks.network import logsig

NAMES = ["line_m1_re", "line_m1_im", "friction", "strange"]
LEAST, DOUBT = 0.02, 0.5


def sized(value: np.ndarray) -> np.ndarray:
    """Return value and interval, twice as wide in company."""
    half = np.outer(np.full(len(value), 0.01), [1.0, 2.0])
    value = np.column_stack([value, value])
    return np.stack([value, value - half, value + half], axis=2)


def likely(size: np.ndarray, unit: float = 0.05) -> np.ndarray:
    return np.asarray(logsig(4.0 * (size / unit - 1.0)))


class SeesAll(Cascade):
    """The line of a short, from its phase, is its size; friction stands in its own feature."""

    def __init__(self, **families: float) -> None:
        none = lambda u: np.full(len(u), 1e-6)  # noqa: E731
        self.view = SimpleNamespace(names=NAMES, doubt=DOUBT, families=dict.fromkeys(
            FAMILIES, SimpleNamespace(knots=[-50.0, 50.0], logits=[-50.0, 50.0])))
        self.inputs = lambda x: x
        self._threshold = np.zeros(len(FAMILIES))
        self._families = {**dict.fromkeys(FAMILIES, none),
                          "asymmetry": lambda u: likely(np.hypot(u[:, 0], u[:, 1])),
                          "motor_friction": lambda u: likely(u[:, 2], 0.3),
                          **{n: lambda u, p=p: np.full(len(u), p) for n, p in families.items()}}
        named = {SEVERITY_OF[o] for f in FAMILIES.values() if len(f) > 1 for o in f}
        self._members = {**dict.fromkeys(named, none),
                         "short": lambda u: likely(u[:, 0])}

        def severity(column: int) -> SimpleNamespace:
            class Network(SimpleNamespace):
                def __call__(self, u: np.ndarray) -> np.ndarray:
                    return sized(np.maximum(u[:, column], 0.0))
            return Network(least=LEAST)

        self._severity = {name: severity(2 if "friction" in name else 0)
                          for name in SEVERITY_OF.values()}
        self.kinds: list[str] = []

        def scores(u, kind, *, exact):
            self.kinds += [KINDS_FOUND[k] for k in kind]
            return np.zeros((len(u), 3)), np.full(len(u), 0.98)

        self.guard = SimpleNamespace(scores=scores, bounded=lambda turned: turned)
        self._strangers = lambda turned, kind: Strange(
            turned[0][:, 3], ("sag",) * len(kind), STRANGER_RATE ** turned[0][:, 3] ** 2)


def short(phase: int, size: float, friction: float = 0.0, strange: float = 0.0) -> np.ndarray:
    line = size * np.exp(-2j * np.pi / 3.0 * phase)
    return np.array([[line.real, line.imag, friction, strange]])


def found(x: np.ndarray, *, exact: bool = True, **families: float) -> Detection:
    return SeesAll(**families).find(x, exact=exact)[0]


@pytest.mark.parametrize("phase", [0, 1, 2])
def test_a_short_is_named_and_measured_as_seen_from_its_own_phase(phase):
    detection = found(short(phase, 0.1))
    assert detection.outputs == (f"short_{'abc'[phase]}",)
    (size,) = detection.severity
    assert (size.value, size.lower, size.upper) == pytest.approx((0.1, 0.09, 0.11))
    assert not detection.doubtful


def test_of_two_faults_each_has_the_interval_of_company():
    detection = found(short(1, 0.1, friction=0.8))
    assert set(detection.outputs) == {"short_b", "motor_friction"}
    assert [s.upper - s.lower for s in detection.severity] == pytest.approx([0.04, 0.04])


@pytest.mark.parametrize(("size", "doubtful"), [(0.1, False), (0.0, True)])
def test_a_fault_too_small_to_be_told_is_doubt_and_no_name(size, doubtful):
    detection = found(short(1, size), asymmetry=0.9)
    assert (detection.outputs == (), detection.doubtful) == (doubtful, doubtful)
    assert detection.margin.max() > 0.0


@pytest.mark.parametrize(("each", "doubtful"), [(0.4, True), (0.02, False)])
def test_where_healthy_is_improbable_and_nothing_certain_there_is_doubt(each, doubtful):
    detection = found(short(0, 0.0), surface_friction=each, backlash=each)
    assert detection.outputs == () and (detection.margin < 0.0).all()
    assert (detection.healthy < DOUBT) is detection.doubtful is doubtful


def test_the_guard_knows_what_is_named_though_its_size_is_nothing():
    cascade = SeesAll(motor_friction=0.9, surface_friction=1e-6)
    cascade._severity["motor_friction"].least = 0.0
    cascade.find(np.vstack([short(0, 0.0), short(1, 0.1), short(1, 0.1, friction=0.8)]))
    assert cascade.kinds == ["slight", "both", "both"]
    plain = SeesAll()
    plain.find(np.vstack([short(0, 0.0), short(1, 0.1)]))
    assert plain.kinds == ["healthy", "electrical"]


def test_a_stranger_makes_a_record_less_known_only_in_the_test_trained_on():
    usual, strange = found(short(0, 0.0)), found(short(0, 0.0, strange=1.5))
    assert usual.known == pytest.approx(min(0.98, float(probability_known(np.array([1.0]))[0])))
    rate = np.array([STRANGER_RATE ** 1.5**2])
    assert strange.known == pytest.approx(float(probability_known(rate)[0]))
    assert strange.unusual() and not strange.unusual(stranger=False) and not usual.unusual()
    assert (strange.stranger, strange.stranger_kind) == (1.5, "sag")
    other = found(short(0, 0.0, strange=1.5), exact=False)
    assert other.known == 0.98 and not other.unusual()


def test_the_probability_of_a_class_is_that_of_its_likeliest_output():
    p = dict.fromkeys(OUTPUTS, 0.0) | {"short_a": 0.1, "short_b": 0.5, "short_c": 0.2,
                                       "backlash": 0.2}
    detection = Detection(
        outputs=(), severity=(), probability=np.array(list(p.values())), margin=-np.ones(5),
        guard=np.zeros(3), stranger=0.0, stranger_kind="", known=0.9, doubtful=False)
    assert detection.healthy == pytest.approx(0.5 * 0.8)
    assert detection.class_probability == pytest.approx({
        "healthy": 0.9 * 0.4, "turn_short": 0.45, "rotor_eccentricity": 0.0, "friction": 0.0,
        "backlash": 0.18, "unknown": 0.1})
    assert set(CLASS_OF.values()) < set(detection.class_probability)


def test_what_a_stranger_is_told_by_is_less_where_limits_grow():
    guard = SimpleNamespace(beyond=lambda u: np.array([1.0, 2.0]))
    (less,) = Guard.bounded(guard, [np.array([[3.0, 1.0], [3.0, 1.0]])])
    assert less == pytest.approx(np.array([[3.0, 1.0], [1.5, 0.5]]))
