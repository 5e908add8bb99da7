"""The command of the bench: what it runs, what it says of limits, what it writes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from minidual.errors import UsageError
from minidual.registry import Registry
from minidual.show.report.bench import BenchRow, BenchTable, read_bench
from scripts.bench import __main__ as bench
from scripts.bench.tables import BenchInputs, table_lines

Call = Callable[..., tuple[int, str, str]]


def toy(inputs: BenchInputs) -> BenchTable:
    """Return a table whose number is the number of repeats, at most 10."""
    inputs.advance("toy")
    row = BenchRow("row", {"n": float(inputs.repeats_n)}, {"n": 10.0})
    return BenchTable("toy", ("n",), (row,))


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Call:
    """Return what calls the command with one toy bench."""
    monkeypatch.setattr(bench, "BENCHES", Registry("bench", {"toy": toy}))

    def run(*words: str) -> tuple[int, str, str]:
        code = bench.main(list(words))
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


def test_within_limits_the_check_passes(call: Call) -> None:
    code, out, _ = call("--check", "--repeats", "3")
    assert code == 0
    assert "row" in out


def test_over_a_limit_is_said_and_fails_only_the_check(call: Call) -> None:
    code, out, err = call("toy", "--repeats", "11")
    assert code == 0
    assert "!" in out
    assert "row: n 11.00, limit 10" in err
    code, _, _ = call("--repeats", "11", "--check")
    assert code == 1


def test_the_record_holds_the_tables_and_what_they_were_made_with(
    call: Call,
    tmp_path: Path,
) -> None:
    path = tmp_path / "bench.json"
    call("--repeats", "3", "--json", str(path))
    record = read_bench(path)
    assert record is not None
    assert record.tables["toy"].rows[0].numbers == {"n": 3.0}
    assert record.machine["cores"]
    assert record.libraries["ompl"]


def test_an_unknown_bench_and_no_repeats_are_refused(call: Call) -> None:
    with pytest.raises(UsageError, match="toy"):
        call("nonsense")
    with pytest.raises(SystemExit):
        call("--repeats", "0")


def test_a_bench_that_repeats_nothing_refuses_repeats(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        bench.main(["passivity-arms", "--repeats", "5"])
    assert "passivity-arms runs each case once" in capsys.readouterr().err


def test_every_bench_can_be_loaded() -> None:
    assert set(bench.BENCHES) == {*bench.REPEATS_N, *bench.NOT_REPEATED}
    assert all(callable(bench.BENCHES[name]) for name in bench.BENCHES)


@pytest.mark.parametrize(
    ("words", "measured"),
    [((), {"toy"}), (("--peers",), {"hard"}), (("hard",), {"hard"}), (("toy",), {"toy"})],
)
def test_hard_queries_are_measured_only_where_they_are_asked_for(
    words: tuple[str, ...],
    measured: set[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with_peers: dict[str, bool] = {}

    def recorder(name: str) -> Callable[[BenchInputs], BenchTable]:
        def measure(inputs: BenchInputs) -> BenchTable:
            with_peers[name] = inputs.peers
            return BenchTable("title", (), ())

        return measure

    rows = {name: recorder(name) for name in ("toy", "hard")}
    monkeypatch.setattr(bench, "BENCHES", Registry("bench", rows))
    assert bench.main(list(words)) == 0
    assert set(with_peers) == measured
    assert set(with_peers.values()) == {"--peers" in words}


class TestTable:
    TABLE = BenchTable(
        "title",
        ("a_us", "ratio"),
        (
            BenchRow("good", {"a_us": 3.0, "ratio": 1.0}, {"ratio": 1.5}),
            BenchRow("bad", {"ratio": 2.0}, {"ratio": 1.5}),
            BenchRow("broken", {"ratio": float("nan")}, {"ratio": 1.5}),
        ),
        ("a note",),
    )

    def test_nan_is_over_every_limit(self) -> None:
        assert [row.exceeded for row in self.TABLE.rows] == [(), ("ratio",), ("ratio",)]
        assert len(self.TABLE.exceeded) == 2

    def test_a_number_over_its_limit_is_marked_and_a_missing_one_is_a_dash(self) -> None:
        lines = table_lines(self.TABLE)
        good = next(line for line in lines if line.startswith("good"))
        bad = next(line for line in lines if line.startswith("bad"))
        assert lines[0] == "title"
        assert lines[-1] == "a note"
        assert "!2.00 (<= 1.5)" in bad
        assert "  -  " in bad
        assert "!" not in good
