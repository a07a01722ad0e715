"""Parameters of nodes: types, bounds, names."""

import pytest

from ema_record.errors import UsageError
from ema_ros.parameters import ParameterSpec, check_values

FACTOR = ParameterSpec(name="factor", default=1.0, text="speed", lower=0.0, upper=10.0)
PHASE = ParameterSpec(name="short.phase", default="a", text="phase", options=("a", "b", "c"))
SEED = ParameterSpec(name="seed", default=0, text="seed", lower=0, upper=9)


def test_defaults_and_given_values():
    assert check_values([FACTOR, PHASE], {"short.phase": "b"}) == {
        "factor": 1.0, "short.phase": "b"}


def test_an_integer_serves_as_a_float_and_not_the_other_way():
    checked = FACTOR.check(2)
    assert checked == 2.0
    assert isinstance(checked, float)
    with pytest.raises(UsageError, match="expected int"):
        SEED.check(2.0)
    with pytest.raises(UsageError, match="expected int"):
        SEED.check(True)


@pytest.mark.parametrize(("spec", "value", "text"), [
    (FACTOR, 11.0, "give 0 to 10"),
    (FACTOR, float("nan"), "out of bounds"),
    (FACTOR, "fast", "expected float"),
    (SEED, -1, "give 0 to 9"),
    (PHASE, "d", "choose one of a, b, c"),
    (PHASE, 1, "expected str"),
])
def test_wrong_values(spec, value, text):
    with pytest.raises(UsageError, match=text):
        check_values([spec], {spec.name: value})


def test_unknown_names_get_the_nearest_one():
    with pytest.raises(UsageError, match=r"did you mean 'short\.phase'"):
        check_values([FACTOR, PHASE], {"shrt.phase": "b"})


def test_parameters_of_every_node_are_left_alone():
    given = {"use_sim_time": False, "qos_overrides./a.publisher.depth": 3}
    assert check_values([FACTOR], given) == {"factor": 1.0}
    with pytest.raises(UsageError, match="use_sim_time: true is not supported"):
        check_values([FACTOR], {"use_sim_time": True})
