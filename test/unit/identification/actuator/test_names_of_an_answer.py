"""Which names an answer has, of models whose evidence is given: closed cases, nothing is run."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from ema_identification.actuator.decision.answer import FleetAnswer, instead_of, order_of
from ema_identification.actuator.decision.decide import _named


def model(log: float, *names: str) -> SimpleNamespace:
    return SimpleNamespace(names=names, variants=names, terms=names, log=log, cost=100.0 - log)


NULL = model(-50.0)


def answered(*explaining: SimpleNamespace, alone: tuple[SimpleNamespace, ...] = (),
             useless: tuple[str, ...] = ()) -> FleetAnswer:
    case = SimpleNamespace(
        nothing=NULL.cost, null=NULL, evidence=lambda f: f.log, explains=lambda f: f.log > -10.0,
        p_own=lambda f, less: 0.5 if useless and less == alone[0].cost else 0.0,
        each_alone=lambda *_: list(alone))
    return _named(case, FleetAnswer(verdict="unknown effect", null=NULL), list(explaining))


@pytest.mark.parametrize(("logs", "others"), [
    ((0.0, -3.5), ()), ((0.0, -2.0), ("b",)), ((0.0, -1.0, -2.0, -8.0), ("b", "c"))])
def test_names_are_the_smallest_set_with_nineteen_parts_in_twenty_of_the_evidence(logs, others):
    found = answered(*(model(log, name) for log, name in zip(logs, "abcd")))
    assert (found.verdict, found.fit.names, found.equivalent) == ("explained", ("a",), (others,))


def test_four_names_are_no_answer_and_are_told():
    found = answered(*(model(log, name) for log, name in zip((-1.0, 0.0, -1.0, -2.0), "abcd")))
    assert (found.verdict, found.fit) == ("unknown effect", None)
    assert found.equivalent == (("a", "b", "c", "d"),)
    assert "4 explanations are equally good" in found.reasons[0]


def test_of_two_names_each_closes_what_the_other_leaves():
    pair, alone = model(0.0, "a", "b"), (model(-10.0, "a"), model(-40.0, "b"))
    found = answered(pair, alone=alone)
    assert found.fit is pair and found.alone == alone
    assert found.closed == pytest.approx((0.8, 0.2))  # a: of what b alone leaves; b: of a's


def test_a_second_name_that_adds_no_more_than_useless_ones_is_none():
    pair, alone = model(0.0, "a", "b"), (model(-5.0, "a"), model(-40.0, "b"))
    assert answered(pair, alone=alone, useless=("b",)).fit.names == ("a",)


def test_of_the_set_the_simplest_model_is_named():
    one, pair = model(-1.0, "a"), model(0.0, "b", "c")
    assert answered(one, pair, alone=(model(-40.0, "b"), model(-40.0, "c"))).fit is one


def test_a_law_that_gets_a_second_is_no_answer_alone():
    pair, alone = model(0.0, "a", "b"), (model(2.0, "a"), model(-40.0, "b"))
    found = answered(alone[0], pair, alone=alone)
    assert found.fit is pair and found.equivalent == ((), ())


def test_a_name_stands_in_the_place_of_another_if_all_else_is_equal():
    kept = [frozenset(names) for names in ("ab", "ac", "de", "c")]
    assert instead_of(model(0.0, "a", "b"), "b", kept) == ("c",)
    assert instead_of(model(0.0, "a", "b"), "a", kept) == ()


def test_what_leaves_least_alone_comes_first():
    alone = model(-40.0, "a"), model(0.0, "b")
    assert order_of(FleetAnswer(verdict="explained", null=NULL, alone=alone)) == [1, 0]
    assert order_of(FleetAnswer(verdict="explained", null=NULL)) == [0]
