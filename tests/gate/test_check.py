"""A check passes if and only if its finite observation satisfies its limit."""

from __future__ import annotations

import json
import math
import operator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from minidual.gate.check import Check, with_unit

OPERATORS = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
}
finite = st.floats(allow_nan=False, allow_infinity=False, width=32)


@settings(max_examples=60)
@given(finite, st.sampled_from(sorted(OPERATORS)), finite)
def test_result_is_the_comparison(observed, op, limit):
    assert Check("x", observed, op, limit).passed is OPERATORS[op](observed, limit)


@pytest.mark.parametrize("op", sorted(OPERATORS))
@pytest.mark.parametrize("observed", [math.nan, math.inf, -math.inf])
def test_non_finite_observation_fails_every_limit(op, observed):
    assert Check("x", observed, op, 0.0).passed is False


@pytest.mark.parametrize(
    ("value", "text"),
    [(math.nan, "nan"), (math.inf, "inf"), (-math.inf, "-inf")],
)
def test_non_finite_observation_is_written_as_text(value, text):
    record = json.loads(json.dumps(Check("x", value, "<", 1.0).to_json(), allow_nan=False))
    assert (record["observed"], record["passed"]) == (text, False)


def test_check_without_limit_neither_passes_nor_fails():
    check = Check("x", 1.0)
    assert (check.op, check.passed, check.margin) == (None, None, None)


@pytest.mark.parametrize(
    ("op", "observed", "margin"),
    [
        ("<", 0.7, 0.3),
        ("<=", 1.2, -0.2),
        (">", 1.5, 0.5),
        (">=", 0.4, -0.6),
        ("==", 1.25, -0.25),
        ("==", 1, 0.0),
    ],
)
def test_margin_is_positive_on_the_good_side(op, observed, margin):
    assert Check("x", observed, op, 1.0).margin == pytest.approx(margin)


def test_no_margin_is_minus_zero():
    margins = [Check("x", 1, op, 1).margin for op in sorted(OPERATORS)]
    assert [str(margin) for margin in margins] == ["0.0"] * 5


@settings(max_examples=60)
@given(finite, st.sampled_from(["<", "<=", ">", ">="]), finite)
def test_sign_of_the_margin_agrees_with_the_result(observed, op, limit):
    check = Check("x", observed, op, limit)
    if check.margin != 0:
        assert (check.margin > 0) is check.passed


def test_numpy_scalars_become_plain_numbers():
    check = Check("x", np.float32(0.5), "<", np.int64(1))
    assert type(check.observed) is float
    assert type(check.limit) is int
    assert type(Check("x", np.bool_(True), "==", True).observed) is bool


@pytest.mark.parametrize(
    "arguments",
    [
        ("", 1.0, "<", 2.0),
        ("a b", 1.0, "<", 2.0),
        ("x", 1.0, "!=", 2.0),
        ("x", 1.0, "<", math.nan),
        ("x", 1.0, "<", math.inf),
        ("x", 1.0, None, 2.0),
    ],
)
def test_malformed_checks_are_refused(arguments):
    with pytest.raises(ValueError, match="check"):
        Check(*arguments)


@pytest.mark.parametrize("value", ["1.0", None, [1.0], np.ones(2)])
def test_only_numbers_are_observed(value):
    with pytest.raises(TypeError, match="x: observed"):
        Check("x", value, "<", 1.0)


def test_limit_is_required_with_an_operator():
    with pytest.raises(TypeError, match="limit"):
        Check("x", 1.0, "<")


def test_sentence_names_value_limit_and_unit():
    assert (
        Check("tilt", 0.12345, "<=", 0.0873, "rad").sentence()
        == "tilt is 0.1235 rad, limit <= 0.0873 rad"
    )
    assert with_unit(True, "") == "yes"
