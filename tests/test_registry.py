"""One table a family: names are unique, unknown ones are answered, rows load when they are asked for."""

from __future__ import annotations

import importlib.metadata

import pytest

from minidual.errors import UsageError
from minidual.registry import Registry


def plug(monkeypatch, *points):
    found = [importlib.metadata.EntryPoint(name, value, "minidual.tests") for name, value in points]
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: found if group == "minidual.tests" else [])


def test_a_row_is_itself_or_what_its_target_names():
    table = Registry("number", {"pi": "math:pi", "two": 2})
    assert (table["pi"], table["two"]) == (pytest.approx(3.14159, abs=1e-5), 2)
    assert list(table) == ["pi", "two"]
    assert "pi" in table
    assert len(table) == 2


def test_a_name_twice_is_refused():
    table = Registry("number", {"two": 2})
    with pytest.raises(ValueError, match="number 'two' is in the table already"):
        table.add("two", 3)


def test_an_unknown_name_is_answered_with_what_exists():
    with pytest.raises(UsageError, match="no number 'tow'") as caught:
        Registry("number", {"two": 2, "three": 3})["tow"]
    assert "two" in str(caught.value)


@pytest.mark.parametrize("target", ["no_such_module_here:x", "math:no_such_name"])
def test_a_target_that_does_not_load_is_named(target):
    with pytest.raises(UsageError, match="number 'x' cannot be loaded from"):
        Registry("number", {"x": target})["x"]


def test_rows_of_other_distributions_are_found_and_load_lazily(monkeypatch):
    plug(monkeypatch, ("tau", "math:tau"), ("broken", "no_such_module_here:x"))
    table = Registry("number", {"two": 2}, group="minidual.tests")
    assert list(table) == ["two", "tau", "broken"]
    assert table["tau"] == pytest.approx(6.28318, abs=1e-5)
    with pytest.raises(UsageError, match="broken"):
        table["broken"]


def test_a_row_of_another_distribution_may_not_replace_one(monkeypatch):
    plug(monkeypatch, ("two", "math:tau"))
    with pytest.raises(UsageError, match="already in the table"):
        Registry("number", {"two": 2}, group="minidual.tests")["two"]


def test_names_are_read_from_text():
    table = Registry("number", {"two": 2, "three": 3})
    assert table.names(" three, two") == ("three", "two")
    assert table.names(["two"]) == ("two",)
    for text, message in (("", "no number named"), ("two,two", "named twice"), ("two,tree", "no number 'tree'")):
        with pytest.raises(UsageError, match=message):
            table.names(text)
