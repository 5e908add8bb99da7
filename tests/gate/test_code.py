"""The code that a result depends on.

Changed modules are named, comments and docstrings do not count, and a report over results of other
code is no acceptance.
"""

from __future__ import annotations

import importlib
import sys
import textwrap

import pytest

from minidual.gate import code
from minidual.gate.code import Code, code_of
from minidual.gate.table import StageEntry, StageTable
from minidual.stages.registry import STAGES
from tests.support.pipeline_toys import Bench

STAGE = """
    '''A stage.'''
    from toycode import helper
    from minidual.gate.check import Check
    from minidual.gate.stage import StageResult

    TABLE = {"lazy": "toycode.lazy:THING"}

    def run(context):
        '''Measure.'''
        return StageResult([Check("quality", helper.quality(), ">=", 0.5)])
"""
HELPER = """
    def quality():
        from toycode.inner import VALUE  # imported when it runs
        return VALUE
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    folder = tmp_path / "site" / "toycode"
    folder.mkdir(parents=True)

    def write(name, text):
        (folder / f"{name}.py").write_text(textwrap.dedent(text))
        code._reach.cache_clear()
        code._module.cache_clear()
        code._files.cache_clear()

    write("__init__", "")
    write("stage", STAGE)
    write("helper", HELPER)
    write("inner", "VALUE = 1.0\n")
    write("lazy", "THING = 1\n")
    write("stranger", "import toycode.stage\n")
    monkeypatch.syspath_prepend(str(folder.parent))
    importlib.invalidate_caches()
    code._spec.cache_clear()
    yield write
    for name in [name for name in sys.modules if name.startswith("toycode")]:
        del sys.modules[name]
    code._spec.cache_clear()


def reach():
    return code_of(["toycode.stage:run"])


def test_a_stage_reaches_imports_of_functions_and_lazy_targets(package):
    names = [name for name in reach().modules if name.startswith("toycode")]
    assert names == ["toycode", "toycode.helper", "toycode.inner", "toycode.lazy", "toycode.stage"]
    assert "minidual.gate.check" in reach().modules
    assert "toycode" not in sys.modules  # nothing was imported to find out


@pytest.mark.parametrize(
    ("module", "text", "changed"),
    [
        ("inner", "VALUE = 2.0\n", ["toycode.inner"]),
        ("inner", "'''The value.'''\n\n# one\nVALUE = (\n    1.0\n)\n", []),
        ("lazy", "THING = 2\n", ["toycode.lazy"]),
        ("stranger", "import nothing_at_all\n", []),
        ("helper", "def quality():\n    return 1.0\n", ["toycode.helper", "toycode.inner"]),
    ],
)
def test_code_counts_and_words_do_not(package, module, text, changed):
    before = reach()
    package(module, text)
    now = code_of(["toycode.stage:run"], before)
    assert before.changes(now) == changed
    assert (now is before) == (
        module == "stranger"
    )  # no tree is built while the files are the same


def test_the_table_beside_a_module_counts_and_its_comments_do_not(package, tmp_path):
    table = tmp_path / "site" / "toycode" / "inner.yaml"
    table.write_text("speed: 1.0\n")
    package("inner", "VALUE = 1.0\n")
    before = reach()
    for text, changed in (("speed: 1.0  # slow\n", []), ("speed: 2.0\n", ["toycode.inner"])):
        table.write_text(text)
        package("inner", "VALUE = 1.0\n")
        assert before.changes(code_of(["toycode.stage:run"], before)) == changed


def test_a_stage_reaches_the_targets_that_a_table_names(package, tmp_path):
    (tmp_path / "site" / "toycode" / "inner.yaml").write_text(
        "rows: {far: {target: toycode.far:THING}}\n",
    )
    package("far", "THING = 1\n")
    assert "toycode.far" in reach().modules


def test_the_real_stages_reach_their_physics_and_not_each_other():
    modules = STAGES["carry"].code().modules
    assert {
        "minidual.plant.world",
        "minidual.control.stack",
        "minidual.gate.check",
    } <= modules.keys()
    assert "minidual.stages.deploy" not in modules
    assert "minidual.stages.registry" not in modules


def test_a_report_over_results_of_other_code_fails_and_gates_stay_open(package, tmp_path):
    bench = Bench(tmp_path)
    table = [
        StageEntry("first", "toycode.stage:run", (), "One"),
        StageEntry("third", bench.third, ("first",), "Three", closing=True),
    ]
    bench.table = StageTable(table, libraries=("numpy",))
    bench.run_all()
    assert bench.states() == ["pass", "pass"]
    package("inner", "VALUE = 0.75\n")
    state = bench.gate().state("first")
    assert (state.state, state.warnings) == (
        "pass",
        ("made by other code: toycode.inner changed since",),
    )
    outcome = bench.runner().run("third", force=True)
    (check,) = (check for check in outcome.verdict.checks if check.name == "gate.code_changed")
    assert (outcome.verdict.status, check.observed, check.passed) == ("fail", 1, False)
    assert "run first again with --force (toycode.inner changed)" in check.remedy
    assert bench.third.contexts[-1].code_changes == {"first": ["toycode.inner"]}


def test_nothing_known_is_a_change():
    assert Code().changes(Code({"a": "1"}, "x")) == ["a"]
