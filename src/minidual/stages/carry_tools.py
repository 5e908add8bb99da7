"""What `minidual carry` does besides its stage: trials under disturbances, and the search for gains."""

from __future__ import annotations

from minidual.errors import ExitCode
from minidual.pipeline.tool import ToolContext, ToolResult

PERTURB_TRIALS_N = 20


def perturb(context: ToolContext) -> ToolResult:
    """Run the carry under every condition and compare its success with the clean one."""
    from minidual.evaluation.conditions import CONDITIONS
    from minidual.evaluation.methods import MethodInputs
    from minidual.evaluation.perturbation import (
        DROP_MAX,
        run_perturbations,
        table_lines,
        write_perturbations,
    )

    trials_n = int(context.options.get("trials", PERTURB_TRIALS_N))
    inputs = MethodInputs(context.config, context.seed)
    with context.progress.task("disturbed carries", len(CONDITIONS) * trials_n) as task:
        found, trials = run_perturbations(
            "impedance", inputs, trials_n, workers=context.workers,
            on_trial=lambda name, result: task.advance(note=name),
        )  # fmt: skip
    write_perturbations(context.output, found, trials)
    failed = [r for r in found if not r.holds]
    notes = [
        f"{r.condition.name} costs {100 * r.drop:.0f} points of success, limit {100 * DROP_MAX:.0f}: {r.example}"
        for r in failed
    ]
    return ToolResult(
        lines=table_lines(found),
        notes=[*notes, f"written to {context.folder}"],
        data={"trials_n": trials_n, "drop_max": DROP_MAX, "conditions": [r.row() for r in found]},
        exit_code=ExitCode.ACCEPTANCE_FAILED if failed else ExitCode.PASS,
    )
