"""Trials of the five-task table: every method on every task, clean and `randomised`.

Each cell appends its trials to a file of its own, so that an interrupted measurement continues.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

from pydantic import TypeAdapter, ValidationError

from minidual.config.root import Config, changed
from minidual.durable import make_folder, now_text, write_text
from minidual.errors import UsageError
from minidual.gate.canonical import digest, file_sha256
from minidual.gate.circumstances import circumstances_now
from minidual.gate.code import code_of
from minidual.tasks.catalogue import make_task
from minidual.trials.benchmark import draw_under
from minidual.trials.conditions import CLEAN
from minidual.trials.methods import METHODS, MethodInputs
from minidual.trials.metrics import TrialMetrics
from minidual.trials.runner import run_trials
from scripts.results.markdown import Origin, origin

CONDITIONS = (CLEAN, "randomised")
FIRST_MIN = 1000
"""Starts below it were seen by development; 0 to 99 shaped the code."""
_DIGITS = 8


class Cell(NamedTuple):
    """One method on one task under one condition."""

    task: str
    method: str
    condition: str

    def __str__(self) -> str:
        return f"{self.task}, {self.method}, {self.condition}"


@dataclass(frozen=True)
class StoredTrial:
    """A trial in the file of its cell."""

    index: int
    success: bool
    failure: str
    reason: str
    made: Origin


@dataclass(frozen=True)
class Plan:
    """What is measured.

    Attributes:
        first: Number of the first start, at least FIRST_MIN.
        policies: {task: checkpoint}.
        folder: Where files of cells are.
    """

    config: Config
    tasks: tuple[str, ...]
    methods: tuple[str, ...]
    first: int
    trials_n: int
    policies: Mapping[str, Path]
    folder: Path

    def __post_init__(self) -> None:
        if self.first < FIRST_MIN:
            raise UsageError(
                f"--first {self.first}: starts below {FIRST_MIN} were seen by development",
                remedy="name a first start that no publication has used, such as --first 30000",
            )
        if self.trials_n < 1:
            raise UsageError(f"--trials {self.trials_n}: at least 1")

    @property
    def cells(self) -> list[Cell]:
        """Every cell; methods that drive a policy only where there is one."""
        return [
            Cell(task, method, condition)
            for task in self.tasks
            for method in self.methods
            if not METHODS[method].learned or task in self.policies
            for condition in CONDITIONS
        ]

    def inputs(self, cell: Cell) -> MethodInputs:
        """Return what the method of a cell is built from."""
        config = make_task(changed(self.config, {"task": cell.task})).config
        if not METHODS[cell.method].learned:
            return MethodInputs(config, config.seed)
        return MethodInputs(config, config.seed, self.policies[cell.task], cell.task)

    def path(self, cell: Cell) -> Path:
        """Return the file of a cell; it depends on the code, the settings and the policy."""
        inputs = self.inputs(cell)
        modules = code_of(("minidual.trials.runner:run_trials",)).modules
        checkpoint = inputs.checkpoint
        weights = file_sha256(checkpoint / "model.safetensors") if checkpoint is not None else ""
        key = digest([modules, inputs.config.model_dump_json(), weights])[:_DIGITS]
        name = f"{cell.task}-{cell.method}-{cell.condition}-{key}.jsonl"
        return self.folder / f"first-{self.first}" / name


def stored_trials(path: Path) -> list[StoredTrial]:
    """Return the trials of a file, in order; none without a file.

    A line that an interruption cut short is left out, and what follows it.
    """
    if not path.exists():
        return []
    adapter = TypeAdapter(StoredTrial)
    trials: list[StoredTrial] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            trials.append(adapter.validate_python(json.loads(line)))
        except (ValueError, ValidationError):
            break
    return trials


def measured(plan: Plan, cell: Cell) -> list[StoredTrial]:
    """Return the stored trials of a cell that the plan asks for."""
    asked = range(plan.first, plan.first + plan.trials_n)
    return [trial for trial in stored_trials(plan.path(cell)) if trial.index in asked]


def run_cell(
    plan: Plan,
    cell: Cell,
    workers: int,
    on_trial: Callable[[TrialMetrics], None],
) -> None:
    """Run the trials of a cell that are missing, and append each to its file."""
    path = plan.path(cell)
    make_folder(path.parent)
    stored = stored_trials(path)
    write_text(path, "".join(_line(trial) for trial in stored))  # without a line cut short
    done = {trial.index for trial in stored}
    inputs = plan.inputs(cell)
    draw = draw_under(inputs, cell.condition)
    missing = [k for k in range(plan.first, plan.first + plan.trials_n) if k not in done]
    trials = [draw(index) for index in missing]
    if not trials:
        return
    made = _origin_now()
    results = run_trials(cell.method, inputs, trials, workers=workers, condition=cell.condition)
    with path.open("a", encoding="utf-8") as file:
        for result in results:
            stored_trial = StoredTrial(
                index=result.index,
                success=result.success,
                failure=result.failure,
                reason=result.reason,
                made=made,
            )
            file.write(_line(stored_trial))
            file.flush()
            on_trial(result)


def _line(trial: StoredTrial) -> str:
    return json.dumps({**asdict(trial), "made": trial.made._asdict()}) + "\n"


def _origin_now() -> Origin:
    now = circumstances_now(())
    return origin(now.commit, now.machine, now_text())
