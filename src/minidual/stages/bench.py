"""`minidual bench`: times beside a yardstick of the same run. No stage: a loaded machine must not close a gate."""

from __future__ import annotations

from minidual.errors import ExitCode, UsageError
from minidual.gate.tool import ToolContext, ToolResult


def bench(context: ToolContext) -> ToolResult:
    """Measure what is named, everything if nothing is; with `check`, numbers over their limits are a failure."""
    from minidual.stages.bench_rows import BENCHES, BenchInputs, parse_benches

    names = parse_benches(context.options.get("names", ()))
    repeats = context.options.get("repeats")
    if repeats is not None and repeats < 1:
        raise UsageError(f"--repeats {repeats}: at least 1")
    lines: list[str] = []
    document: dict[str, object] = {}
    exceeded: list[str] = []
    with context.progress.task("bench", None) as task:
        for name in names:
            spec = BENCHES[name]
            inputs = BenchInputs(
                context.config,
                context.seed,
                spec.repeats_n if repeats is None else repeats,
                lambda what: task.advance(note=what),
            )
            table = spec.run(inputs)
            lines += [*table.lines(), ""]
            document[name] = table.to_json()
            exceeded += table.exceeded
    failed = bool(exceeded) and bool(context.options.get("check"))
    return ToolResult(
        lines=lines,
        notes=[f"over its limit (!): {text}" for text in exceeded],
        data={"benches": document, "exceeded": exceeded},
        exit_code=ExitCode.ACCEPTANCE_FAILED if failed else ExitCode.PASS,
    )
