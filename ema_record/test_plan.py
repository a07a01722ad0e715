from typing import NamedTuple
class TestPlan(NamedTuple):
    segments: dict
    reversals: tuple
    reversal_length: float
    starts: tuple
    full_speed: tuple
    winding_end: float
    last_time: float
def test_plan(profile, actuator):
    if len(profile.points) > 6:
        return TestPlan({"full": (0.10, 0.36), "full_back": (0.66, 0.878), "quarter": (1.09, 1.458), "quarter_back": (1.61, 1.978), "ramp": (2.12, 2.498), "ramp_back": (2.66, 2.998)},
            ((2.508, -1), (3.008, 1)), 0.075, ((0.0, 0.06), (0.47, 0.64), (0.86, 1.0), (1.44, 1.54)), ((0.06, 0.36),), 2.03, 3.083)
    return TestPlan({"full": (0.10, 0.36)}, (), 0.075, ((0.0, 0.06),), ((0.06,0.36),), 2.03, 0.36)
