"""Write single trials so that `minidual replay` shows them again: the same trial once more, every step kept."""

from __future__ import annotations

from pathlib import Path

from minidual.plant.recorder import Recorder
from minidual.tasks.task import Trial
from minidual.trials.methods import MethodInputs
from minidual.trials.trials import Bench, TrialResult


class TrialRecords:
    """Runs trials of one method again and writes their recordings.

    A trial depends on its seed alone, so the one that is recorded is the one that was judged; its result is returned,
    and whoever asks for the recording can hold the two together.

    Args:
        method: Name of the method.
        inputs: As given to the trials before.
    """

    def __init__(self, method: str, inputs: MethodInputs) -> None:
        self._method, self._inputs = method, inputs
        self._bench = Bench(method, inputs)
        self._bench.world.recorder = Recorder(self._bench.world, seed=inputs.seed)

    def write(self, trial: Trial, path: Path) -> TrialResult:
        """Run `trial`, write it to `path` (.npz) and return its result."""
        result, _ = self._bench.run(trial)
        recorder = self._bench.world.recorder
        if recorder is None:
            raise RuntimeError("the world has lost its recorder")
        carry = self._inputs.config.carry
        recorder.write(
            path,
            f"{self._method}, trial {trial.index}: {result.text}",
            details={
                "method": self._method,
                "purpose": trial.purpose,
                "trial": trial.index,
                "object": carry.object,
                "motion": carry.motion,
                "success": result.success,
            },
        )
        return result
