"""Demonstration: moveit, teleop and policy drive one plant in turn."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from minidual.config.arbiter import ArbiterConfig
from minidual.control.commands import SOURCES, ArbiterState
from minidual.control.stack import ControlStack
from minidual.errors import UsageError, unknown_name
from minidual.plant.world import World
from minidual.trials.modes_drivers import Driver, SwitchError
from minidual.trials.modes_record import Recorder, Switch

DEFAULT_MODES: tuple[str, ...] = ("moveit", "teleop", "policy", "moveit")


def parse_modes(text: str) -> tuple[str, ...]:
    """Return the modes named in `moveit,teleop,moveit`.

    Raises:
        UsageError: Unknown or no mode, or one twice in sequence.
    """
    modes = tuple(m.strip() for m in text.split(",") if m.strip())
    if not modes:
        raise UsageError("no mode named", remedy=f"--modes {','.join(DEFAULT_MODES)}")
    for before, mode in zip(("", *modes), modes, strict=False):
        if mode not in SOURCES:
            raise unknown_name("mode", mode, SOURCES)
        if mode == before:
            raise UsageError(f"mode '{mode}' is named twice running: that is no switch")
    return modes


@dataclass(frozen=True)
class ModesResult:
    """Result of the demonstration.

    Attributes:
        faults: Exceeded bounds.
        refusals: (source, name, detail) of each refused command.
        ended: Why it ended early.
    """

    switches: tuple[Switch, ...]
    outcomes: tuple[dict[str, object], ...]
    faults: tuple[str, ...]
    refusals: tuple[tuple[str, str, str], ...]
    duration_s: float
    ended: str = ""

    @property
    def passed(self) -> bool:
        """Whether all turns ended and all bounds held."""
        return not self.faults and not self.ended

    def to_json(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {**asdict(self), "ended": self.ended or None}


class ModesDemo:
    """Runs the modes in turn; iterate `steps`, then call `result`.

    `turns` are (mode, maker of its driver).
    """

    def __init__(self, stack: ControlStack[World], turns: Sequence[tuple[str, Callable[[], Driver]]]) -> None:
        self.stack = stack
        self.recorder = Recorder(stack)
        self.mode = self.doing = ""
        """The requested mode and its caption."""
        self._turns = tuple(turns)
        self._outcomes: list[dict[str, object]] = []

    def steps(self) -> Iterator[tuple[str, str]]:
        """Run; yield (mode, caption) after every control step.

        Raises:
            SwitchError: A mode got no turn, lost it, or a trajectory was refused.
            ReflexError: The supervisor stopped the arms.
        """
        stack = self.stack
        for mode, make in self._turns:
            driver = make()
            self.mode, self.doing = mode, driver.caption
            self.recorder.requested(mode)
            stack.request(mode, driver.controllers)
            while stack.source != mode:
                self._step(mode)
                yield mode, driver.caption
            self.recorder.confirmed()
            driver.begin()
            while not driver.done:
                if stack.tick_next:
                    driver.tick()
                self._step(mode)
                driver.watch()
                yield mode, driver.caption
            self._outcomes.append({"mode": mode, **driver.result()})

    def _step(self, mode: str) -> None:
        stack = self.stack
        stack.step()
        self.recorder.observe()
        if stack.state == ArbiterState.STOPPED:
            last = stack.refusals[-1].detail if stack.refusals else "no command came"
            raise SwitchError(f"mode '{mode}' lost its turn at {stack.plant.time:.2f} s: {last}")

    def result(self, arbiter: ArbiterConfig, *, ended: str = "") -> ModesResult:
        """Return the measurements checked against their bounds."""
        stack, switches = self.stack, tuple(self.recorder.switches)
        return ModesResult(
            switches,
            tuple(self._outcomes),
            tuple(text for s in switches for text in s.faults(arbiter)),
            tuple((r.source, r.name, r.detail) for r in stack.refusals),
            stack.plant.time,
            ended,
        )
