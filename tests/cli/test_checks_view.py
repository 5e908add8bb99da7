"""Checks on a terminal of 80 columns: no name is cut, and methods stand side by side."""

from __future__ import annotations

import io

import pytest
from rich.console import Console, RenderableType

from minidual.cli.app import run_command_line
from minidual.cli.checks_view import checks_view, explained
from minidual.gate.check import Check
from minidual.stages.registry import STAGES
from tests.support.pipeline_toys import Bench

LONG = "second_seed.both_arms.first_plan_median_s"
CHECKS = [
    Check("success_rate", 0.5, ">=", 0.8, why="it must work", remedy="minidual first --force"),
    Check("closed_chain.executed_error_max_rad", 0.001938, "<", 0.01745, "rad", "it must follow"),
    Check(LONG, 0.01379, unit="s", why="a new scene"),
]
METHODS = ("moveit", "impedance", "act")


def printed(view: RenderableType, width: int) -> list[str]:
    out = io.StringIO()
    Console(file=out, width=width).print(view)
    return [line.rstrip() for line in out.getvalue().splitlines()]


def view(checks: list[Check], width: int, compared: tuple[str, ...] = ()) -> list[str]:
    console = Console(file=io.StringIO(), width=width)
    return printed(checks_view(console, checks, "first: fail", compared), width)


@pytest.mark.parametrize("width", [50, 60, 80, 100, 160])
def test_no_name_is_cut(width):
    text = "\n".join(view(CHECKS, width))
    for check in CHECKS:
        assert check.name in text
    assert "FAIL" in text


def test_a_wide_terminal_has_a_table_with_margins():
    lines = view(CHECKS, 160)
    assert any("margin" in line and "observed" in line for line in lines)
    assert any("-0.3 (-38%)" in line for line in lines)


def test_a_narrow_one_has_a_table_without_them_if_that_fits():
    lines = view(CHECKS[:2], 80)
    assert lines[1].split() == ["check", "observed", "limit", "result"]
    assert lines[2].split() == ["success_rate", "0.5", ">=", "0.8", "FAIL"]


def test_what_fits_in_no_table_is_one_line_a_check():
    lines = view(CHECKS, 60)
    assert "FAIL     success_rate is 0.5, limit >= 0.8" in lines
    assert any(line.startswith(f"reported {LONG}") for line in lines)


def compared_checks() -> list[Check]:
    checks = [
        Check(f"rod_carry.{method}.{name}", value, ">" if name == "success_rate" else None, limit)
        for method, value in zip(METHODS, (1.0, 0.98, 0.42), strict=True)
        for name, limit in (("success_rate", 0.8), ("duration_median_s", None))
    ]
    checks.append(Check("rod_carry.act.friction_0.3.success_rate", 0.4))
    return [*checks, Check("rod_carry.trials_per_method", 20, ">=", 20)]


def test_methods_stand_side_by_side_at_80_columns():
    lines = view(compared_checks(), 80, METHODS)
    assert max(map(len, lines)) <= 80
    assert lines[1].split() == list(METHODS)
    rows = {line.split()[0]: line.split()[1:] for line in lines[2:]}
    assert " ".join(rows["rod_carry.success_rate"]) == "1 > 0.8 0.98 > 0.8 0.42 > 0.8 FAIL"
    assert rows["rod_carry.duration_median_s"] == ["1", "0.98", "0.42"]
    assert rows["rod_carry.friction_0.3.success_rate"] == ["-", "-", "0.4"]
    assert "pass     rod_carry.trials_per_method is 20, limit >= 20" in lines


def test_one_method_is_compared_with_nothing():
    checks = [check for check in compared_checks() if ".act." not in check.name]
    only = [check for check in checks if ".moveit." in check.name]
    assert any("rod_carry.moveit.success_rate" in line for line in view(only, 160, METHODS))


@pytest.mark.parametrize(
    ("stage", "parameters", "names"),
    [
        ("benchmark", {"benchmark": {"methods": ["moveit", "act"]}}, ("moveit", "act")),
        ("benchmark", {"benchmark": {}}, ()),
        ("benchmark", {"benchmark": 3}, ()),
        ("carry", {"benchmark": {"methods": ["moveit", "act"]}}, ()),
    ],
)
def test_a_row_says_what_its_checks_compare(stage, parameters, names):
    assert STAGES[stage].compared(parameters) == names


def test_an_explanation_has_why_and_the_remedy_of_a_failure_in_80_columns():
    lines = printed(explained(CHECKS, str.upper), 80)
    assert lines == [
        "FAIL     success_rate is 0.5, limit >= 0.8, margin -0.3 (-38%)",
        "         IT MUST WORK",
        "         REMEDY: MINIDUAL FIRST --FORCE",
        "pass     closed_chain.executed_error_max_rad is 0.001938 rad, limit < 0.01745",
        "         rad, margin +0.0155 (+89%)",
        "         IT MUST FOLLOW",
        f"reported {LONG} is 0.01379 s",
        "         A NEW SCENE",
    ]


class TestCommands:
    @pytest.fixture
    def failed(self, tmp_path):
        bench = Bench(tmp_path / "runs", profile="smoke")
        bench.first.observed = 0.5
        bench.run_all()
        return bench

    def say(self, bench: Bench, capsys: pytest.CaptureFixture[str], *words: str) -> str:
        place = ["--run", "toys", "--runs-dir", str(bench.root), "--profile", "smoke"]
        assert run_command_line([*words, *place], bench.table) == 0
        return capsys.readouterr().out

    def test_explain_shows_what_failed_and_with_all_the_rest(self, failed, capsys):
        short = self.say(failed, capsys, "explain", "first")
        assert "FAIL     quality is 0.5 n, limit >= 1 n" in short
        assert "size is 3 m" not in short
        assert "other checks: 0 pass, 1 reported; --all shows them" in short
        full = self.say(failed, capsys, "explain", "first", "--all")
        assert full.index("quality is") < full.index("size is 3 m")

    def test_status_says_once_that_a_run_is_a_quick_test(self, failed, capsys):
        failed.first.observed = 1.0
        failed.run_all()
        text = self.say(failed, capsys, "status")
        assert text.count("quick test") == 1
        assert "profile 'smoke': a quick test, never acceptance" in text
