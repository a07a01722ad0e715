"""The bench of degrading units: its flights, and that it judges as `ema check` does."""

import json

import numpy as np
import pytest

from benchmarks.detection import sequences
from benchmarks.detection.flight_scores import score_units
from benchmarks.detection.flights import TARGETS, Test, detectable_of, judge_unit, measure_all
from ema_prognostics.cascade.model_file import load_model
from ema_prognostics.features.extract import extract
from ema_prognostics.verdict.diagnose import diagnose


def test_courses_grow_irregularly_within_the_conditions():
    courses = [sequences.draw_course(unit) for unit in range(60)]
    for course in courses:
        before = course.severity[:course.repair]
        assert (np.diff(before) >= 0.0).all()
        assert len(course.tests) == 61
        temperature = [t[0]["winding_temperature.temperature"] for t in course.tests]
        assert -40.0 <= min(temperature) <= max(temperature) <= 70.0
        assert np.abs(np.diff(temperature)).max() < 50.0
        if course.kind == sequences.HEALTHY:
            assert not course.severity.any()
        else:
            low, high = sequences.FINAL[course.kind]
            assert low <= before[-1] <= high * (1 + 1e-12)
            assert course.severity[0] == 0.0
    still = [np.mean(np.diff(c.severity[c.severity > 0.0]) == 0.0) for c in courses
             if (c.severity > 0.0).sum() > 20]
    assert 0.1 < np.mean(still) < 0.7  # plateaus
    assert any(c.repair is not None for c in courses)


def test_the_same_unit_has_the_same_flights():
    first, second = (sequences.record_of(sequences.draw_course(7, 12), 3) for _ in range(2))
    assert (first.samples == second.samples).all()


def test_the_bench_resumes_and_scores(tmp_path):
    measured = list(measure_all(2, 2, tmp_path))
    files = sorted(tmp_path.iterdir())
    stamps = [f.stat().st_mtime_ns for f in files]
    again = list(measure_all(2, 2, tmp_path))
    assert [f.stat().st_mtime_ns for f in files] == stamps
    assert again == measured
    model = load_model()
    flown = [judge_unit(unit, tests, model) for unit, tests in enumerate(again)]
    assert [len(f.verdicts["baseline"]) for f in flown] == [2, 2]
    score = score_units(flown, "fleet", detectable_of(None)["fleet"])
    assert score.faults["turn_short"].units == 1
    assert score.rates["false alarms, healthy flights"].total >= 2
    assert set(score.faults) == set(TARGETS["fleet"])


@pytest.mark.slow
def test_the_bench_judges_as_the_diagnosis_does():
    course, model = sequences.draw_course(1, 12), load_model()
    record, acceptance = sequences.record_of(course, 12), sequences.record_of(course, 0)
    first, later = (Test(features=extract(r, "extended"), checks="")
                    for r in (acceptance, record))
    tests = [first, *[later] * 12]
    for view, baseline in (("fleet", None), ("baseline", acceptance)):
        mine = judge_unit(1, tests, model).verdicts[view][0]
        theirs = diagnose(record, model, baseline=baseline)
        assert mine.to_dict() == {**theirs.to_dict(), "bag": ""}


def test_detectable_sizes_from_the_detection_table(tmp_path):
    faults = {kind: {"a90_95": None} for kind in TARGETS["fleet"]}
    table = {"views": {view: {"faults": {**faults, "turn_short": {"a90_95": 0.0123}}}
                       for view in TARGETS}}
    (tmp_path / "detection.json").write_text(json.dumps(table))
    found = detectable_of(tmp_path / "detection.json")
    assert found["baseline"] == {**TARGETS["baseline"], "turn_short": 0.0123}
