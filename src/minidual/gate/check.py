"""One observed value and its limit."""

import math
import operator
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

from minidual.gate.canonical import canonical

Op = Literal["<", "<=", ">", ">=", "=="]
Number = float | int | bool

_COMPARE = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
}


def _plain_number(value: Any, what: str) -> Number:
    if (
        not isinstance(value, bool | int | float)
        and hasattr(value, "item")
        and getattr(value, "ndim", 0) == 0
    ):
        value = value.item()
    if not isinstance(value, bool | int | float):
        raise TypeError(
            f"{what} must be a number or a bool, not {type(value).__name__} ({value!r})",
        )
    if isinstance(value, int) and value.bit_length() > 1000:
        raise ValueError(f"{what} has {value.bit_length()} bits, more than a float holds")
    return value


@dataclass(frozen=True)
class Check:
    """A named observation with its limit.

    Without `op` it is only reported. A non-finite `observed` fails every limit.

    Attributes:
        unit: "" for ratios and counts.
        why: What the limit protects.
    """

    name: str
    observed: Number
    op: Op | None = None
    limit: Number | None = None
    unit: str = ""
    why: str = ""
    remedy: str = ""

    def __post_init__(self) -> None:
        if not self.name or any(c.isspace() for c in self.name):
            raise ValueError(f"a check needs a name without blanks, not {self.name!r}")
        object.__setattr__(
            self,
            "observed",
            _plain_number(self.observed, f"check {self.name}: observed"),
        )
        if self.op is None:
            if self.limit is not None:
                raise ValueError(f"check {self.name}: limit {self.limit} without an operator")
            return
        if self.op not in _COMPARE:
            raise ValueError(
                f"check {self.name}: no operator {self.op!r}; there are {', '.join(get_args(Op))}",
            )
        limit = _plain_number(self.limit, f"check {self.name}: limit")
        if not math.isfinite(limit):
            raise ValueError(f"check {self.name}: the limit must be finite, is {limit}")
        object.__setattr__(self, "limit", limit)

    @property
    def passed(self) -> bool | None:
        """Whether the limit holds; None without one."""
        if self.op is None or self.limit is None:
            return None
        return math.isfinite(self.observed) and _COMPARE[self.op](self.observed, self.limit)

    @property
    def margin(self) -> float | None:
        """Distance to the limit [`unit`], positive if it holds.

        Minus the deviation for "=="; None without a limit or for bools.
        """
        if self.op is None or self.limit is None or isinstance(self.limit, bool):
            return None
        gap = float(self.observed) - float(self.limit)
        if self.op in (">", ">="):
            return gap
        return (
            0.0 - gap if self.op in ("<", "<=") else 0.0 - abs(gap)
        )  # from 0.0, so that none is -0.0

    @property
    def relative_margin(self) -> float | None:
        """Margin over the size of the limit; None where that says nothing."""
        if (
            self.margin is None
            or not math.isfinite(self.margin)
            or not self.limit
            or self.op == "=="
        ):
            return None
        return self.margin / abs(self.limit)

    def margin_text(self) -> str:
        """Return, for example, "+0.05 (+25%)"; "" without a margin."""
        if self.margin is None or not math.isfinite(self.margin) or self.op == "==":
            return ""
        return f"{self.margin:+.3g}" + (
            "" if self.relative_margin is None else f" ({self.relative_margin:+.0%})"
        )

    def sentence(self) -> str:
        """Return, for example, "tilt_max_rad is 0.12 rad, limit <= 0.0873 rad"."""
        limit = f", limit {self.op} {with_unit(self.limit, self.unit)}" if self.op else ""
        return f"{self.name} is {with_unit(self.observed, self.unit)}{limit}"

    def to_json(self) -> dict[str, Any]:
        """Return JSON types, with result and margin."""
        return canonical({**asdict(self), "passed": self.passed, "margin": self.margin})


def with_unit(value: Number | None, unit: str) -> str:
    """Return four significant digits and the unit; yes or no for bools."""
    if isinstance(value, bool):
        text = "yes" if value else "no"
    else:
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return f"{text} {unit}".rstrip()


Rows = Mapping[str, Number | tuple[Number, Op, Number | None]]
"""{check: observed value, or (observed value, operator, limit)}; without a limit it is only reported."""


def checks_of(
    words: Mapping[str, Mapping[str, str]],
    rows: Rows,
    prefix: str = "",
    **names: object,
) -> list[Check]:
    """Return a check per row, called `prefix` and its name; `names` are filled into its words."""
    checks: list[Check] = []
    for name, row in rows.items():
        observed, op, limit = row if isinstance(row, tuple) else (row, None, None)
        texts = {key: text.format(**names) for key, text in words[name].items()}
        checks.append(
            Check(f"{prefix}{name}", observed, None if limit is None else op, limit, **texts),
        )
    return checks
