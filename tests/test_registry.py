"""Registries: names are unique, unknown ones are answered, rows load at their first use."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path

import pytest
import yaml

import minidual
from minidual.errors import UsageError, unknown_name
from minidual.registry import Registry, rows_beside

SOURCES = Path(minidual.__file__).parent


def plug(monkeypatch, *points):
    found = [importlib.metadata.EntryPoint(name, value, "minidual.tests") for name, value in points]
    monkeypatch.setattr(
        importlib.metadata,
        "entry_points",
        lambda group: found if group == "minidual.tests" else [],
    )


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


@pytest.mark.parametrize(
    "target",
    ["no_such_module_here:x", "math:no_such_name", "module_that_divides:x", "module_misspelt:x"],
)
def test_a_target_that_does_not_load_is_named(target, tmp_path, monkeypatch):
    """Whatever another distribution's module raises is its fault, not an internal error."""
    (tmp_path / "module_that_divides.py").write_text("x = 1 / 0\n")
    (tmp_path / "module_misspelt.py").write_text("def x(:\n")
    monkeypatch.syspath_prepend(tmp_path)
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


@pytest.mark.parametrize(
    ("name", "meant"),
    [("nope", None), ("wbe", "web"), ("pot", "pot_lift"), ("handovr", "handover"), ("", None)],
)
def test_only_a_close_name_or_the_rest_of_one_is_suggested(name, meant):
    remedy = unknown_name("row", name, ("handover", "pot_lift", "rod_carry", "web")).remedy
    assert remedy == (meant and f"did you mean '{meant}'?")


def test_names_are_read_from_text():
    table = Registry("number", {"two": 2, "three": 3})
    assert table.names(" three, two") == ("three", "two")
    assert table.names(["two"]) == ("two",)
    for text, message in (
        ("", "no number named"),
        ("two,two", "named twice"),
        ("two,tree", "no number 'tree'"),
    ):
        with pytest.raises(UsageError, match=message):
            table.names(text)


def test_a_table_stands_beside_its_module(tmp_path):
    (tmp_path / "arms.yaml").write_text("two: {joints: 7}\n")
    (tmp_path / "words.yaml").write_text("three: 3\n")
    assert rows_beside(str(tmp_path / "arms.py")) == {"two": {"joints": 7}}
    assert rows_beside(str(tmp_path / "arms.py"), "words.yaml") == {"three": 3}


def misread(node):
    """Return the keys that PyYAML reads otherwise than they look.

    A key that stands twice in one mapping keeps its last value; `yes` is no text.
    """
    keys = []
    if isinstance(node, yaml.MappingNode):
        names = [key.value for key, _ in node.value]
        for key, _ in node.value:
            if names.count(key.value) > 1 or not key.tag.endswith(":str"):
                keys.append(key.value)
        for _, value in node.value:
            keys += misread(value)
    elif isinstance(node, yaml.SequenceNode):
        for item in node.value:
            keys += misread(item)
    return keys


def test_names_in_tables_are_text_and_stand_once():
    assert misread(yaml.compose("a: {b: 1, b: 2, c: [{yes: 1}]}")) == ["b", "b", "yes"]
    tables = [path for path in SOURCES.rglob("*.yaml") if path.parent.name != "configs"]
    for path in tables:
        assert misread(yaml.compose(path.read_text())) == [], path.name
