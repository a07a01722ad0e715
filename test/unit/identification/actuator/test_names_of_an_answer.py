"""Which names an answer has, of models whose evidence is given: closed cases, nothing is run."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from ema_identification.actuator.decision import decide
from ema_identification.actuator.decision.answer import FleetAnswer, instead_of, order_of
from ema_identification.actuator.decision.decide import _named


def model(log: float, *names: str) -> SimpleNamespace:
    return SimpleNamespace(
        names=names, variants=names, terms=names, log=log, cost=100.0 - log, z=np.zeros(1))


NULL = model(-50.0)


def case_of(alone: tuple[SimpleNamespace, ...], useless: tuple[str, ...] = (), untold: str = ""
            ) -> SimpleNamespace:
    return SimpleNamespace(
        nothing=NULL.cost, null=NULL, evidence=lambda f: f.log, explains=lambda f: f.log > -10.0,
        p_own=lambda f, less: 0.5 if useless and less == alone[0].cost else 0.0,
        each_alone=lambda *_: list(alone), unit=SimpleNamespace(edge=1.0),
        remeasured=lambda fit: (None, fit),
        needs=lambda fit, sizes, alone: not set(untold) & set(fit.names))


def answered(*explaining: SimpleNamespace, alone: tuple[SimpleNamespace, ...] = (),
             useless: tuple[str, ...] = ()) -> FleetAnswer:
    return _named(case_of(alone, useless), FleetAnswer(verdict="unknown effect", null=NULL),
                  list(explaining))


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


@pytest.mark.parametrize(("untold", "named", "said"), [
    ("", ("a", "b"), ""), ("b", ("a",), "with a and b, but"), ("ab", None, "a and b, or a, but")])
def test_of_two_of_which_one_has_no_size_the_other_may_be_named(untold, named, said, monkeypatch):
    """Not a third: it is not needed, though it has a size."""
    monkeypatch.setattr(decide, "p_sizes", lambda *_: ())
    pair, alone = model(0.0, "a", "b"), (model(-5.0, "a"), model(-40.0, "b"))
    laws, case = [pair, model(-6.0, "c")], case_of(alone, untold=untold)
    found = decide._measured(case, case, answered(*laws, alone=alone), laws)
    assert (None if found.fit is None else found.fit.names) == named
    assert (found.verdict == "explained") is (named is not None)
    assert said in " ".join(found.reasons)


def test_where_a_law_has_no_size_no_other_one_is_named(monkeypatch):
    """What is left without any law is usual there."""
    monkeypatch.setattr(decide, "p_sizes", lambda *_: ())
    laws, case = [model(0.0, "a"), model(-6.0, "c")], case_of((), untold="a")
    found = decide._measured(case, case, answered(*laws), laws)
    assert (found.verdict, found.fit) == ("unknown effect", None)
    assert found.reasons == ("less is left with a, but no size of it is told from none",)


def test_a_name_stands_in_the_place_of_another_if_all_else_is_equal():
    kept = [frozenset(names) for names in ("ab", "ac", "de", "c")]
    assert instead_of(model(0.0, "a", "b"), "b", kept) == ("c",)
    assert instead_of(model(0.0, "a", "b"), "a", kept) == ()


def test_what_leaves_least_alone_comes_first():
    alone = model(-40.0, "a"), model(0.0, "b")
    assert order_of(FleetAnswer(verdict="explained", null=NULL, alone=alone)) == [1, 0]
    assert order_of(FleetAnswer(verdict="explained", null=NULL)) == [0]
