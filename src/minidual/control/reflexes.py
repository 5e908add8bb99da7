"""The supervisor's reflexes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from minidual.errors import MinidualError
from minidual.robot.pair import Array


@dataclass(frozen=True)
class ReflexKind:
    """A row of reflexes.yaml."""

    cause: str
    remedy: str
    unit: str = ""


_TABLE = Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8")
REFLEXES = {name: ReflexKind(**words) for name, words in yaml.safe_load(_TABLE).items()}


@dataclass(frozen=True)
class Reflex:
    """A triggered reflex.

    Attributes:
        name: Key of REFLEXES.
        where: Joint, hand, pair of parts, or reason.
        value: NaN possible for `not_finite`.
        details: Measurements and requested torque of that tick (JSON types).
    """

    name: str
    time_s: float
    where: str
    value: float
    bound: float | None
    details: Mapping[str, Any] = field(default_factory=dict, compare=False)

    @property
    def kind(self) -> ReflexKind:
        """Its table row."""
        return REFLEXES[self.name]

    @property
    def text(self) -> str:
        """One line with value and bound."""
        unit = f" {self.kind.unit}" if self.kind.unit else ""
        numbers = "" if self.bound is None else f" ({self.value:.6g}{unit}, bound {self.bound:.6g}{unit})"
        return f"reflex {self.name} at {self.time_s:.3f} s: {self.kind.cause}: {self.where}{numbers}"


class ReflexError(MinidualError):
    """The supervisor stops the arms; raised once per reflex.

    Attributes:
        tau: (n,) [Nm] to apply in this tick; finite, within limits.
        dump: File for `minidual replay`, if written.
        no_dump: Why writing failed.
    """

    def __init__(self, reflex: Reflex, tau: Array, dump: Path | None = None, no_dump: str = "") -> None:
        look = f"; minidual replay {dump} shows the last second" if dump is not None else ""
        look += f"; the last second was not written: {no_dump}" if no_dump else ""
        super().__init__(reflex.text, remedy=reflex.kind.remedy + look)
        self.reflex = reflex
        self.tau = tau
        self.dump = dump
        self.no_dump = no_dump

    def __reduce__(self) -> tuple[object, ...]:
        return (type(self), (self.reflex, self.tau, self.dump, self.no_dump))
